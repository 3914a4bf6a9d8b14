"""An operation cycle of a car with an estimate on board, as a process: ``python -m tests.support.uds.ageing_car PLAN``.

The drive is faster than time. What the estimate says of it is known before, from a log of the same drive; it is told
when it would have been. One JSON line for each step; the plan may say after which of them the process kills itself.
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np

from dbc.contract import load_contract
from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.answering.requested_tasks import RequestedClearing
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sent_values import LatestValues, SentValues
from ecu_emulator.diagnostics.clutches import OnBoardEstimates, OnBoardFriction, read_line, values_of
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.monitors import SENSED
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario import Fluid, FluidCondition, Routine, Scenario
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import ShiftTruth
from tests.support.patience import HANG_S

STEP_S: Final = 0.5
TOLD_AFTER_S: Final = 1.0  # from the end of an event to the service's word on it
STANDS_S: Final = 3.0
DRIVING_S: Final = 10.0  # a step of its own: in the midst of a drive
WORN: Final = 0x089700
NOT_LEARNED: Final = 0x081054
CLEARING: Final = 0x0303
_MASK: Final = 0x5AA5C33C
_NS_PER_S: Final = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What happens in an operation cycle."""

    folder: str  # where controller and estimate keep what they know
    fluid: str
    vehicle_seed: int
    drive_seed: int
    cycles: int
    start_ns: int  # bus time of the beginning
    lines: str = ""  # file of what the estimate says
    new_fluid_at: str = ""  # when a tester clears the adaptation of a car that stands; empty: the car drives
    kill_after: int = 0  # steps; 0: it lives
    ageing_cycles: int = 20  # in which ageing fluid becomes as bad as it gets

    @property
    def memory(self) -> Path:
        return Path(self.folder) / "tcu.json"

    @property
    def store(self) -> Path:
        return Path(self.folder) / "on-board.sqlite"

    @property
    def scenario(self) -> Scenario:
        """The same vehicle each time, with another fluid."""
        fluid = FluidCondition(self.fluid)
        before = load_scenario("ageing")
        return replace(
            before,
            vehicle_seed=self.vehicle_seed,
            drive_seed=self.drive_seed,
            cycles=self.cycles,
            fluid=Fluid(condition=fluid, ageing_cycles=self.ageing_cycles),
            routine=Routine(on_request=bool(self.new_fluid_at)),
        )


class ToldBefore:
    """The estimate on board: what a service has said of a log of this drive."""

    is_live = True
    problem = None

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        lines = Path(plan.lines).read_bytes().splitlines() if plan.lines else []
        self._told = [found for line in lines if (found := read_line(line)) is not None]
        self.estimates: OnBoardEstimates = {}

    def hear(self, t_s: float) -> None:
        """Take what has been said by this time of the drive."""
        while self._told and self._due_s(self._told[0][1]) <= t_s:
            clutch, estimate = self._told.pop(0)
            self.estimates = {**self.estimates, clutch: estimate}

    def _due_s(self, estimate: OnBoardFriction) -> float:
        return (estimate.end_ns - self._plan.start_ns) / _NS_PER_S + TOLD_AFTER_S

    def begin_anew(self) -> bool:
        words = [sys.executable, "-m", "diag_service", "fluid-changed", str(self._plan.store)]
        noted = subprocess.run([*words, "--at", self._plan.new_fluid_at], check=False, capture_output=True)
        self.estimates = {}
        return noted.returncode == 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Car:
    """The car and its controller, from the start of an operation cycle on."""

    def __init__(self, plan: Plan, store: MemoryFile) -> None:
        self._plan = plan
        self._drive = Drive(plan.scenario)
        self._sent = SentValues(load_contract())
        self._told = ToldBefore(plan)
        self._t_s = 0.0
        self._shift_count = 0
        self._truth: dict[int, tuple[float, float]] = {}
        self._step_count = 0
        self._said: tuple[int, int] | None = None
        self.controller = Controller(
            shipped_table(),
            values=self._values,
            clock=lambda: self._t_s,
            chance=lambda count: bytes(range(1, count + 1)),
            store=store,
        )
        self._monitoring = Monitoring(self.controller)
        self._clearing = RequestedClearing(self._told, self.controller, self._monitoring)

    def _values(self) -> LatestValues:
        more = {
            "time_s": self._t_s,
            "shift_count": float(self._shift_count),
            "clearing_possible": float(self._clearing.is_possible),
            **values_of(self._told.estimates),
        }
        return self._sent.now(more)

    @property
    def _statuses(self) -> tuple[int, int]:
        records = self.controller.state.memory.records
        return int(records[WORN].status), int(records[NOT_LEARNED].status)

    def say(self, step: str) -> None:
        """Tell a step; be killed after it if the plan says so."""
        self._said = self._statuses
        told = {"step": step, "t_s": self._t_s, "worn": self._said[0], "not_learned": self._said[1]}
        print(json.dumps({**told, "truth": self._truth}), flush=True)
        self._step_count += 1
        if self._step_count == self._plan.kill_after:
            os.kill(os.getpid(), signal.SIGKILL)

    def live(self) -> None:
        """Drive, or stand and be asked."""
        self.say("started")
        for stretch in self._drive.stretches(STEP_S):
            was_early = self._t_s < DRIVING_S
            self._t_s = stretch.end_s
            self._note(stretch.frames)
            for shift in stretch.shifts:
                self._note_shift(shift)
            if self._sent.has_all(SENSED):
                self._judge()
            if was_early and self._t_s >= DRIVING_S:
                self.say("driving")
            if self._plan.new_fluid_at and self._t_s >= STANDS_S:
                self._be_asked()
                break
        self.controller.warm_up()  # as a drive does that is long enough
        self.say("ended")
        self._clearing.close()

    def _note(self, frames: EncodedFrames) -> None:
        """Note the last frame of each message."""
        last = len(frames) - 1 - np.unique(frames.can_id[::-1], return_index=True)[1]
        for row in last.tolist():
            self._sent.note(int(frames.can_id[row]), frames.data[row, : frames.length[row]].tobytes())

    def _note_shift(self, shift: ShiftTruth) -> None:
        self._shift_count += 1
        self._truth[shift.clutch] = (shift.mu_c, shift.mu_s)

    def _judge(self) -> None:
        self._monitoring.look(self._values(), self._t_s)
        self._told.hear(self._t_s)
        self._monitoring.judge_clutches(self._told.estimates)
        if self._statuses != self._said:
            self.say("tested")

    def _be_asked(self) -> None:
        """Be a tester who clears the adaptation."""
        ask = self.controller.ask
        ask(b"\x10\x03")
        seed = (ask(b"\x27\x01") or b"")[2:]
        ask(b"\x27\x02" + (int.from_bytes(seed, "big") ^ _MASK).to_bytes(len(seed), "big"))
        told = ask(b"\x31\x01" + CLEARING.to_bytes(2, "big"))
        if told != b"\x7f\x31\x78":
            raise RuntimeError(f"31 01 03 03: {told!r}")
        self.say("asked")
        until_s = time.monotonic() + HANG_S
        while (final := self.controller.tick()) is None and time.monotonic() < until_s:
            self._clearing.step()
            time.sleep(0.01)
        if final != b"\x71\x01" + CLEARING.to_bytes(2, "big") + b"\0":
            raise RuntimeError(f"31 01 03 03, at last: {final!r}")
        self.say("cleared")


def main() -> None:
    plan = Plan(**json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    with MemoryFile(plan.memory, shipped_table()) as store:
        Car(plan, store).live()


if __name__ == "__main__":
    main()
