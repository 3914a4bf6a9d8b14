"""Few frames at a time, as a live bus brings them: all signals in one compiled pass.

Array operations cost the same for ten frames as for a thousand; here they would cost more than the frames. What comes
out is the same to the bit.
"""

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array, UInt8Array, UInt32Array
from canlog.decode.bit_fields import WORD_BITS, WORD_BYTES
from canlog.decode.signal_table import NO_INVALID, InvalidCounts
from canlog.decode.value_codes import IntegerCode
from canlog.e2e.frame_judge import FrameReason
from canlog.e2e.protection_check import FrameVerdicts
from canlog.frames import ERROR_FLAG, MAX_GAP_NS, FrameBatch, empty_batch
from canlog.jit import array_kernel
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.sample_block import BlockLayout, SampleBlock, Samples
from diag_service.mapping.profile import Conversion
from diag_service.mapping.source_tables import SourceTable

SMALL_FRAMES: Final = 4096  # beyond it array operations are the faster way
LONGEST_BITS: Final = 62  # signed or not, a raw value fits into an int64
_HAS_BAD: Final = 1  # bits of what a pass found
_HAS_INVALID: Final = 2
_OK: Final = int(FrameReason.OK)
_SHORT: Final = int(FrameReason.SHORT)
_WRONG_SEQUENCE: Final = int(FrameReason.WRONG_SEQUENCE)


class SmallColumn(NamedTuple):
    """One canonical signal of a message."""

    slot: int
    signal: Signal
    table: SourceTable
    to_si: Conversion
    period_ns: int


class SignalRules(NamedTuple):
    """How every signal is read, arrays of shape (k,) in the order of their messages."""

    begin: Int64Array  # (m + 1,) where the signals of a message begin
    row: Int64Array  # in the block
    first_byte: Int64Array
    is_big: Int64Array
    shift: Int64Array
    length: Int64Array
    is_signed: Int64Array
    low: Int64Array  # raw values that the database calls valid
    high: Int64Array
    scale: FloatArray
    offset: FloatArray
    si_factor: FloatArray
    si_offset: FloatArray
    code_begin: Int64Array  # (k + 1,) where the codes that are no measurements begin
    code_first: Int64Array  # ranges of them
    code_last: Int64Array


class SmallBatchDecoder:
    """Decodes the accepted frames of small batches into blocks; ``is_able`` tells for which signals.

    Parameters
    ----------
    columns : sequence of SmallColumn
        All signals of the messages that are looked at, in the order of their slots.
    message_count : int
        Number of slots.
    """

    def __init__(self, columns: Sequence[SmallColumn], message_count: int) -> None:
        self._layout = BlockLayout([column.signal for column in columns], [column.period_ns for column in columns])
        self._rules = _rules_of(columns, self._layout, message_count)
        nothing = np.empty(0, np.int64)
        self.decode(
            empty_batch(),
            FrameVerdicts(reason=np.empty(0, np.uint8), slot=nothing, sequence=nothing, missing=nothing),
        )  # compiles now: the first real batch must not wait for the compiler
        is_seamless(nothing, np.empty(0, np.uint32), 0)

    def decode(
        self, batch: FrameBatch, verdicts: FrameVerdicts
    ) -> tuple[SampleBlock, dict[Signal, InvalidCounts], bool]:
        """Return the columns, which values of each signal were invalid, and whether a frame was bad or missing."""
        samples = self._layout.room(len(batch))
        invalid = np.zeros((len(self._layout.signals), len(NO_INVALID)), np.int64)
        bad = decode_frames(
            self._rules,
            batch.t_ns,
            batch.data,
            verdicts.reason,
            verdicts.slot,
            verdicts.sequence,
            verdicts.missing,
            samples,
            invalid,
        )
        counts = {}
        if bad & _HAS_INVALID:
            rows = np.flatnonzero(invalid.any(axis=1))
            counts = {self._layout.signals[row]: InvalidCounts(*invalid[row].tolist()) for row in rows}
        return SampleBlock(self._layout, samples), counts, bool(bad & _HAS_BAD)


def is_able(table: SourceTable) -> bool:
    """Return whether a signal is plain enough: an integer of its own, in one word, always in its message."""
    main = table.main
    return (
        (table.less, table.times, table.valid, table.invalid) == (None, None, None, ())
        and not main.selectors
        and not main.field.spill
        and main.field.length <= LONGEST_BITS
        and isinstance(main.code, IntegerCode)
        and main.code.is_exact_in_float
    )


