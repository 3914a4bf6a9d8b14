"""Whether the machine was too busy for what a test claims: measured, so that a claim is made again or narrowed.

Tests that need real time hold on a machine that gives it. Beside other work a sender falls behind, and a service that
rejects such a shift is right. Nothing is measured by how fast a test runs.
"""

import subprocess
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import ParamSpec, TypeVar

from tests.support.beside import Beside
from tests.support.service import Record
from tests.support.wire import CONTRACTS

OutcomeT = TypeVar("OutcomeT")
P = ParamSpec("P")

TRIES = 4
STALL_NS = 20_000_000  # twice the time between two of the messages below
AROUND_NS = 500_000_000  # what the estimate of a shift reads before and after it
BEAT_ID = f"{CONTRACTS['TCU_Shift'].can_id:03X}"
NS_PER_S = 1_000_000_000
WAKE_EVERY_S = 0.005
STARVED_S = 0.03  # a thread that is woken so late was not given the time it asked for
# What drives in real time asks the scheduler to come first, as a test bench does, where that is allowed.
COMES_FIRST = ("nice", "-n", "-15")
AHEAD = () if subprocess.run([*COMES_FIRST, "true"], capture_output=True, check=False).stderr else COMES_FIRST


def undisturbed(attempt: Callable[[int], OutcomeT], is_disturbed: Callable[[OutcomeT], bool]) -> OutcomeT:
    """Return the outcome of the first attempt that the machine did not disturb, or of the last one."""
    for number in range(TRIES - 1):
        outcome = attempt(number)
        if not is_disturbed(outcome):
            return outcome
    return attempt(TRIES - 1)


class StarvationWatch(Beside):
    """Measures, while it is entered, how much too late this machine wakes a thread that sleeps."""

    def __init__(self) -> None:
        super().__init__()
        self.worst_s = 0.0

    @property
    def is_starved(self) -> bool:
        """Whether the machine was too busy for claims of real time."""
        return self.worst_s > STARVED_S

    def _work(self) -> None:
        while not self._is_over.is_set():
            due_s = time.monotonic() + WAKE_EVERY_S
            time.sleep(WAKE_EVERY_S)
            self.worst_s = max(self.worst_s, time.monotonic() - due_s)


def again_if_starved(test: Callable[P, Awaitable[None]]) -> Callable[P, Awaitable[None]]:
    """Repeat an asynchronous test that fails while the machine starves it; the last attempt's failure stays."""

    @wraps(test)
    async def attempts(*arguments: P.args, **named: P.kwargs) -> None:
        for _ in range(TRIES - 1):
            with StarvationWatch() as watch:
                try:
                    await test(*arguments, **named)
                except (AssertionError, TimeoutError):
                    if not watch.is_starved:
                        raise
                else:
                    return
        await test(*arguments, **named)

    return attempts


def stalls(log: Path) -> list[tuple[int, int]]:
    """Return when the sender of a drive fell behind, as a candump of the bus shows it: begin and end [ns]."""
    lines = (line.split() for line in log.read_text(encoding="ascii").splitlines())
    beats_ns = [_ns(stamp) for stamp, _, frame, *_ in lines if frame.startswith(f"{BEAT_ID}#")]
    return [(before_ns, after_ns) for before_ns, after_ns in pairwise(beats_ns) if after_ns - before_ns > STALL_NS]


def is_starved(shift: Record, found: Sequence[tuple[int, int]]) -> bool:
    """Return whether the sender fell behind in what the estimate of a shift reads."""
    begin_ns, end_ns = int(shift["start_bus_ns"]) - AROUND_NS, int(shift["end_bus_ns"]) + AROUND_NS
    return any(before_ns < end_ns and after_ns > begin_ns for before_ns, after_ns in found)


def without_cut_parts(shifts: Sequence[Record], found: Sequence[tuple[int, int]]) -> list[Record]:
    """Return one result for each shift: where the sender fell a second behind, one is cut, and its last part counts."""
    parts = [
        is_starved(one, found) and one["reasons"] == ["interrupted"] and _gears(one) == _gears(following)
        for one, following in pairwise(shifts)
    ]
    return [one for one, is_part in zip(shifts, [*parts, False], strict=True) if not is_part]


def _gears(shift: Record) -> tuple[object, object]:
    return shift["from_gear"], shift["to_gear"]


def _ns(stamp: str) -> int:
    seconds, _, fraction = stamp.strip("()").partition(".")
    return int(seconds) * NS_PER_S + int(fraction.ljust(9, "0"))
