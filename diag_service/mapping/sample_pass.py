"""All plain signals of all frames in one compiled pass: few frames as a live bus brings them, or many of a log."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, UInt8Array, UInt32Array
from canlog.database.addressing import NOBODY, sort_by_slot
from canlog.decode.codec import SignalRules, decode_signal, signal_rules
from canlog.decode.signals import InvalidCounts, pick_words
from canlog.e2e.protection_check import FrameReason, FrameVerdicts
from canlog.frames import ERROR_FLAG, MAX_GAP_NS, FrameBatch, empty_batch
from canlog.jit import array_kernel, inlined_kernel
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.sample_block import BlockLayout, SampleBlock, Samples
from diag_service.mapping.mapped_messages import MessageColumns, SourceTable

_HAS_BAD: Final = 1  # bits of what a pass found
_HAS_INVALID: Final = 2
_OK: Final = int(FrameReason.OK)
_SHORT: Final = int(FrameReason.SHORT)
_WRONG_SEQUENCE: Final = int(FrameReason.WRONG_SEQUENCE)


class DecodedFrames(NamedTuple):
    """What a pass made of a batch."""

    samples: SampleBlock
    invalid: dict[Signal, InvalidCounts]  # values that are no measurements, of signals that had any
    has_bad: bool  # a frame of a followed message was rejected, or is missing
    order: Int64Array  # rows of the accepted frames, sorted by message
    stop: Int64Array  # (m + 1,) where those of message k end, in ``stop[k + 1]``

    def rows(self, slot: int) -> Int64Array:
        """Return the rows of the accepted frames of a message, rising."""
        return self.order[self.stop[slot] : self.stop[slot + 1]]


class SamplePass:
    """Decodes the accepted frames of a batch into a block of samples; ``is_able`` tells which signals.

    The messages are those that are looked at, in the order of their slots.
    """

    def __init__(self, messages: Sequence[MessageColumns]) -> None:
        able = [[column for column in mapped.columns if is_able(column.table)] for mapped in messages]
        columns = [column for own in able for column in own]
        periods_ns = [mapped.period_ns for mapped, own in zip(messages, able, strict=True) for _ in own]
        self._layout = BlockLayout([column.signal for column in columns], periods_ns)
        self._rules = signal_rules([[column.table.main for column in own] for own in able])
        self._to_si = np.array([(one.to_si.factor, one.to_si.offset) for one in columns], np.float64).reshape(-1, 2)
        self._word_count = int(np.diff(self._rules.word_begin).max(initial=0))
        self.decode(empty_batch(), FrameVerdicts.room(0))  # compiles now: the first real batch must not wait
        is_seamless(np.empty(0, np.int64), np.empty(0, np.uint32), 0)

    def decode(self, batch: FrameBatch, verdicts: FrameVerdicts) -> DecodedFrames:
        """Return the samples of a batch, and what was left out."""
        count = len(batch)
        samples = self._layout.room(count)
        invalid = np.zeros((len(self._layout.signals), 2), np.int64)
        stop = np.zeros(len(self._rules.begin), np.int64)
        scratch = np.empty((self._word_count + 2, count), np.int64)
        found = decode_samples(
            self._rules, self._to_si, batch.data, batch.t_ns, verdicts, stop, scratch, samples, invalid
        )
        counts: dict[Signal, InvalidCounts] = {}
        if found & _HAS_INVALID:
            signals = np.flatnonzero(invalid.any(axis=1)).tolist()
            counts = {self._layout.signals[row]: InvalidCounts(*invalid[row].tolist()) for row in signals}
        return DecodedFrames(
            SampleBlock(self._layout, samples), counts, bool(found & _HAS_BAD), order=scratch[0], stop=stop
        )


def is_able(table: SourceTable) -> bool:
    """Return whether a signal is plain enough: an integer of its own, in one word, always in its message."""
    is_alone = (table.less, table.times, table.valid, table.invalid) == (None, None, None, ())
    return is_alone and not table.main.selectors and table.main.is_plain


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
def sort_accepted(verdicts: FrameVerdicts, accepted: Int64Array, order: Int64Array, stop: Int64Array) -> int:
    """Sort the rows of accepted frames by message; return ``_HAS_BAD`` if any frame was."""
    found = 0
    for row in range(verdicts.slot.size):
        reason = verdicts.reason[row]
        if verdicts.missing[row] > 0 or _SHORT <= reason <= _WRONG_SEQUENCE:
            found = _HAS_BAD
        accepted[row] = verdicts.slot[row] if reason == _OK else NOBODY
    sort_by_slot(accepted, order, stop)
    return found


@array_kernel
def decode_samples(
    rules: SignalRules,
    to_si: FloatArray,
    data: UInt8Array,
    t_ns: Int64Array,
    verdicts: FrameVerdicts,
    stop: Int64Array,
    scratch: Int64Array,
    samples: Samples,
    invalid: Int64Array,
) -> int:
    """Fill in the samples of accepted frames, in SI; count what is no measurement, and return what was found.

    The first row of ``scratch`` becomes the order of the accepted frames.
    """
    order, good = scratch[0], scratch[1].view(np.bool_)
    payloads = data.view(np.uint64)
    found = sort_accepted(verdicts, scratch[1], order, stop)
    for message in range(stop.size - 1):
        own = order[stop[message] : stop[message + 1]]
        if not own.size:
            continue
        words = scratch[2:, : own.size].view(np.uint64)
        first_word = rules.word_begin[message]
        pick_words(payloads, own, rules.word[first_word : rules.word_begin[message + 1]], words)
        for row in range(rules.begin[message], rules.begin[message + 1]):
            decode_signal(words[rules.signal[row]["word"]], rules, row, samples.value[row], good, invalid[row])
            has_invalid = invalid[row, 0] + invalid[row, 1] > 0
            found |= _HAS_INVALID if has_invalid else 0
            keep(own, t_ns, verdicts.sequence, samples, row, to_si[row], good, has_invalid)
    return found


@inlined_kernel
def keep(
    rows: Int64Array,
    t_ns: Int64Array,
    sequence: Int64Array,
    samples: Samples,
    row: int,
    to_si: FloatArray,
    good: BoolArray,
    has_invalid: bool,  # noqa: FBT001 - a compiled function
) -> None:
    """Bring the values of a signal to SI and give them their times, those that are measurements."""
    kept = 0
    for at in range(rows.size):
        if has_invalid and not good[at]:
            continue
        samples.value[row, kept] = samples.value[row, at] * to_si[0] + to_si[1]
        samples.t_ns[row, kept] = t_ns[rows[at]]
        samples.sequence[row, kept] = sequence[rows[at]]
        kept += 1
    samples.filled[row] = kept
