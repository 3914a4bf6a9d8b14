"""The E2E state machine of a message: held against AUTOSAR's own words, one check at a time."""

from collections.abc import Sequence

import numpy as np
import pytest

from canlog.arrays import Int64Array, Series
from canlog.e2e.alive_counter import SLOWEST, own_period_ns
from canlog.e2e.e2e_state import MAX_ERRORS, MIN_OK, TIMEOUT_CYCLES, WINDOW, E2eChange, E2eState, E2eStates
from canlog.e2e.protection_check import FrameReason, FrameVerdicts

NAME = "message"
CYCLE_NS = 100_000_000
OK, SHORT, BAD_CRC, REPEATED, JUMP = (
    FrameReason.OK, FrameReason.SHORT, FrameReason.BAD_CRC, FrameReason.REPEATED, FrameReason.WRONG_SEQUENCE
)  # fmt: skip
NO_DATA, INIT, VALID, INVALID = E2eState


def verdicts(reasons: Sequence[FrameReason], missing: Sequence[int] | None = None, slot: int = 0) -> FrameVerdicts:
    count = len(reasons)
    return FrameVerdicts(
        reason=np.array(reasons, np.uint8),
        slot=np.full(count, slot, np.int64),
        sequence=np.zeros(count, np.int64),
        missing=np.zeros(count, np.int64) if missing is None else np.array(missing, np.int64),
    )


def on_time(count: int, first: int = 0) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return (first + np.arange(count, dtype=np.int64)) * CYCLE_NS


def machine() -> E2eStates:
    return E2eStates([NAME], [CYCLE_NS])


class Reference:
    """E2E_SMCheck of the specification with one set of limits and clearToInvalid, as a list of words."""

    def __init__(self) -> None:
        self.state = "NODATA"
        self.window: list[str] = []

    def check(self, status: str) -> str:
        self.window = [*self.window, status][-WINDOW:]
        ok, errors = self.window.count("OK"), self.window.count("ERROR")
        is_trusted = ok >= MIN_OK and errors <= MAX_ERRORS
        match self.state:
            case "NODATA" if status not in {"ERROR", "NONEWDATA"}:
                self.state = "INIT"
            case "INIT" if is_trusted:
                self.state = "VALID"
            case "INIT" if errors > MAX_ERRORS:
                self._distrust()
            case "VALID" if not is_trusted:
                self._distrust()
            case "INVALID" if is_trusted:
                self.state = "VALID"
        return self.state

    def _distrust(self) -> None:
        self.state = "INVALID"
        self.window = []


STATUS = {OK: "OK", SHORT: "ERROR", BAD_CRC: "ERROR", REPEATED: "REPEATED", JUMP: "WRONGSEQUENCE"}
STATE = {NO_DATA: "NODATA", INIT: "INIT", VALID: "VALID", INVALID: "INVALID"}


@pytest.mark.parametrize("seed", range(8))
def test_it_is_the_machine_of_the_specification(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights = [0.9, 0.02, 0.04, 0.02, 0.02]
    kinds = list(STATUS)
    stage, reference = machine(), Reference()
    seen = set()
    for number, index in enumerate(rng.choice(len(kinds), 3_000, p=weights)):
        lost = int(rng.integers(1, 4)) if rng.random() < 0.05 and number else 0
        stage.judge(on_time(1, number), verdicts([kinds[index]], [lost]))
        for _ in range(lost):
            reference.check("NONEWDATA")
        reference.check(STATUS[kinds[index]])
        assert STATE[stage.states[0]] == reference.state
        seen.add(reference.state)
    assert seen >= {"VALID", "INVALID"}


def change(t_ns: int, state: E2eState) -> E2eChange:
    return E2eChange(t_ns=t_ns, message=NAME, state=state)


def test_a_silence_is_taken_back_if_the_frame_after_it_is_the_very_next_one() -> None:
    stage, lost = machine(), machine()
    before = verdicts([OK] * WINDOW)._replace(sequence=np.arange(WINDOW))
    for one in (stage, lost):
        one.judge(on_time(WINDOW), before)
    overdue_ns = (WINDOW - 1 + TIMEOUT_CYCLES) * CYCLE_NS
    assert stage.judge(on_time(1, 40), verdicts([FrameReason.UNKNOWN_ID], slot=-1)) == (change(overdue_ns, INVALID),)
    late = verdicts([OK])._replace(sequence=np.array([WINDOW]))
    assert stage.judge(on_time(1, 41), late) == (change(overdue_ns, VALID),)
    assert (stage.states, stage.invalidations) == ((VALID,), (0,))
    later = verdicts([OK], [2])._replace(sequence=np.array([WINDOW + 2]))
    assert lost.judge(on_time(1, 41), later) == (change(overdue_ns, INVALID),)
    assert (lost.states, lost.invalidations) == ((INVALID,), (1,))


MS = 1_000_000
NOMINAL_NS = 10 * MS
COUNT = 100


def series(t_ns: Int64Array, sequence: Int64Array | None = None, period_ns: int = NOMINAL_NS) -> Series:
    numbers = np.arange(len(t_ns)) if sequence is None else sequence
    return Series(t_ns=t_ns, sequence=numbers, value=np.zeros(len(t_ns)), period_ns=period_ns)


def every(period_ns: int, count: int = COUNT) -> Int64Array:
    return np.arange(count, dtype=np.int64) * period_ns


@pytest.mark.parametrize("cycle_ms", [13, 15, 20, 50])
def test_a_slower_cycle_is_found_in_spite_of_jitter_and_gaps(cycle_ms: int) -> None:
    rng = np.random.default_rng(cycle_ms)
    t_ns = every(cycle_ms * MS) + rng.integers(0, MS, COUNT)
    t_ns[60:] += 300 * MS  # the bus was silent
    is_kept = rng.random(COUNT) < 0.9
    found = series(t_ns[is_kept], np.arange(COUNT)[is_kept])
    assert own_period_ns(found) == cycle_ms * MS


@pytest.mark.parametrize("t_ns", [every(9 * MS), every(NOMINAL_NS), every(12 * MS), every((SLOWEST + 1) * NOMINAL_NS)])
def test_jitter_and_what_is_far_too_slow_leave_the_database_right(t_ns: Int64Array) -> None:
    assert own_period_ns(series(t_ns)) == NOMINAL_NS
