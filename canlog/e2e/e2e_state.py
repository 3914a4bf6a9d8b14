"""Whether a message as a whole may be believed: the state machine of AUTOSAR E2E, one per message.

The profile's check says what a single frame is worth; this machine (E2E_SM of the AUTOSAR E2E protocol specification)
looks at a window of the last checks. Where AUTOSAR calls the check once per cycle, time does so here: every frame that
is known to be missing counts as one cycle without new data, and silence longer than the timeout as a window of them.
The timeout follows the cycle that the message itself keeps, from the one that the database names up to ``SLOWEST``
times as long: a bus that is slower than its database is held against itself, and a gap in it is still one.

All its parameters are the same in every state, as AUTOSAR's constraints permit; the window is cleared on the way to
``INVALID``, so that trust must be earned anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.e2e.own_cycle import SLOWER_RATIO, SLOWEST
from canlog.e2e.protection_check import FrameReason, FrameVerdicts
from canlog.frames import BEFORE_ALL_NS
from canlog.jit import kernel


class E2eState(IntEnum):
    """What a message as a whole is worth, in the words of AUTOSAR's E2E state machine."""

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
MIN_OK: Final = 7  # of a full window: three lost frames are tolerated
MAX_ERRORS: Final = 1  # frames with a wrong CRC or length
TIMEOUT_CYCLES: Final = 5
LEARNING_STEPS: Final = 16  # over which the own cycle of a message forgets; one gap moves it by a sixteenth at most
MIN_TIMEOUT_NS: Final = 200_000_000  # a listener's machine may be busy: this much lateness says nothing of the sender

_MASK: Final = (1 << WINDOW) - 1
_OK: Final = int(FrameReason.OK)
_SHORT: Final = int(FrameReason.SHORT)
_BAD_CRC: Final = int(FrameReason.BAD_CRC)
_OTHER_CHANNEL: Final = int(FrameReason.OTHER_CHANNEL)  # from here on, frames of somebody else
_NO_DATA, _INIT, _VALID, _INVALID = (
    int(state) for state in (E2eState.NO_DATA, E2eState.INIT, E2eState.VALID, E2eState.INVALID)
)


class E2eMemory(NamedTuple):
    """What is remembered of each message, arrays of shape (m,)."""

    state: Int64Array  # of E2eState
    ok_bits: Int64Array  # the last WINDOW checks, the latest lowest: 1 where all was well
    error_bits: Int64Array  # 1 where the frame was broken
    heard_ns: Int64Array  # last frame of whatever kind, BEFORE_ALL_NS before the first
    own_ns: Int64Array  # cycle that the message keeps, no less than the database's; 0 where that is unknown
    invalidations: Int64Array  # times that the message lost its trust


@kernel
def count_ones(bits: int) -> int:
    """Return how many bits are set."""
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@kernel
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


@kernel
def add_check(memory: E2eMemory, slot: int, is_ok: int, is_error: int) -> bool:
    """Take the result of one check into the window; return whether the state changed."""
    before = memory.state[slot]
    ok_bits = ((memory.ok_bits[slot] << 1) | is_ok) & _MASK
    error_bits = ((memory.error_bits[slot] << 1) | is_error) & _MASK
    after = next_state(before, ok_bits, error_bits)
    is_lost = after == _INVALID and before != _INVALID
    memory.ok_bits[slot] = 0 if is_lost else ok_bits
    memory.error_bits[slot] = 0 if is_lost else error_bits
    memory.state[slot] = after
    memory.invalidations[slot] += 1 if is_lost else 0
    return bool(after != before)


@kernel
def timeout_at_ns(memory: E2eMemory, slot: int) -> int:
    """Return when a message that stays silent is overdue; BEFORE_ALL_NS if it is unknown how often it should come."""
    if memory.own_ns[slot] <= 0 or memory.heard_ns[slot] == BEFORE_ALL_NS:
        return BEFORE_ALL_NS
    return int(memory.heard_ns[slot] + max(TIMEOUT_CYCLES * memory.own_ns[slot], MIN_TIMEOUT_NS))


@kernel
def is_overdue(memory: E2eMemory, slot: int, now_ns: int) -> bool:
    """Return whether a message that was heard has been silent for longer than its timeout."""
    return bool(BEFORE_ALL_NS < timeout_at_ns(memory, slot) < now_ns)


