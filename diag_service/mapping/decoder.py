"""Frames become canonical columns: protection check, bit fields, SI units, and a count of everything left out."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Database

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series, UInt64Array
from canlog.database.addressing import NOBODY, kernel_filters, sorted_by_slot
from canlog.decode.compiled import SignalRules, decode_signal, pick_word, signal_rules
from canlog.decode.signals import NO_INVALID, InvalidCounts, PayloadWords, payload_words
from canlog.e2e.bus_time import BusTime
from canlog.e2e.e2e_state import E2eState, E2eStates
from canlog.e2e.protection_check import FrameReason, FrameVerdicts, LinkMonitor
from canlog.frames import BusTrouble, FrameBatch, empty_batch, is_error, reports
from canlog.jit import kernel, part
from canlog.logs.log_counts import LEAST_PER_S, WATCHED_FRAMES
from canlog.time_order import in_order
from clutch_model.units import NS_PER_S
from diag_service.diagnosis.columns import (
    SUMMED_SIGNALS,
    BlockLayout,
    ColumnBatch,
    Columns,
    ColumnSamples,
    GearRatios,
    SampleBlock,
    Signal,
)
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.mapping.asked_signals import Overheard
from diag_service.mapping.mapped_messages import FRICTION_SIGNALS, MessageColumns, SourceTable, map_signals
from diag_service.mapping.profile import Profile


class DecodedFrames(NamedTuple):
    """What a pass made of a batch."""

    samples: SampleBlock
    invalid: dict[Signal, InvalidCounts]  # values that are no measurements, of signals that had any
    order: Int64Array  # rows, sorted by message where their frames were accepted
    begin: Int64Array  # (m + 1,) where those of a message begin

    def rows(self, slot: int) -> Int64Array:
        """Return the rows of the accepted frames of a message, rising."""
        return self.order[self.begin[slot] : self.begin[slot + 1]]


class AcceptedFrames(NamedTuple):
    """The accepted frames of a batch, in the form the kernel takes."""

    order: Int64Array  # as in `DecodedFrames`
    begin: Int64Array
    payloads: UInt64Array  # (n, words)
    t_ns: Int64Array
    sequence: Int64Array


class SamplePass:
    """Decodes the accepted frames of a batch into a block of samples; ``is_able`` tells which signals.

    The messages are those that are looked at, in the order of their slots.
    """

    def __init__(self, messages: Sequence[MessageColumns]) -> None:
        able = [[column for column in mapped.columns if is_able(column.table)] for mapped in messages]
        columns = [column for plain in able for column in plain]
        periods_ns = [mapped.period_ns for mapped, plain in zip(messages, able, strict=True) for _ in plain]
        self._layout = BlockLayout([column.signal for column in columns], periods_ns)
        self._rules = signal_rules([[column.table.main for column in plain] for plain in able])
        factors = [(column.to_si.factor, column.to_si.offset) for column in columns]
        self._to_si = np.array(factors, np.float64).reshape(-1, 2)
        self._word_count = int(np.diff(self._rules.word_begin).max(initial=0))
        self.decode(empty_batch(), FrameVerdicts.room(0))  # compiles now: the first real batch must not wait

    def decode(self, batch: FrameBatch, verdicts: FrameVerdicts) -> DecodedFrames:
        """Return the samples of a batch, and what was left out."""
        count = len(batch)
        slots = np.where(verdicts.reason == FrameReason.OK, verdicts.slot, NOBODY)
        order, begin = sorted_by_slot(slots, len(self._rules.begin) - 1)
        frames = AcceptedFrames(order, begin, payload_words(batch.data), batch.t_ns, verdicts.sequence)
        samples = self._layout.room(count)
        invalid = np.zeros((len(self._layout.signals), 2), np.int64)
        words, good = np.empty((self._word_count, count), np.uint64), np.empty(count, np.bool_)
        decode_samples(self._rules, self._to_si, frames, words, good, samples, invalid)
        signals = np.flatnonzero(invalid.any(axis=1)).tolist()
        counts = {self._layout.signals[row]: InvalidCounts(*invalid[row].tolist()) for row in signals}
        return DecodedFrames(SampleBlock(self._layout, samples), counts, order, begin)


def is_able(table: SourceTable) -> bool:
    """Return whether a signal is plain enough: an integer of its own, in one word, always in its message."""
    return not table.is_corrected and not table.main.selectors and table.main.is_plain


@kernel
def decode_samples(
    rules: SignalRules,
    to_si: FloatArray,
    frames: AcceptedFrames,
    words: UInt64Array,
    good: BoolArray,
    samples: ColumnSamples,
    invalid: Int64Array,
) -> None:
    """Fill in the samples of accepted frames, in SI, and count what is no measurement."""
    for message in range(frames.begin.size - 1):
        rows = frames.order[frames.begin[message] : frames.begin[message + 1]]
        if not rows.size:
            continue
        first_word = rules.word_begin[message]
        for number in range(first_word, rules.word_begin[message + 1]):
            pick_word(frames.payloads, rows, rules.word[number], words[number - first_word])
        for row in range(rules.begin[message], rules.begin[message + 1]):
            word = words[rules.signal[row]["word"], : rows.size]
            decode_signal(word, rules, row, samples.value[row], good, invalid[row])
            has_invalid = invalid[row, 0] + invalid[row, 1] > 0
            keep(rows, frames, samples, row, to_si[row], good, has_invalid)


@part
def keep(
    rows: Int64Array,
    frames: AcceptedFrames,
    samples: ColumnSamples,
    row: int,
    to_si: FloatArray,
    good: BoolArray,
    has_invalid: bool,  # noqa: FBT001 - a compiled function
) -> None:
    """Bring the values of a signal to SI and give them their times, those that are measurements."""
    count = 0
    for at in range(rows.size):
        if has_invalid and not good[at]:
            continue
        samples.value[row, count] = samples.value[row, at] * to_si[0] + to_si[1]
        samples.t_ns[row, count] = frames.t_ns[rows[at]]
        samples.sequence[row, count] = frames.sequence[rows[at]]
        count += 1
    samples.filled[row] = count


PIECE_FRAMES: Final = 8192  # their samples stay in the cache, and in memory that the system need not map anew
AT_ONCE_NS: Final = 100_000  # steps below it no bus makes: a frame of 8 bytes takes longer at 1 Mbit/s
LEAST_AT_ONCE: Final = 2.5  # frames at each look of a reader, on average
MOST_SINGLE: Final = 0.1  # frames between looks, over the looks
LEAST_LOOKS: Final = 20
_NEVER: Final = np.empty(0, np.int64)

REJECTIONS: Final = tuple(reason for reason in FrameReason if reason not in {FrameReason.OK, FrameReason.UNKNOWN_ID})


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageCounts:
    """What became of the frames of one message, and what it is worth."""

    nominal_hz: float | None  # how often it should come; None: not cyclic
    decoded: int
    rejected: Mapping[FrameReason, int]  # reasons that occurred
    missing: int  # sent, says the alive counter, but never received
    e2e_state: E2eState
    invalidations: int  # times that the message as a whole lost its trust


class Rhythm:
    """Tells whether a reader looked at the bus now and then: all that has gathered comes at once, after a pause.

    When a frame was sent is then known to a look only, and in a rhythm in step with the bus nothing tells more.
    """

    def __init__(self, quickest_ns: int) -> None:
        self._pause_ns = quickest_ns // 2  # of the quickest message: a bus in use is never as quiet
        self._last_ns = 0
        self._frame_count = self._look_count = self._single_count = 0

    def add(self, t_ns: Int64Array) -> None:
        """Take the times at which frames were received into account, the oldest first."""
        if not self._pause_ns or not len(t_ns):
            return
        steps_ns = np.diff(t_ns, prepend=self._last_ns)
        looks = int(np.count_nonzero(steps_ns >= self._pause_ns))
        self._frame_count += len(t_ns)
        self._look_count += looks
        self._single_count += int(np.count_nonzero(steps_ns >= AT_ONCE_NS)) - looks
        self._last_ns = int(t_ns[-1])

    @property
    def is_of_looks(self) -> bool:
        """Whether nearly all frames came together with others, and nothing between two looks."""
        is_known = self._look_count >= LEAST_LOOKS and self._frame_count >= LEAST_AT_ONCE * self._look_count
        return is_known and self._single_count <= MOST_SINGLE * self._look_count


class Decoder:
    """Turns frames into canonical columns; what comes out does not depend on how the stream was cut.

    Raises ConfigError if the profile does not fit the database.
    """

    def __init__(self, database: Database, profile: Profile) -> None:
        self._messages = map_signals(database, profile)
        self._monitor = LinkMonitor(
            [mapped.message for mapped in self._messages], [mapped.address for mapped in self._messages]
        )
        self.gears: GearRatios | None = profile.gears
        self.profile_name, self.profile_sources = profile.name, profile.sources
        self._content = "values" if profile.is_table else "frames"
        self.named_channel = profile.channel
        self._e2e = E2eStates(
            [mapped.message.name for mapped in self._messages], [mapped.period_ns for mapped in self._messages]
        )
        self._pass = SamplePass(self._messages)
        self._composite = [
            (slot, composite)
            for slot, mapped in enumerate(self._messages)
            if (composite := [column for column in mapped.columns if not is_able(column.table)])
        ]
        self._turbine: Series | None = None  # its last sample, where engine speed is turbine speed plus slip
        self._invalid: dict[Signal, InvalidCounts] = {}
        self._invalid_at_first: dict[Signal, int] = {}  # before a signal's first real value
        self._slot_of = {column.signal: slot for slot, mapped in enumerate(self._messages) for column in mapped.columns}
        self._seen: set[Signal] = set()
        self.absent: frozenset[Signal] = frozenset()  # that are mapped, and taken as if they were not
        self._signal_count = len(self.signals)
        self.asked = {signal: field for signal, field in profile.asked.items() if signal in self._slot_of}
        self.asking = profile.asking
        self.groups = tuple({pgn: None for signal, pgn in profile.groups.items() if signal in self._slot_of})
        self.overheard = Overheard(list(self.asked.values())) if self.asked else None
        self.last_ns: int | None = None  # bus time of the last frame
        self._is_interrupted = False
        self._whole_ns: int | None = None  # since when all times are whole seconds
        self._whole_count = 0
        self._has_whole_seconds = False
        self._arrival, self._time = BusTime(self._monitor.book), BusTime(self._monitor.book)  # as received, as sent
        self._rhythm = Rhythm(min((mapped.period_ns for mapped in self._messages if mapped.period_ns > 0), default=0))

    @property
    def signals(self) -> frozenset[Signal]:
        """The canonical signals that this bus can deliver."""
        signals = frozenset(column.signal for mapped in self._messages for column in mapped.columns)
        return (signals | {Signal.ENGINE_SPEED} if signals >= SUMMED_SIGNALS else signals) - self.absent

    @property
    def seen(self) -> frozenset[Signal]:
        """The canonical signals of which at least one valid value came until now."""
        return frozenset(self._seen) - self.absent

    @property
    def optional_signals(self) -> frozenset[Signal]:
        """Those of them that a drive may lack without lacking anything."""
        return frozenset(column.signal for mapped in self._messages for column in mapped.columns if column.is_optional)

    @property
    def mandatory_messages(self) -> frozenset[str]:
        return frozenset(
            mapped.message.name
            for mapped in self._messages
            if any(column.signal in FRICTION_SIGNALS for column in mapped.columns)
        )

    @property
    def slow_messages(self) -> Mapping[str, tuple[int, int]]:
        """The messages that come plainly less often than the database says: their own cycle and that [ns]."""
        cycles = zip(self._messages, self._e2e.own_cycles_ns, strict=True)
        return {m.message.name: (own_ns, m.period_ns) for m, own_ns in cycles if own_ns > m.period_ns}

    @property
    def kernel_filters(self) -> tuple[tuple[int, int], ...]:
        """Identifier and mask, as SocketCAN wants them, of each message that is looked at."""
        asked = () if self.overheard is None else self.overheard.kernel_filters
        return (*kernel_filters([mapped.address for mapped in self._messages]), *asked)

    @property
    def limits(self) -> Mapping[Signal, tuple[float, float]]:
        """The ends of the scales of the signals for which the database tells them, SI."""
        columns = (column for mapped in self._messages for column in mapped.columns)
        return {column.signal: column.limits for column in columns if column.limits is not None}

    @property
    def counts(self) -> FrameCounts:
        """What became of all frames until now; how they came here, their source knows."""
        # What a controller was asked for is no frame of the bus.
        asked = [slot for slot, mapped in enumerate(self._messages) if mapped.columns[0].is_asked]
        counts = self._monitor.counts.sum(axis=0) - self._monitor.counts[asked].sum(axis=0)
        if self.overheard is not None:  # frames of dialogues are known by what they say, not by their identifier
            known = min(self.overheard.frame_count, int(counts[FrameReason.UNKNOWN_ID]))
            counts[FrameReason.OK] += known
            counts[FrameReason.UNKNOWN_ID] -= known
        invalid = {
            signal.value: {reason: count for reason, count in counts._asdict().items() if count}
            for signal, counts in self._invalid.items()
        }
        return FrameCounts(
            content=self._content,
            on_bus=int(counts.sum()),
            decoded=int(counts[FrameReason.OK]),
            ignored=int(counts[FrameReason.UNKNOWN_ID]),
            rejected={reason.name.lower(): count for reason, count in _rejected(counts).items()},
            missing=int(self._monitor.missing.sum()),
            late=int(self._monitor.held_back.sum()) + self._monitor.late.count + self._arrival.late_count,
            invalid_values=sum(sum(reasons.values()) for reasons in invalid.values()),
            invalid=invalid,
            invalid_at_first={signal.value: count for signal, count in self._invalid_at_first.items() if count},
        )

    @property
    def messages(self) -> Mapping[str, MessageCounts]:
        """What became of the frames of each message until now, and its state."""
        counts, missing = self._monitor.counts, self._monitor.missing
        states, invalidations = self._e2e.states, self._e2e.invalidations
        return {
            mapped.message.name: MessageCounts(
                nominal_hz=NS_PER_S / mapped.period_ns if mapped.period_ns > 0 else None,
                decoded=int(counts[slot, FrameReason.OK]),
                rejected=_rejected(counts[slot]),
                missing=int(missing[slot]),
                e2e_state=states[slot],
                invalidations=invalidations[slot],
            )
            for slot, mapped in enumerate(self._messages)
        }

    def stream(self, batch: FrameBatch) -> Iterator[ColumnBatch]:
        """Yield the columns of a batch bit by bit: as ``feed``, but a long one in pieces that suit the machine."""
        for first in range(0, len(batch), PIECE_FRAMES):
            yield from self.feed(batch if len(batch) <= PIECE_FRAMES else batch[first : first + PIECE_FRAMES])

    def whole(self, batches: Iterable[FrameBatch]) -> Iterator[ColumnBatch]:
        """Yield the columns of all frames until the last: what is held back when they end is theirs."""
        for batch in batches:
            yield from self.stream(batch)
        yield from self.drain()

    def feed(self, batch: FrameBatch) -> list[ColumnBatch]:
        """Return the columns of a batch: none if it is empty, several if bus time jumps inside it."""
        if self.overheard is None:
            return self._fed(batch)
        return [columns for part in self.overheard.feed(batch) for columns in self._fed(part)]

    def drain(self) -> list[ColumnBatch]:
        """Return the columns of frames that are held back until more is known: nothing is to follow soon."""
        parts = [] if self.overheard is None else list(self.overheard.drain())
        return [
            columns
            for number, part in enumerate((*parts, empty_batch()))
            for columns in self._fed(part, is_last=number == len(parts))
        ]

    def marked(self, events: Iterable[Event]) -> list[Event]:
        """Return events with what the times of all frames say: they are whole seconds, or those of a reader's looks."""
        events = list(events)  # decodes their frames first, as their times are judged below
        if self._rhythm.is_of_looks:
            events = [replace(event, came_late=True) for event in events]
        return [replace(event, has_whole_seconds=True) for event in events] if self._has_whole_seconds else events

    def _look_for_seconds(self, t_ns: Int64Array) -> None:
        if not len(t_ns):
            return
        if int(t_ns[-1]) % NS_PER_S or (t_ns % NS_PER_S).any():
            self._whole_ns, self._whole_count, self._has_whole_seconds = None, 0, False
            return
        self._whole_ns = int(t_ns[0]) if self._whole_ns is None else self._whole_ns
        self._whole_count += len(t_ns)
        most = WATCHED_FRAMES // LEAST_PER_S + LEAST_PER_S * abs(int(t_ns[-1]) - self._whole_ns) // NS_PER_S
        self._has_whole_seconds = self._whole_count > most

    def _fed(self, batch: FrameBatch, *, is_last: bool = False) -> list[ColumnBatch]:
        self._look_for_seconds(batch.t_ns)
        self._rhythm.add(batch.t_ns)
        batch = batch.plain()
        if self._goes_on(batch):
            self._monitor.late.learn(batch)
            self.last_ns = int(batch.t_ns[-1])
            columns, verdicts = self._decode(batch, breaks_before=False)
            for bus_time in (self._arrival, self._time):
                bus_time.go_on(batch.t_ns, verdicts)
            return [columns]
        batch, _ = in_order(replace(batch, t_ns=self._arrival.walk(batch).t_ns))
        parts: Iterable[FrameBatch] = (batch,)
        late = self._monitor.late
        if len(batch) or not late.is_idle:
            before_ns = int(batch.t_ns[0]) if self.last_ns is None else self.last_ns
            parts = late.parts(batch, before_ns, is_last=is_last)
        return [
            self._decode(segment, breaks_before=breaks)[0]
            for part in parts
            for segment, breaks in self._segments(part.plain())
        ]

    @property
    def sources(self) -> LinkMonitor:
        """Who follows each message from one source: a reader of several logs tells it where one begins and ends."""
        return self._monitor

    def interrupt(self) -> None:
        """End the segment: what comes next has nothing to do with what came before."""
        self._is_interrupted = True

    def _goes_on(self, batch: FrameBatch) -> bool:
        """Return whether the frames go on where the last ones ended, as they nearly always do."""
        if self.last_ns is None or self._is_interrupted or not len(batch):
            return False
        steps_ns, late = np.diff(batch.t_ns, prepend=self.last_ns), self._monitor.late
        is_seamless = steps_ns.min() >= 0 and steps_ns.max() <= late.silence_ns
        return late.is_idle and bool(is_seamless and not is_error(batch).any())

    def _segments(self, batch: FrameBatch) -> Iterator[tuple[FrameBatch, bool]]:
        """Cut a batch where bus time goes back or stands still for too long, and where the controller left the bus."""
        if not len(batch):
            return
        is_jump = self._time.walk(batch).is_break
        is_jump[0] |= self._is_interrupted
        is_break = is_jump | reports(batch, BusTrouble.BUS_OFF)
        # A controller that is off says so again and again: one stretch, until there is something else to hear.
        heard = np.cumsum(~is_error(batch))
        is_break[is_break] = is_jump[is_break] | (np.diff(heard[is_break], prepend=-1) > 0)
        jumps = np.flatnonzero(is_break).tolist()
        self.last_ns = int(batch.t_ns[-1])
        self._is_interrupted = False
        starts = jumps if jumps[:1] == [0] else [0, *jumps]
        for start, stop in zip(starts, [*starts[1:], len(batch)], strict=True):
            yield batch[start:stop], start in jumps

    def _decode(self, segment: FrameBatch, *, breaks_before: bool) -> tuple[ColumnBatch, FrameVerdicts]:
        """Return the columns of frames without a jump of bus time between them, and the verdict on each."""
        if breaks_before:
            self._monitor.reset()
            self._e2e.reset()
            self._turbine = None
        verdicts = self._monitor.check(segment)
        columns, bad_frame_ns = self._columns(segment, verdicts)
        if Signal.ENGINE_SPEED not in self._slot_of:
            columns = self._with_engine_speed(columns)
        if len(self._seen) < self._signal_count:
            self._seen |= columns.keys()
        batch = ColumnBatch(
            columns=columns,
            watermark_ns=int(segment.t_ns[-1]),
            breaks_before=breaks_before,
            bad_frame_ns=bad_frame_ns,
            e2e_changes=self._e2e.judge(segment.t_ns, verdicts),
        )
        return batch, verdicts

    def _with_engine_speed(self, columns: Columns) -> Columns:
        """Return columns with engine speed at the times of slip, if turbine speed is known there."""
        slip, turbine = (columns.get(signal) for signal in (Signal.LOCKUP_SLIP, Signal.TURBINE_SPEED))
        parts = [part for part in (self._turbine, turbine) if part is not None and len(part.t_ns)]
        if parts:
            last_ns = int(parts[-1].t_ns[-1])
            self._turbine = parts[-1].between(last_ns, last_ns + 1).copy()
        if slip is None or not parts:
            return columns
        t_ns, speed = np.concatenate([part.t_ns for part in parts]), np.concatenate([part.value for part in parts])
        engine = replace(slip, value=slip.value + np.interp(slip.t_ns, t_ns, speed))
        return {**columns, Signal.ENGINE_SPEED: engine}

    def _columns(self, segment: FrameBatch, verdicts: FrameVerdicts) -> tuple[Columns, Int64Array]:
        """Return the samples of accepted frames, and when messages failed."""
        decoded = self._pass.decode(segment, verdicts)
        for signal, counts in decoded.invalid.items():
            if signal in self._seen:
                self._count_invalid(signal, counts)
                continue
            times_ns = segment.t_ns[decoded.rows(self._slot_of[signal])]
            self._count_invalid(signal, counts, times_ns, decoded.samples.get(signal))
        bad_frame_ns = _bad_frame_ns(segment, verdicts)
        if not self._composite:
            return decoded.samples, bad_frame_ns
        return {**decoded.samples, **self._composite_columns(segment, verdicts, decoded)}, bad_frame_ns

    def _composite_columns(self, segment: FrameBatch, verdicts: FrameVerdicts, decoded: DecodedFrames) -> Columns:
        """Return the samples of the signals that are more than plain integers, each by operations on arrays."""
        series: dict[Signal, Series] = {}
        for slot, columns in self._composite:
            rows = decoded.rows(slot)
            if not len(rows):
                continue
            words = PayloadWords(segment.data, rows)
            for column in columns:
                decoded_column = column.table.decode(words)
                good = slice(None) if decoded_column.is_good is None else decoded_column.is_good
                if len(valid_rows := rows[good]):
                    series[column.signal] = Series(
                        t_ns=segment.t_ns[valid_rows],
                        sequence=verdicts.sequence[valid_rows],
                        value=column.to_si(decoded_column.value[good]),
                        period_ns=self._messages[slot].period_ns,
                    )
                if decoded_column.invalid.total:
                    times_ns = segment.t_ns[rows]
                    self._count_invalid(column.signal, decoded_column.invalid, times_ns, series.get(column.signal))
        return series

    def _count_invalid(
        self, signal: Signal, counts: InvalidCounts, t_ns: Int64Array = _NEVER, real: Series | None = None
    ) -> None:
        """Count values; of a signal without any until now, in frames of times ``t_ns``, those before the real ones."""
        self._invalid[signal] = self._invalid.get(signal, NO_INVALID).plus(counts)
        if signal not in self._seen:
            early = counts.total if real is None else int(np.count_nonzero(t_ns < real.t_ns[0]))
            self._invalid_at_first[signal] = self._invalid_at_first.get(signal, 0) + min(early, counts.total)


def _rejected(row: Int64Array) -> dict[FrameReason, int]:
    return {reason: int(row[reason]) for reason in REJECTIONS if row[reason]}


def _bad_frame_ns(segment: FrameBatch, verdicts: FrameVerdicts) -> Int64Array:
    """Return when mapped messages failed: a rejected frame at its own time, a missing one where it was missed.

    Frames of another channel or sender are no failures of those that are followed.
    """
    is_rejected = (verdicts.reason >= FrameReason.SHORT) & (verdicts.reason <= FrameReason.WRONG_SEQUENCE)
    is_rejected |= verdicts.reason == FrameReason.OUT_OF_ORDER
    counts = is_rejected + np.maximum(verdicts.missing, 0)
    return np.repeat(segment.t_ns, counts) if counts.any() else _NEVER
