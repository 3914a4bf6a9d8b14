"""Which frames may be believed: length, then CRC, then alive counter, as AUTOSAR E2E profile 1 orders them.

The counter check follows profile 1, with elapsed bus time in the place of its cyclic calls: each cycle without valid
data widens the permitted jump by one. Where profile 1 leaves room, this receiver does the following.

- The first frame of a message, and the first after a jump of bus time, is accepted: there is nothing to compare.
- A jump beyond what the elapsed time permits rejects that one frame and remembers it. The next frame is accepted if
  it continues either the last accepted one (the odd frame was a stray) or the remembered one (the sender's counter
  restarted). A restart of a sender therefore costs at most ``MAX_FRAMES_LOST_BY_RESTART`` frames.
- A counter that does not move rejects every frame until it moves. The same counter after one or more whole periods
  of lost frames, on time to a cycle, is not stuck; but once stuck, time is no excuse.
- Losses longer than the counter's period are counted by time. If the frames turn out to have been late instead (the
  next ones come in a burst), the count of missing frames is taken back; sequence numbers only ever grow. A late
  sender may catch up. Only a loss of a whole period while its sender was late cannot be counted: it leaves no trace.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message

from clutch_model.jit import kernel
from dbc.contract import message_contract
from dbc.protection import COUNTER_PERIOD, counter_of, crc_is_valid, data_id_remainder
from diag_service.errors import ConfigError
from diag_service.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    FrameBatch,
    empty_batch,
)
from diag_service.records import Int64Array, UInt8Array, UInt32Array

MAX_DELTA_COUNTER: Final = 3  # permitted jump between frames one cycle apart: two frames may be lost in silence
MAX_FRAMES_LOST_BY_RESTART: Final = 1
LATE_CYCLES: Final = 1.0  # jitter within which a gap still counts as whole counter periods
BURST_CYCLES: Final = 0.5  # frames closer than this were held back, not sent one cycle apart

_NS_PER_MS: Final = 1_000_000
_NONE: Final = -1


class FrameReason(IntEnum):
    """Why a frame was not used; OK is 0."""

    OK = 0
    UNKNOWN_ID = 1  # not a message that is looked at: ignored, not rejected
    REMOTE_OR_ERROR = 2
    SHORT = 3
    BAD_CRC = 4
    REPEATED = 5  # the counter did not move
    WRONG_SEQUENCE = 6  # the counter moved further than time permits


_OK: Final = int(FrameReason.OK)
_REPEATED: Final = int(FrameReason.REPEATED)
_WRONG_SEQUENCE: Final = int(FrameReason.WRONG_SEQUENCE)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameVerdicts:
    """One verdict per frame."""

    reason: UInt8Array  # (n,) of FrameReason
    slot: Int64Array  # (n,) index of the message, -1 if the frame belongs to none
    sequence: Int64Array  # (n,) transmission number of accepted protected frames, else -1
    missing: Int64Array  # (n,) frames found missing at this one; negative takes back what was counted before


class LinkState(NamedTuple):
    """What is remembered of each message, arrays of shape (m,); counters are -1 where there is none."""

    valid_counter: Int64Array  # last accepted frame
    valid_ns: Int64Array
    sequence: Int64Array  # its transmission number
    stray_counter: Int64Array  # last frame rejected for its jump
    stray_ns: Int64Array
    seen_counter: Int64Array  # last frame with a good CRC
    seen_ns: Int64Array
    is_stuck: Int64Array
    rejected: Int64Array  # frames rejected since the last accepted one that stood in for a transmission
    rejected_after_stray: Int64Array
    late: Int64Array  # cycles by which the sender may still catch up; fades while it does not
    assumed: Int64Array  # frames counted as missing at the last accepted frame on the evidence of time alone


@kernel
def elapsed_cycles(elapsed_ns: int, cycle_ns: int) -> float:
    """Return elapsed time in cycles; -1 if the cycle time is unknown."""
    return elapsed_ns / cycle_ns if cycle_ns > 0 else -1.0


@kernel
def whole_periods(delta: int, cycles: float) -> int:
    """Return how many counter periods passed unseen, if the frame is on time for that; else 0."""
    periods = round((cycles - delta) / COUNTER_PERIOD)
    if periods > 0 and abs(cycles - delta - COUNTER_PERIOD * periods) <= LATE_CYCLES:
        return int(periods)
    return 0


@kernel
def permitted_advance(counter: int, since: int, cycles: float, late: int) -> int:
    """Return by how many transmissions ``counter`` follows the counter ``since``; 0 if time does not permit it.

    A sender that was ``late`` by some cycles may catch up by as many.
    """
    delta = (counter - since) % COUNTER_PERIOD
    periods = whole_periods(delta, cycles)
    if periods > 0:
        return delta + COUNTER_PERIOD * periods
    limit = MAX_DELTA_COUNTER - 1 + max(1, round(cycles) + late)
    return delta if delta <= limit else 0


@kernel
def accept(state: LinkState, slot: int, counter: int, t_ns: int, advance: int, proven: int, cycles: float) -> int:
    """Move the state on to an accepted frame; return how many frames are missing before it.

    ``advance`` counts transmissions since the last accepted frame, ``proven`` those that the counter itself shows.
    """
    missing = max(0, advance - 1 - int(state.rejected[slot]))
    assumed = missing - max(0, proven - 1 - int(state.rejected[slot]))
    if cycles >= BURST_CYCLES:
        late = max(int(state.late[slot]) - 1, round(cycles) - advance)
    else:
        late = int(state.late[slot]) - advance
        missing -= int(state.assumed[slot])
    state.late[slot] = max(0, late)
    state.assumed[slot] = assumed
    state.sequence[slot] += advance
    state.valid_counter[slot] = counter
    state.valid_ns[slot] = t_ns
    state.stray_counter[slot] = _NONE
    state.rejected[slot] = 0
    return missing


@kernel
def is_repeated(state: LinkState, slot: int, counter: int, t_ns: int, cycle_ns: int) -> bool:
    """Return whether the counter has not moved since the last frame; remember the frame."""
    same = counter == state.seen_counter[slot]
    cycles = elapsed_cycles(t_ns - state.seen_ns[slot], cycle_ns)
    repeated = same and (state.is_stuck[slot] == 1 or whole_periods(0, cycles) == 0)
    if repeated and cycles >= BURST_CYCLES:
        state.rejected[slot] += 1
        state.rejected_after_stray[slot] += 1
    state.is_stuck[slot] = 1 if repeated else 0
    state.seen_counter[slot] = counter
    state.seen_ns[slot] = t_ns
    return repeated


@kernel
def judge(state: LinkState, slot: int, counter: int, t_ns: int, cycle_ns: int) -> tuple[int, int]:
    """Return reason and missing frames of one frame with a good CRC, and move the state on."""
    if counter >= COUNTER_PERIOD:
        state.rejected[slot] += 1
        return _WRONG_SEQUENCE, 0
    if is_repeated(state, slot, counter, t_ns, cycle_ns):
        return _REPEATED, 0
    if state.valid_counter[slot] == _NONE:
        state.rejected[slot] = 0
        return _OK, accept(state, slot, counter, t_ns, 1, 1, -1.0)
    cycles = elapsed_cycles(t_ns - state.valid_ns[slot], cycle_ns)
    advance = permitted_advance(counter, state.valid_counter[slot], cycles, state.late[slot])
    if advance > 0:
        proven = (counter - state.valid_counter[slot]) % COUNTER_PERIOD
        return _OK, accept(state, slot, counter, t_ns, advance, proven, cycles)
    if state.stray_counter[slot] != _NONE:
        stray_cycles = elapsed_cycles(t_ns - state.stray_ns[slot], cycle_ns)
        restarted = permitted_advance(counter, state.stray_counter[slot], stray_cycles, 0)
        if restarted > 0:
            # How many were sent around the restart nobody knows: time numbers them, only the counter proves a loss.
            missing = max(0, restarted - 1 - state.rejected_after_stray[slot])
            by_time = max(1, round(cycles)) if cycle_ns > 0 else restarted + state.rejected[slot]
            accept(state, slot, counter, t_ns, by_time, by_time, -1.0)
            return _OK, missing
    state.stray_counter[slot] = counter
    state.stray_ns[slot] = t_ns
    state.rejected_after_stray[slot] = 0
    if not 0.0 <= cycles < BURST_CYCLES:
        state.rejected[slot] += 1
    return _WRONG_SEQUENCE, 0


@kernel
def follow_counters(
    state: LinkState,
    slot: Int64Array,
    t_ns: Int64Array,
    counter: UInt8Array,
    reason: UInt8Array,
    cycle_ns: Int64Array,
    is_protected: UInt8Array,
    sequence: Int64Array,
    missing: Int64Array,
) -> None:
    """Judge frames in their order; fills ``reason``, ``sequence`` and ``missing``, all of shape (n,)."""
    for i in range(slot.size):
        link = slot[i]
        if link < 0 or is_protected[link] == 0:
            continue
        if reason[i] != _OK:
            state.rejected[link] += 1
            state.rejected_after_stray[link] += 1
            continue
        verdict, lost = judge(state, link, int(counter[i]), t_ns[i], cycle_ns[link])
        reason[i] = verdict
        missing[i] = lost
        if verdict == _OK:
            sequence[i] = state.sequence[link]


class LinkMonitor:
    """Judges the frames of the messages that are looked at; verdicts do not depend on how the stream was cut.

    Messages whose database names no data id are checked for their length only.

    Raises
    ------
    ConfigError
        If two messages share an identifier, or a protected one does not have 8 bytes.
    """

    def __init__(self, messages: Sequence[Message]) -> None:
        contracts = [message_contract(message) for message in messages]
        flags = np.array([EXTENDED_FLAG if message.is_extended_frame else 0 for message in messages], np.uint32)
        ids: UInt32Array = np.array([contract.can_id for contract in contracts], np.uint32) | flags
        self._order = np.argsort(ids)
        self._ids = ids[self._order]
        _refuse_unusable(messages, self._ids)
        self._min_length = np.array([min(message.length, FD_PAYLOAD_BYTES) for message in messages], np.uint8)
        self._is_protected = np.array([contract.data_id is not None for contract in contracts], np.uint8)
        self._id_remainder = np.array([data_id_remainder(contract.data_id or 0) for contract in contracts], np.uint8)
        self._cycle_ns = np.array([contract.cycle_ms * _NS_PER_MS for contract in contracts], np.int64)
        self._state = LinkState(*(np.full(len(messages), _NONE, np.int64) for _ in LinkState._fields))
        self._counts = np.zeros((len(messages) + 1, len(FrameReason)), np.int64)
        self._missing = np.zeros(len(messages), np.int64)
        self.reset()
        self.check(empty_batch())  # compiles now: the first real batch must not wait for the compiler

    @property
    def counts(self) -> Int64Array:
        """Frames by message and reason, shape (m + 1, reasons); the last row counts frames of no message."""
        return self._counts.copy()

    @property
    def missing(self) -> Int64Array:
        """Frames that the counter shows were sent but never came, by message, shape (m,)."""
        return self._missing.copy()

    def reset(self) -> None:
        """Forget counters and times, after a jump of bus time; counts and sequence numbers go on."""
        for name, column in zip(LinkState._fields, self._state, strict=True):
            if name != "sequence":
                column[:] = _NONE if name.endswith("counter") else 0

    def check(self, batch: FrameBatch) -> FrameVerdicts:
        """Return a verdict on each frame and count it."""
        slot, reason = self._known(batch)
        rows = np.maximum(slot, 0)  # frames of no message are judged already and keep their reason
        if len(self._ids):
            candidate = reason == FrameReason.OK
            is_short = candidate & (batch.length < self._min_length[rows])
            reason[is_short] = FrameReason.SHORT
            to_check = candidate & ~is_short & self._is_protected[rows].astype(np.bool_)
            reason[to_check & ~crc_is_valid(batch.data[:, :PAYLOAD_BYTES], self._id_remainder[rows])] = (
                FrameReason.BAD_CRC
            )
        sequence = np.full(len(batch), _NONE, np.int64)
        missing = np.zeros(len(batch), np.int64)
        t_ns = np.require(batch.t_ns, np.int64, ("C", "W"))  # one array type: the kernel is compiled once
        follow_counters(
            self._state, slot, t_ns, counter_of(batch.data), reason, self._cycle_ns, self._is_protected,
            sequence, missing,
        )  # fmt: skip
        self._count(slot, reason, missing)
        return FrameVerdicts(reason=reason, slot=slot, sequence=sequence, missing=missing)

    def _known(self, batch: FrameBatch) -> tuple[Int64Array, UInt8Array]:
        """Return the message of each frame, -1 for none, and the reason for those that have none."""
        reason = np.full(len(batch), FrameReason.UNKNOWN_ID, np.uint8)
        slot = np.full(len(batch), _NONE, np.int64)
        if len(self._ids):
            place = np.minimum(np.searchsorted(self._ids, batch.can_id), len(self._ids) - 1)
            is_known = self._ids[place] == batch.can_id
            slot[is_known] = self._order[place[is_known]]
            reason[is_known] = FrameReason.OK
        reason[(batch.can_id & np.uint32(REMOTE_FLAG | ERROR_FLAG)) != 0] = FrameReason.REMOTE_OR_ERROR
        return slot, reason

    def _count(self, slot: Int64Array, reason: UInt8Array, missing: Int64Array) -> None:
        """Add one batch to the counts."""
        cells = slot * len(FrameReason) + reason
        cells[slot < 0] += self._counts.size
        self._counts += np.bincount(cells, minlength=self._counts.size).reshape(self._counts.shape)
        found = np.flatnonzero(missing)
        np.add.at(self._missing, slot[found], missing[found])


def _refuse_unusable(messages: Sequence[Message], sorted_ids: UInt32Array) -> None:
    """Raise ConfigError for messages that cannot be told apart or whose protection is not understood."""
    twice = sorted_ids[1:][sorted_ids[1:] == sorted_ids[:-1]]
    if len(twice):
        raise ConfigError(f"several messages have the identifier {int(twice[0]) & ~EXTENDED_FLAG:#x}")
    for message in messages:
        if message_contract(message).data_id is not None and message.length != PAYLOAD_BYTES:
            raise ConfigError(f"{message.name}: protection is understood for messages of {PAYLOAD_BYTES} bytes only")
