"""A car that drives trips and is parked in between, faster than time: what it sends goes to the real controller."""

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import can
import numpy as np

from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder, merge
from ecu_emulator.bus.pace import WallPace
from ecu_emulator.bus.sender import to_messages
from ecu_emulator.sensing import Readings
from workshop.controller.answers import Answering, Answers
from workshop.controller.inquiry import ThreadInquiry

STEP_S = 0.5
TRIP_STEPS = 12
EPOCH_S = 1.7e9
PARKED_S = 3600.0
HOLDING: dict[str, float] = {
    "current_gear": 3.0, "target_gear": 3.0, "shift_phase": 0.0, "drive_state": 0.0, "engine_torque_nm": 150.0,
    "engine_speed_rad_s": 146.4, "hub_speed_rad_s": 146.4, "input1_speed_rad_s": 146.4, "input2_speed_rad_s": 106.0,
    "output_speed_rad_s": 100.0, "clutch1_pressure_pa": 8e5, "clutch1_pressure_command_pa": 8e5,
    "clutch2_pressure_pa": 0.2e5, "clutch2_pressure_command_pa": 0.1e5, "vehicle_speed_m_s": 20.0,
    "brake_pressure_pa": 0.0, "pedal_ratio": 0.3, "odometer_m": 12_345_000.0, "ambient_temperature_k": 293.15,
}  # fmt: skip


class Bus:
    """The end of a bus that keeps what it is given."""

    def __init__(self) -> None:
        self.messages: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.messages.append(message)


class TripCar:
    """The car; all of its time is in the hands of the test."""

    def __init__(self, *, memory: Path | None = None, table: str = "", ignition: deque[float] | None = None) -> None:
        self.t_s = 0.0
        self.bus = Bus()
        self._messages = (database := load_contract()).messages
        self._encoder = FrameEncoder(database)
        self._ignition: deque[float] = deque([0.0]) if ignition is None else ignition
        self.answering = Answering(
            self.bus, Answers(table=table or None, memory=memory), ignition=self._ignition,
            inquiry=ThreadInquiry(WallPace(lambda: 1000.0 + self.t_s)),
        )  # fmt: skip

    def park(self, duration_s: float = PARKED_S) -> None:
        """Stand with the ignition off, and switch it on."""
        self.t_s = round(self.t_s + duration_s, 3)
        self._encoder.restart()
        self._ignition.append(self.t_s)

    def drive(
        self, coolant_k: tuple[float, float] = (345.0, 350.0), changes: Mapping[str, float] = HOLDING, *,
        steps: int = TRIP_STEPS, silent: Collection[str] = (),
    ) -> None:  # fmt: skip
        """Hold a gear for some time; the engine warms up and the fluid with it."""
        for step in range(steps):
            share = step / max(1, steps - 1)
            warmth_k = coolant_k[0] + share * (coolant_k[1] - coolant_k[0])
            warm = {"coolant_temperature_k": warmth_k, "sump_temperature_k": coolant_k[0] + 10.0 * share}
            self.say({**HOLDING, **warm, **changes}, silent)
            self.t_s = round(self.t_s + STEP_S, 3)
            self.answering.watch()

    def say(self, values: Mapping[str, float], silent: Collection[str] = ()) -> None:
        """Send every message once, but those of silent senders or names."""
        names = [message.name for message in self._messages if not {message.name, *message.senders} & set(silent)]
        for message in to_messages(self.frames(names, values), EPOCH_S):
            self.answering.send(message)

    def frames(self, names: Iterable[str], values: Mapping[str, float]) -> EncodedFrames:
        """Return one frame of each message, as of now; what is not named is not available."""
        readings = (
            Readings(
                message=name,
                t_s=np.full(1, self.t_s),
                values={one: np.array([values.get(one, math.nan)]) for one in self._encoder.quantities(name)},
            )
            for name in names
        )
        return merge([self._encoder.encode(one) for one in readings])

    def ask(self, request: str, client: int = 0) -> str:
        """Return the response, empty if there is none."""
        return (self.answering.controller.ask(bytes.fromhex(request), client=client) or b"").hex(" ")

    def status(self, code: str) -> int:
        """Return the status of a trouble code, as service 19 tells it."""
        controller = self.answering.controller
        number = next(number for number, trouble in controller.table.troubles.items() if trouble.code == code)
        return int(controller.state.memory.records[number].status)