def _rules_of(columns: Sequence[SmallColumn], layout: BlockLayout, message_count: int) -> SignalRules:
    slots = [column.slot for column in columns]
    fields = [column.table.main.field for column in columns]
    codes = [code for column in columns if isinstance(code := column.table.main.code, IntegerCode)]
    return SignalRules(
        begin=np.searchsorted(np.array(slots, np.int64), np.arange(message_count + 1)).astype(np.int64),
        row=_integers(layout.row[column.signal] for column in columns),
        first_byte=_integers(field.first_byte for field in fields),
        is_big=_integers(field.is_big for field in fields),
        shift=_integers(field.shift for field in fields),
        length=_integers(field.length for field in fields),
        is_signed=_integers(field.is_signed for field in fields),
        low=_integers(code.raw_range[0] for code in codes),
        high=_integers(code.raw_range[1] for code in codes),
        scale=np.array([code.scale for code in codes], np.float64),
        offset=np.array([code.offset for code in codes], np.float64),
        si_factor=np.array([column.to_si.factor for column in columns], np.float64),
        si_offset=np.array([column.to_si.offset for column in columns], np.float64),
        code_begin=_integers(accumulate((len(code.not_available) for code in codes), initial=0)),
        code_first=_integers(first for code in codes for first, _ in code.not_available),
        code_last=_integers(last for code in codes for _, last in code.not_available),
    )


def _integers(values: Iterable[int]) -> Int64Array:
    return np.array(list(values), np.int64)


@array_kernel
def is_seamless(t_ns: Int64Array, can_id: UInt32Array, before_ns: int) -> bool:
    """Return whether bus time goes on as it should, from ``before_ns`` on, and the controller reports nothing."""
    for row in range(t_ns.size):
        step_ns = t_ns[row] - before_ns
        if step_ns < 0 or step_ns > MAX_GAP_NS or can_id[row] & ERROR_FLAG:
            return False
        before_ns = t_ns[row]
    return True


@array_kernel
def decode_frames(
    rules: SignalRules,
    t_ns: Int64Array,
    data: UInt8Array,
    reason: UInt8Array,
    slot: Int64Array,
    sequence: Int64Array,
    missing: Int64Array,
    samples: Samples,
    invalid: Int64Array,
) -> int:
    """Fill in the samples of the accepted frames; return what was not as it should be."""
    found = 0
    for frame in range(t_ns.size):
        if missing[frame] > 0 or _SHORT <= reason[frame] <= _WRONG_SEQUENCE:
            found |= _HAS_BAD
        if reason[frame] != _OK:
            continue
        for number in range(rules.begin[slot[frame]], rules.begin[slot[frame] + 1]):
            raw = raw_value(rules, number, data[frame])
            row = rules.row[number]
            is_code = is_no_value(rules, number, raw)
            if is_code or not rules.low[number] <= raw <= rules.high[number]:
                invalid[row, 0 if is_code else 1] += 1
                found |= _HAS_INVALID
                continue
            at = samples.filled[row]
            samples.t_ns[row, at] = t_ns[frame]
            samples.sequence[row, at] = sequence[frame]
            value = float(raw) * rules.scale[number] + rules.offset[number]
            samples.value[row, at] = value * rules.si_factor[number] + rules.si_offset[number]
            samples.filled[row] = at + 1
    return found


@array_kernel
def raw_value(rules: SignalRules, number: int, payload: UInt8Array) -> int:
    """Return the raw value of a signal."""
    word = np.uint64(0)
    first = rules.first_byte[number]
    for place in range(WORD_BYTES):
        index = first + place
        byte = np.uint64(payload[index]) if index < payload.size else np.uint64(0)
        position = WORD_BYTES - 1 - place if rules.is_big[number] else place
        word |= byte << np.uint64(8 * position)
    length = rules.length[number]
    word = word << np.uint64(WORD_BITS - rules.shift[number] - length)
    if rules.is_signed[number]:
        return int(np.int64(word) >> np.int64(WORD_BITS - length))
    return int(word >> np.uint64(WORD_BITS - length))


@array_kernel
def is_no_value(rules: SignalRules, number: int, raw: int) -> bool:
    """Return whether a raw value is one of the codes that say that there is no value."""
    for place in range(rules.code_begin[number], rules.code_begin[number + 1]):
        if rules.code_first[place] <= raw <= rules.code_last[place]:
            return True
    return False
