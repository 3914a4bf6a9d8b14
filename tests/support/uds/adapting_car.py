"""A car in a workshop whose clutches a tester has adapted: faster than time, but all parts of it are the real ones."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from clutch_model.calibration import clutch_of_gear
from dbc.contract import load_contract
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.drive.build import build_vehicle
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.scenario.scenario import Scenario, Truth, WorkshopRoutine
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.shift_control import tcu_data
from workshop.controller.controller import Controller, MemoryFile
from workshop.controller.iso14229 import DtcStatus
from workshop.controller.monitoring import Monitoring
from workshop.controller.requested_tasks import RequestedAdaptation, clear_if_requested
from workshop.controller.table import shipped_table

ADAPT = "31 01 03 02"
CLEAR = "31 01 03 03"
SEED = 3  # one clutch of it is as the type has it, the other begins 0.018 bar below
_MASK = 0x5AA5C33C
FILLING_PA = 5e5  # a clutch is filled with more
_READY_S = 5.5  # an engine that has run long enough
_MOST_S = 200.0


def in_workshop(*, adapted: bool = False, **truth: float) -> Scenario:
    """Return a drawn vehicle in a workshop, with springs of its own (force [N] by clutch) if they are named."""
    overrides = {f"{clutch}.piston.spring_preload_n": force_n for clutch, force_n in truth.items()}
    scenario = replace(load_scenario("ideal"), routine=WorkshopRoutine(on_request=True), adapted=adapted)
    return replace(scenario, seed=SEED, truth=Truth(calibration=overrides))


class AdaptingCar:
    """The car and its controller, from the start of an operation cycle on."""

    def __init__(self, scenario: Scenario, memory: MemoryFile | None = None) -> None:
        database = load_contract()
        self.drive = Drive(scenario)
        self.truth = build_vehicle(scenario).calibration
        self._sent = SentValues(database)
        self._pressures = database.get_message_by_name("TCU_Pressures").frame_id
        self.t_s = 0.0
        self._is_driving = False
        self.fills_pa: dict[int, float] = {}  # by gear, at which its clutch is held once it is filled
        self.controller = Controller(
            shipped_table(), values=self._values, clock=lambda: self.t_s, chance=bytes, store=memory
        )
        self.monitoring = Monitoring(self.controller, was_adapted=scenario.adapted)
        self.adaptation = RequestedAdaptation(self.drive, self.controller)
        self._stretches = self.drive.stretches(SHORT_STRETCH_S)
        while self.t_s < _READY_S:
            self.go_on()

    @property
    def touch_pa(self) -> tuple[float, float]:
        """The true touch points."""
        first, second = self.truth.clutches
        return first.touch_pressure_pa, second.touch_pressure_pa

    def _values(self) -> Mapping[str, float]:
        more = {
            "engine_run_time_s": self.t_s,
            "adaptation_possible": float(self.adaptation.is_possible),
            "clearing_possible": 1.0,
            **self.adaptation.values,
            **self.monitoring.temperatures,
        }
        return self._sent.now(more)

    def go_on(self) -> None:
        """Let a quarter of a second go by."""
        stretch = next(self._stretches)
        frames = stretch.frames
        for t_s, can_id, data in zip(frames.t_s.tolist(), frames.can_id.tolist(), frames.data, strict=True):
            self._sent.note(can_id, data.tobytes())
            if can_id == self._pressures and (self.adaptation.needs_moments or self._is_driving):
                self._take(t_s, self._sent.now({}))
        self.t_s = stretch.end_s
        self.monitoring.judge(self._values(), self.t_s)
        self.monitoring.judge_adaptation()
        self.adaptation.step(self._values())
        clear_if_requested(self.controller, self.monitoring, self.adaptation)

    def _take(self, t_s: float, values: Mapping[str, float]) -> None:
        if self.adaptation.needs_moments:
            self.adaptation.feed(t_s, values)
        if self._is_driving and values.get("shift_phase") == tcu_data.PREFILL:
            gear = int(values["target_gear"])
            command_pa = values[f"clutch{clutch_of_gear(gear)}_pressure_command_pa"]
            if 0.0 < command_pa < FILLING_PA:
                self.fills_pa.setdefault(gear, command_pa)

    def drive_off(self, to_gear: int) -> None:
        """Start and drive until a gear's clutch is filled; ``fills_pa`` has at what it is held then."""
        self._is_driving = True
        self.drive.order(lambda plant: plant.begin_routine(1, 0))
        while to_gear not in self.fills_pa or self._sent.now({}).get("current_gear") != to_gear:
            self.go_on()

    def ask(self, request: str) -> str:
        """Return the response, empty if there is none."""
        return (self.controller.ask(bytes.fromhex(request)) or b"").hex(" ")

    def unlock(self) -> None:
        self.ask("10 03")
        seed = bytes.fromhex(self.ask("27 01"))[2:]
        self.ask(f"27 02 {int.from_bytes(seed, 'big') ^ _MASK:08x}")

    def perform(self, request: str, meanwhile: Callable[[], None] = lambda: None) -> str:
        """Start a routine and return its last word."""
        self.unlock()
        assert self.ask(request) == "7f 31 78"
        until_s = self.t_s + _MOST_S
        while self.t_s < until_s:
            meanwhile()
            self.go_on()
            response = self.controller.tick()
            if response is not None and response[-1:] != b"\x78":
                return response.hex(" ")
        raise AssertionError(f"{request}: no last word")

    def status(self, code: str) -> DtcStatus:
        numbers = {trouble.code: number for number, trouble in self.controller.table.troubles.items()}
        return self.controller.state.memory.records[numbers[code]].status


def memory_in(folder: Path) -> MemoryFile:
    """Return the file of a controller's memory."""
    return MemoryFile(folder / "tcu.json", shipped_table())
