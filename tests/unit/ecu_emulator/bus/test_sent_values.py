"""What the controllers last said on the bus, as a tester gets it."""

import math

import can
import numpy as np
import pytest

from canlog.frames import EXTENDED_FLAG
from dbc.contract import load_contract
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.sensing import Readings
from workshop.controller.answers import Answering, Answers

DATABASE = load_contract()

MESSAGES = (
    "TCU_Shift", "TCU_Temperature", "TCU_Pressures", "TCU_InputSpeeds", "TCU_Output", "ECM_TorqueSpeed",
)  # fmt: skip


def frames(message: str, **values: float) -> list[can.Message]:
    encoder = FrameEncoder(DATABASE)
    known = dict.fromkeys(encoder.quantities(message), math.nan) | values
    encoded = encoder.encode(
        Readings(message=message, t_s=np.zeros(1), values={name: np.array([value]) for name, value in known.items()})
    )
    return [
        can.Message(arbitration_id=int(can_id) & ~EXTENDED_FLAG, is_extended_id=False, data=data.tobytes())
        for can_id, data in zip(encoded.can_id, encoded.data, strict=True)
    ]


def noted(*messages: can.Message) -> SentValues:
    values = SentValues(DATABASE)
    for message in messages:
        values.note(message.arbitration_id, bytes(message.data))
    return values


def test_values_are_back_in_si() -> None:
    values = noted(
        *frames("ECM_TorqueSpeed", engine_speed_rad_s=200.0, engine_torque_nm=-30.0, pedal_ratio=0.4),
        *frames("TCU_Temperature", sump_temperature_k=350.0),
        *frames("BRK_Vehicle", vehicle_speed_m_s=20.0, brake_pressure_pa=1e6),
    ).now({"time_s": 3.5})
    assert values["engine_speed_rad_s"] == pytest.approx(200.0, abs=0.03)
    assert values["engine_torque_nm"] == -30.0
    assert values["pedal_ratio"] == pytest.approx(0.4)
    assert values["sump_temperature_k"] == pytest.approx(350.0, abs=0.5)
    assert values["vehicle_speed_m_s"] == pytest.approx(20.0, abs=0.01)
    assert values["brake_pressure_pa"] == pytest.approx(1e6)
    assert values["time_s"] == 3.5


def at(values: SentValues, due_s: float, *messages: can.Message) -> None:
    for message in messages:
        values.note(message.arbitration_id, bytes(message.data), due_s)


def test_what_another_controller_said_too_long_ago_is_not_believed() -> None:
    values = SentValues(DATABASE)
    own, speed = frames("TCU_Temperature", sump_temperature_k=350.0), frames("BRK_Vehicle", vehicle_speed_m_s=0.0)
    at(values, 0.0, *own, *speed)
    at(values, 0.5, *frames("ECM_TorqueSpeed", engine_speed_rad_s=100.0))
    assert {"vehicle_speed_m_s", "engine_speed_rad_s"} <= set(values.now({}))
    assert values.silences["is_silent_ABS"] == 0.0
    at(values, 0.6, *frames("ECM_TorqueSpeed", engine_speed_rad_s=100.0))
    assert "vehicle_speed_m_s" not in values.now({})
    assert {"engine_speed_rad_s", "sump_temperature_k"} <= set(values.now({}))  # it knows what it senses itself
    assert (values.silences["is_silent_ABS"], values.silences["is_silent_IC"]) == (1.0, 0.0)  # each has its own time
    at(values, 0.7, *speed, *frames("BRK_WheelSpeeds"))
    assert "vehicle_speed_m_s" in values.now({})
    assert values.silences["is_silent_ABS"] == 0.0


def test_a_wrong_checksum_is_not_believed_and_counted() -> None:
    values = noted(*frames("BRK_Vehicle", vehicle_speed_m_s=20.0))
    standing = frames("BRK_Vehicle", vehicle_speed_m_s=0.0)[0]
    for wrong in (bytes([standing.data[0] ^ 0xFF]) + bytes(standing.data[1:]), bytes(standing.data[:4])):
        values.note(standing.arbitration_id, wrong)
    assert values.now({})["vehicle_speed_m_s"] == pytest.approx(20.0)
    assert values.disbelieved_count == 2


class Sent:
    """The end of a bus that keeps what it is given."""

    def __init__(self) -> None:
        self.messages: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.messages.append(message)


def test_a_controller_whose_vehicle_has_not_begun_is_busy_with_what_it_will_know_and_answers_the_rest() -> None:
    answering = Answering(Sent(), Answers())

    def ask(request: str, *, to_all: bool = False) -> str:
        return (answering.controller.ask(bytes.fromhex(request), is_functional=to_all) or b"").hex()

    live = ("22 0206", "22 F190 0206", "01 0C", "01 00 0C")
    for request in live:
        assert ask(request) == ask(request, to_all=True) == f"7f{request[:2]}21"
    for request in ("22 F190", "09 02", "01 00", "01 01", "03", "19 02 FF", "3E 00"):
        assert not ask(request).startswith("7f")
    for name in MESSAGES:
        answering.send(frames(name)[0])
    for request in live:
        assert not ask(request).startswith("7f")
