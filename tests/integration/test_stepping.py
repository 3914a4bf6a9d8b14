"""A car whose time is the caller's: the same frames as recorded, or gears and clutches that follow another's speed."""

import can
import numpy as np
import pytest

from canlog.e2e.message_contract import message_contracts
from canlog.e2e.profile1 import counter_of, protect
from dbc.contract import load_contract
from ecu_emulator import Emulator, EmulatorConfigError
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.drive.recording import frames_of
from workshop import Answers

CONTRACTS = {contract.can_id: contract for contract in message_contracts(load_contract("nominal")).values()}


def test_stepping_gives_the_recorded_frames_to_the_bit() -> None:
    car = Emulator("case2", seed=7, faults=[{"kind": "loss", "share": 0.1}])
    recorded, _ = frames_of(car.scenario)
    stepped = [message for _ in range(700) for message in car.step(0.01)]
    stepped += [message for duration_s in (0.001, 0.25, 1.0) for message in car.step(duration_s)]
    assert len(stepped) > 4000
    assert car.sent_s == pytest.approx(7.0 + 1.251, abs=0.002)
    assert [message.timestamp for message in stepped] == recorded.t_s[: len(stepped)].tolist()
    assert [message.arbitration_id for message in stepped] == recorded.can_id[: len(stepped)].tolist()
    assert [bytes(message.data) for message in stepped] == [bytes(row) for row in recorded.data[: len(stepped)]]
    assert [shift.number for shift in car.truth.shifts] == [1, 2, 3]


def test_the_end_of_a_drive_is_seen() -> None:
    car = Emulator("ideal", cycles=1)
    assert not car.is_driving
    while car.step(1.0):
        assert car.truth.drive.scenario == "ideal"
    assert not car.is_driving
    assert car.step(1.0) == []


def heard(car: Emulator, values: SentValues, speed_m_s: float, pedal_ratio: float) -> list[can.Message]:
    messages = car.step(0.01, speed_m_s, pedal_ratio)
    for message in messages:
        values.note(message.arbitration_id, bytes(message.data), message.timestamp)
    return messages


def test_somebody_else_moves_the_car_and_counters_and_checksums_go_on() -> None:
    car, values = Emulator("ideal"), SentValues(load_contract("nominal"))
    frames = list[can.Message]()
    for step in range(1000):
        frames += heard(car, values, min(1.5 * max(step - 100, 0) * 0.01, 12.0), 0.35 if step > 100 else 0.0)
    known = values.now({})
    assert known["vehicle_speed_m_s"] == pytest.approx(12.0, abs=0.3)
    assert known["pedal_ratio"] == pytest.approx(0.35, abs=0.005)
    assert known["current_gear"] >= 2.0
    assert known["wheel_fl_speed_m_s"] == pytest.approx(12.0, rel=0.03)
    assert car.truth.shifts[0].to_gear == 2
    for step in range(600):
        frames += heard(car, values, max(12.0 - 2.5 * step * 0.01, 0.0), 0.0)
    known = values.now({})
    assert known["vehicle_speed_m_s"] == pytest.approx(0.0, abs=0.1)
    assert known["current_gear"] == 1.0
    assert known["brake_pressure_pa"] > 5e5
    for can_id, contract in CONTRACTS.items():
        data = np.array([list(message.data) for message in frames if message.arbitration_id == can_id], np.uint8)
        counters = counter_of(data).astype(np.int64)
        assert len(data) > 10
        assert set(np.diff(counters).tolist()) <= {1, 1 - (int(counters.max()) + 1)}
        assert (protect(data, contract.data_id or 0, counters) == data).all()


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ((0.0105,), "whole milliseconds"),
        ((0.0,), "whole milliseconds"),
        ((0.01, 5.0), "belong together"),
        ((0.01, -1.0, 0.2), "no car has speed_m_s -1"),
        ((0.01, 5.0, 1.2), "no car has"),
        ((0.01, float("nan"), 0.2), "no car has"),
    ],
)
def test_a_step_that_cannot_be_says_so(step: tuple[float, ...], text: str) -> None:
    with pytest.raises(EmulatorConfigError, match=text):
        Emulator("ideal").step(*step)


def test_a_car_has_one_pace_and_one_hand_at_the_wheel() -> None:
    own = Emulator("ideal")
    own.step(0.01)
    with pytest.raises(EmulatorConfigError, match="in each of its steps"):
        own.step(0.01, 5.0, 0.2)
    with pytest.raises(EmulatorConfigError, match="drives only once"), own:
        pass
    with Emulator("ideal") as live, pytest.raises(EmulatorConfigError, match="drives on a bus"):
        live.step(0.01)
    with pytest.raises(EmulatorConfigError, match="answered in real time"):
        Emulator("ideal", answers=Answers()).step(0.01)