@kernel
def learn_cycle(memory: E2eMemory, slot: int, now_ns: int, missing: int, cycle_ns: int) -> None:
    """Take the time since the last frame into account, frames that are missing in between left out."""
    own_ns = memory.own_ns[slot]
    if own_ns > 0 and memory.heard_ns[slot] > BEFORE_ALL_NS:
        step_ns = (now_ns - memory.heard_ns[slot]) // (1 + max(missing, 0))
        step_ns = min(max(step_ns, own_ns // 2), 2 * own_ns)
        own_ns += (step_ns - own_ns) // LEARNING_STEPS
        memory.own_ns[slot] = min(max(own_ns, cycle_ns), SLOWEST * cycle_ns)


@kernel
def fall_silent(memory: E2eMemory, slot: int) -> bool:
    """Take a timeout into account: a window without new data; return whether the state changed."""
    is_lost = memory.state[slot] == _VALID or memory.state[slot] == _INIT
    memory.ok_bits[slot] = 0
    memory.error_bits[slot] = 0
    if is_lost:
        memory.state[slot] = _INVALID
        memory.invalidations[slot] += 1
    return bool(is_lost)


@kernel
def follow_messages(
    memory: E2eMemory,
    slot: Int64Array,
    t_ns: Int64Array,
    reason: UInt8Array,
    missing: Int64Array,
    cycle_ns: Int64Array,
    changes: Int64Array,
) -> int:
    """Judge frames in their order; fill rows (time, message, state) of ``changes``, (k, 3), and return how many."""
    count = 0
    for i in range(slot.size):
        m = slot[i]
        if m < 0 or reason[i] >= _OTHER_CHANNEL:
            continue
        if is_overdue(memory, m, t_ns[i]) and fall_silent(memory, m):
            changes[count, 0], changes[count, 1], changes[count, 2] = timeout_at_ns(memory, m), m, _INVALID
            count += 1
        for _ in range(min(missing[i], WINDOW)):
            if add_check(memory, m, 0, 0):
                changes[count, 0], changes[count, 1], changes[count, 2] = t_ns[i], m, memory.state[m]
                count += 1
        is_error = 1 if reason[i] == _SHORT or reason[i] == _BAD_CRC else 0
        if add_check(memory, m, 1 if reason[i] == _OK else 0, is_error):
            changes[count, 0], changes[count, 1], changes[count, 2] = t_ns[i], m, memory.state[m]
            count += 1
        learn_cycle(memory, m, t_ns[i], missing[i], cycle_ns[m])
        memory.heard_ns[m] = t_ns[i]
    return count


@kernel
def find_silent(memory: E2eMemory, now_ns: int, changes: Int64Array) -> int:
    """Let messages that are overdue at ``now_ns`` fall silent; fill rows of ``changes`` as above."""
    count = 0
    for m in range(memory.state.size):
        if is_overdue(memory, m, now_ns) and fall_silent(memory, m):
            changes[count, 0], changes[count, 1], changes[count, 2] = timeout_at_ns(memory, m), m, _INVALID
            count += 1
    return count


@kernel
def follow_batch(
    memory: E2eMemory,
    slot: Int64Array,
    t_ns: Int64Array,
    reason: UInt8Array,
    missing: Int64Array,
    cycle_ns: Int64Array,
    changes: Int64Array,
) -> int:
    """Judge frames, then let messages fall silent that are overdue at the last of them; as above."""
    count = follow_messages(memory, slot, t_ns, reason, missing, cycle_ns, changes)
    if t_ns.size:
        count += find_silent(memory, t_ns[-1], changes[count:])
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
        self._cycle_ns = np.array(cycle_ns, np.int64)
        self._memory = E2eMemory(*(np.zeros(len(names), np.int64) for _ in E2eMemory._fields))
        self._memory.own_ns[:] = self._cycle_ns
        self.reset()
        nothing = np.empty(0, np.int64)
        verdicts = FrameVerdicts(reason=np.empty(0, np.uint8), slot=nothing, sequence=nothing, missing=nothing)
        self.follow(nothing, verdicts)  # compiled now: the first real batch must not wait for the compiler

    @property
    def states(self) -> tuple[E2eState, ...]:
        """State of each message."""
        return tuple(E2eState(state) for state in self._memory.state.tolist())

    @property
    def invalidations(self) -> tuple[int, ...]:
        """How often each message lost its trust."""
        return tuple(self._memory.invalidations.tolist())

    @property
    def own_cycles_ns(self) -> tuple[int, ...]:
        """How often each message comes by itself; the database's cycle until it is plainly slower, 0 if unknown."""
        is_slower = self._memory.own_ns >= SLOWER_RATIO * self._cycle_ns
        return tuple(np.where(is_slower, self._memory.own_ns, self._cycle_ns).tolist())

    def reset(self) -> None:
        """Start again with every message, after a jump of bus time; counts and learnt cycles go on."""
        for name, column in zip(E2eMemory._fields, self._memory, strict=True):
            if name not in {"invalidations", "own_ns"}:
                column[:] = BEFORE_ALL_NS if name == "heard_ns" else 0

    def follow(self, t_ns: Int64Array, verdicts: FrameVerdicts) -> tuple[E2eChange, ...]:
        """Return the changes of state that frames bring about, those by silence until the last of them included."""
        room = np.empty((3 * len(t_ns) + len(self._names), 3), np.int64)  # by silence, by a loss, by the frame itself
        count = follow_batch(
            self._memory,
            verdicts.slot,
            t_ns,
            verdicts.reason,
            verdicts.missing,
            self._cycle_ns,
            room,
        )
        if not count:
            return ()
        return tuple(
            E2eChange(t_ns=when, message=self._names[slot], state=E2eState(state))
            for when, slot, state in room[:count].tolist()
        )
