"""Whether a message as a whole may be believed: the state machine of AUTOSAR E2E, one per message.

The profile's check says what a single frame is worth; this machine (E2E_SM of the AUTOSAR E2E protocol specification)
looks at a window of the last checks. Where AUTOSAR calls the check once per cycle, time does so here: every frame that
is known to be missing counts as one cycle without new data, and silence longer than the timeout as a window of them.
Frames that come after all, none of them missing, were late: the silence before them is taken back.
The timeout follows the cycle that the message itself keeps, from the one that the database names up to ``SLOWEST``
times as long: a bus that is slower than its database is held against itself, and a gap in it is still one.

All its parameters are the same in every state, as AUTOSAR's constraints permit; the window is cleared on the way to
``INVALID``, so that a message must prove itself anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from canlog.arrays import Int64Array, Records
from canlog.e2e.alive_counter import SLOWER_RATIO, learn_cycle
from canlog.e2e.profile1 import COUNTER_PERIOD
from canlog.e2e.protection_check import FrameReason, FrameVerdicts
from canlog.frames import BEFORE_ALL_NS
from canlog.jit import kernel, part


class E2eState(IntEnum):
    """Whether a message as a whole may be believed, in the words of AUTOSAR's E2E state machine."""

    NO_DATA = 0  # never heard in this segment
    INIT = 1  # heard, not yet often enough
    VALID = 2
    INVALID = 3  # too many frames lost, broken, repeated or out of sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class E2eChange:
    """A message whose state changed."""

    t_ns: int
    message: str
    state: E2eState


WINDOW: Final = 10  # checks
MIN_OK: Final = 4  # of a full window: six lost frames are tolerated; what came is checked one by one
MAX_ERRORS: Final = 1  # frames with a wrong CRC or length
TIMEOUT_CYCLES: Final = 5
MIN_TIMEOUT_NS: Final = 200_000_000  # a busy receiver may be as late; that is no fault of the sender

_MASK: Final = (1 << WINDOW) - 1
_OK: Final = int(FrameReason.OK)
_SHORT: Final = int(FrameReason.SHORT)
_BAD_CRC: Final = int(FrameReason.BAD_CRC)
_OTHER_CHANNEL: Final = int(FrameReason.OTHER_CHANNEL)  # from here on, frames of another origin
_NO_DATA, _INIT, _VALID, _INVALID = (
    int(state) for state in (E2eState.NO_DATA, E2eState.INIT, E2eState.VALID, E2eState.INVALID)
)


class E2eMemory:
    """What is remembered of a message: a record of an array."""

    state: int  # of E2eState
    ok_bits: int  # the last WINDOW checks, the latest lowest: 1 where all was well
    error_bits: int  # 1 where the frame was broken
    heard_ns: int  # last frame of whatever kind, BEFORE_ALL_NS before the first
    invalidations: int  # times that the message became invalid
    cycle_ns: int  # cycle that the database names; 0 where that is unknown
    own_ns: int  # cycle that the message keeps, no less than the database's
    sequence: int  # transmission number of the last frame
    lapse_state: int  # of E2eState before the silence that lasts, NO_DATA if there is none
    lapse_ok_bits: int
    lapse_ns: int


_MEMORY_TYPE: Final = np.dtype([(name, np.int64) for name in E2eMemory.__annotations__])


@part
def count_ones(bits: int) -> int:
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@part
def next_state(state: int, ok_bits: int, error_bits: int) -> int:
    """Return the state after the last check."""
    if state == _NO_DATA:
        return _NO_DATA if error_bits & 1 else _INIT
    ok_count, error_count = count_ones(ok_bits), count_ones(error_bits)
    if ok_count >= MIN_OK and error_count <= MAX_ERRORS:
        return _VALID
    if state == _INIT and error_count <= MAX_ERRORS:
        return _INIT
    return _INVALID


@part
def add_check(
    memory: E2eMemory, slot: int, t_ns: int, is_ok: int, is_error: int, changes: Int64Array, count: int
) -> int:
    """Take the result of one check into the window; write the change of state that it brings as ``enter_state``."""
    before = memory.state
    ok_bits = ((memory.ok_bits << 1) | is_ok) & _MASK
    error_bits = ((memory.error_bits << 1) | is_error) & _MASK
    after = next_state(before, ok_bits, error_bits)
    is_lost = after == _INVALID and before != _INVALID
    memory.ok_bits = 0 if is_lost else ok_bits
    memory.error_bits = 0 if is_lost else error_bits
    memory.invalidations += 1 if is_lost else 0
    return enter_state(memory, slot, t_ns, after, changes, count)


@part
def enter_state(memory: E2eMemory, slot: int, t_ns: int, state: int, changes: Int64Array, count: int) -> int:
    """Change the state of a message; write that behind ``count`` rows of ``changes``, return how many there are."""
    if state == memory.state:
        return count
    memory.state = state
    changes[count, 0], changes[count, 1], changes[count, 2] = t_ns, slot, state
    return count + 1


@part
def add_silence(memory: E2eMemory, slot: int, now_ns: int, changes: Int64Array, count: int) -> int:
    """If a message is overdue, take that for a window without new data; write and return as ``enter_state``."""
    if memory.own_ns <= 0 or memory.heard_ns == BEFORE_ALL_NS:
        return count
    overdue_ns = memory.heard_ns + max(TIMEOUT_CYCLES * memory.own_ns, MIN_TIMEOUT_NS)
    if overdue_ns >= now_ns:
        return count
    ok_bits, memory.ok_bits = memory.ok_bits, 0
    memory.error_bits = 0
    if not _INIT <= memory.state <= _VALID:
        return count
    memory.lapse_state, memory.lapse_ok_bits = memory.state, ok_bits
    memory.lapse_ns = overdue_ns
    memory.invalidations += 1
    return enter_state(memory, slot, overdue_ns, _INVALID, changes, count)


@part
def take_back_silence(memory: E2eMemory, slot: int, sequence: int, changes: Int64Array, count: int) -> int:
    """If the frame after a silence is the very next one, it was late: write that there was no lapse, at its time."""
    before, state = memory.sequence, memory.lapse_state
    memory.lapse_state, memory.sequence = _NO_DATA, sequence
    # Modulo the period: whole periods are counted by time alone, which is unreliable here.
    if state == _NO_DATA or sequence < 0 or before < 0 or (sequence - before) % COUNTER_PERIOD != 1:
        return count
    memory.ok_bits = memory.lapse_ok_bits
    memory.invalidations -= 1
    return enter_state(memory, slot, memory.lapse_ns, state, changes, count)


@kernel
def judge_messages(memory: Records, verdicts: FrameVerdicts, t_ns: Int64Array, changes: Int64Array) -> int:
    """Judge frames in their order, then silence at the last of them.

    Fills rows (time, message, state) of ``changes``, (k, 3), and returns how many.
    """
    count = 0
    for row in range(t_ns.size):
        slot, reason, missing = verdicts.slot[row], verdicts.reason[row], verdicts.missing[row]
        if slot < 0 or reason >= _OTHER_CHANNEL:
            continue
        count = add_silence(memory[slot], slot, t_ns[row], changes, count)
        count = take_back_silence(memory[slot], slot, verdicts.sequence[row], changes, count)
        for _ in range(min(missing % COUNTER_PERIOD, WINDOW) if missing > 0 else 0):
            count = add_check(memory[slot], slot, t_ns[row], 0, 0, changes, count)
        is_error = 1 if _SHORT <= reason <= _BAD_CRC else 0
        count = add_check(memory[slot], slot, t_ns[row], 1 if reason == _OK else 0, is_error, changes, count)
        learn_cycle(memory[slot], t_ns[row], missing)
        memory[slot].heard_ns = t_ns[row]
    for slot in range(len(memory) if t_ns.size else 0):
        count = add_silence(memory[slot], slot, t_ns[-1], changes, count)
    return count


class E2eStates:
    """The state machines of all messages; what they say does not depend on how the stream was cut.

    Parameters
    ----------
    names
        Messages, in the order of their slots.
    cycle_ns : (m,) sequence
        Cycle times; 0 where unknown, which means no timeout.
    """

    def __init__(self, names: Sequence[str], cycle_ns: Sequence[int]) -> None:
        self._names = tuple(names)
        self._memory = np.zeros(len(names), _MEMORY_TYPE)
        self._memory["cycle_ns"] = cycle_ns
        self._memory["own_ns"] = cycle_ns
        self.reset()
        self.judge(np.empty(0, np.int64), FrameVerdicts.room(0))  # compiles now: the first real batch must not wait

    @property
    def states(self) -> tuple[E2eState, ...]:
        return tuple(E2eState(state) for state in self._memory["state"].tolist())

    @property
    def invalidations(self) -> tuple[int, ...]:
        return tuple(self._memory["invalidations"].tolist())

    @property
    def own_cycles_ns(self) -> tuple[int, ...]:
        """How often each message comes by itself; the database's cycle until it is plainly slower, 0 if unknown."""
        own_ns, cycle_ns = self._memory["own_ns"], self._memory["cycle_ns"]
        return tuple(np.where(own_ns >= SLOWER_RATIO * cycle_ns, own_ns, cycle_ns).tolist())

    def reset(self) -> None:
        """Start again with every message, after a jump of bus time; counts and learnt cycles go on."""
        self._memory["state"] = _NO_DATA
        self._memory["ok_bits"] = 0
        self._memory["error_bits"] = 0
        self._memory["lapse_state"] = _NO_DATA
        self._memory["sequence"] = -1
        self._memory["heard_ns"] = BEFORE_ALL_NS

    def judge(self, t_ns: Int64Array, verdicts: FrameVerdicts) -> tuple[E2eChange, ...]:
        """Return the changes of state that frames bring about, those by silence until the last of them included."""
        room = np.empty((4 * len(t_ns) + len(self._names), 3), np.int64)  # by silence, taken back, a loss, the frame
        count = judge_messages(self._memory, verdicts, t_ns, room)
        return tuple(
            E2eChange(t_ns=when, message=self._names[slot], state=E2eState(state))
            for when, slot, state in room[:count].tolist()
        )
