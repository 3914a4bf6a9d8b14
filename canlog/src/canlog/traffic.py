"""Rates, jitter, gaps and bus load of a log, without a database, in one pass and bounded memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from canlog.frames import BEFORE_ALL_NS, ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG, FrameBatch

NS_PER_S = 1_000_000_000
STEPS_PER_OCTAVE = 8
OCTAVES = 40  # from 1 us to 12 days
BIN_COUNT = STEPS_PER_OCTAVE * OCTAVES
GAP_RATIO = 3.0  # an interval beyond so many typical ones is a gap: two frames are missing
JUMP_NS = NS_PER_S  # bus time that stands still for longer, or goes back, starts a new segment
CHANNELS = 256
MAX_JUMPS = 20  # that are listed; all are counted
MAX_IDS = 8192  # likewise, with their channels: no bus has as many, a log of noise has
DEFAULT_BITRATE: Final = 500_000  # [bit/s] of most powertrain buses
# Bits of a frame (ISO 11898-1) in which five of a kind are followed by a stuff bit, payload apart.
CLASSIC_BITS: Final = 34.0  # start of frame, 11-bit identifier, control field, checksum
FD_BITS: Final = 22.0  # the same without the checksum, which has stuff bits of its own at fixed places
EXTENDED_BITS: Final = 20.0  # more with a 29-bit identifier
FD_EXTENDED_BITS: Final = 19.0
# And those without: delimiters, acknowledgement, end of frame, the space before the next one.
TAIL_BITS: Final = 13.0
FD_SHORT_CHECKSUM_BITS: Final = 27.0  # stuff count, 17 bits of checksum, fixed stuff bits: up to 16 bytes
FD_LONG_CHECKSUM_BITS: Final = 32.0  # 21 bits of checksum
FD_SHORT_BYTES: Final = 16
ERROR_BITS: Final = 23.0  # of an error frame at most: two flags, delimiter, space

# What recordings of five vehicles need, counted bit by bit: 0.06 to 0.11. Random payloads need 0.03; the most is 0.25.
STUFF_SHARE: Final = 0.1


def frame_bits(batch: FrameBatch) -> FloatArray:
    """Return the length of frames on the wire in bits at the arbitration rate, stuff bits estimated, shape (n,).

    The faster part of CAN FD frames with a bit rate switch is counted at the slower rate: an upper bound.
    """
    is_extended = (batch.can_id & np.uint32(EXTENDED_FLAG)) != 0
    is_fd = (batch.flags & np.uint8(FD_FLAG)) != 0
    payload = np.where(batch.can_id & np.uint32(REMOTE_FLAG), 0.0, 8.0 * batch.length)
    head = np.where(is_fd, FD_BITS, CLASSIC_BITS)
    head += np.where(is_extended, np.where(is_fd, FD_EXTENDED_BITS, EXTENDED_BITS), 0.0)
    fd_checksum = np.where(batch.length > FD_SHORT_BYTES, FD_LONG_CHECKSUM_BITS, FD_SHORT_CHECKSUM_BITS)
    tail = np.where(is_fd, TAIL_BITS + fd_checksum, TAIL_BITS)
    bits: FloatArray = (head + payload) * (1.0 + STUFF_SHARE) + tail
    return np.where(batch.can_id & np.uint32(ERROR_FLAG), ERROR_BITS, bits)


@dataclass(frozen=True, slots=True, kw_only=True)
class IdTraffic:
    """The frames of one identifier on one channel."""

    channel: int
    can_id: int  # with its flags
    count: int
    length: int  # bytes of the longest
    rate_hz: float  # 0 for a single frame
    period_s: float  # typical interval; 0 for a single frame
    jitter_s: float  # standard deviation of the intervals that are no gaps
    gap_count: int
    longest_gap_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    at_ns: int  # before it
    by_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficReport:
    frames: int
    first_ns: int
    last_ns: int
    ids: tuple[IdTraffic, ...]
    unlisted_frames: int  # whose identifiers came when there were too many to be listed
    error_frames: int
    remote_frames: int
    fd_frames: int
    sent_frames: int  # by the recorder itself, where the log says so
    jumps: tuple[Jump, ...]  # the first ones
    jump_count: int
    bus_load_ratio: float  # of the busiest channel, mean, at the assumed bit rate
    peak_load_ratio: float  # in the busiest whole second


class TrafficMeter:
    """Counts frames as they come; the load is relative to ``bitrate`` [bit/s]."""

    def __init__(self, bitrate: int) -> None:
        self._bitrate = bitrate
        self._slots: dict[int, int] = {}  # channel and identifier -> row
        self._unlisted = 0
        self._last_ns = np.full(MAX_IDS, BEFORE_ALL_NS)
        # Intervals inside segments, summed. Rows that nothing is written to take no memory.
        self._count, self._length, self._elapsed_ns, self._longest_ns = np.zeros((4, MAX_IDS), np.int64)
        self._bins = np.zeros((MAX_IDS, BIN_COUNT), np.int64)
        self._sums_s, self._squares_s2 = np.zeros((2, MAX_IDS, BIN_COUNT))
        self._jumps: list[Jump] = []
        self._jump_count = 0
        self._kinds = dict.fromkeys((ERROR_FLAG, REMOTE_FLAG, FD_FLAG, TX_FLAG), 0)
        self._ends_ns: tuple[int, int] | None = None  # first and latest time of all
        self._bus_ns = 0  # time inside segments, and no more than a second between them
        self._last_bus_ns: int | None = None
        self._bits = np.zeros(CHANNELS)
        self._second = 0  # the second under way, and its bits
        self._second_bits: FloatArray = np.zeros(CHANNELS)
        self._peak_bits = 0.0

    def add(self, batch: FrameBatch, longest_step_ns: int = JUMP_NS) -> None:
        """Count frames; a longer silence is a jump of time."""
        if not len(batch):
            return
        first_ns, last_ns = int(batch.t_ns.min()), int(batch.t_ns.max())
        before = self._ends_ns or (first_ns, last_ns)
        self._ends_ns = (min(before[0], first_ns), max(before[1], last_ns))
        for segment, is_new in self._segments(batch, longest_step_ns):
            if is_new:
                self._last_ns[:] = BEFORE_ALL_NS
            self._add_intervals(segment)
        self._add_load(batch)
        for flag in (ERROR_FLAG, REMOTE_FLAG):
            self._kinds[flag] += int(np.count_nonzero(batch.can_id & np.uint32(flag)))
        for flag in (FD_FLAG, TX_FLAG):
            self._kinds[flag] += int(np.count_nonzero(batch.flags & np.uint8(flag)))

    def report(self) -> TrafficReport:
        """Return what was counted until now."""
        first_ns, last_ns = self._ends_ns or (0, 0)
        duration_s = self._bus_ns / NS_PER_S
        load_ratio = float(self._bits.max()) / (self._bitrate * duration_s) if duration_s else 0.0
        return TrafficReport(
            frames=int(self._count.sum()) + self._unlisted,
            first_ns=first_ns,
            last_ns=last_ns,
            ids=tuple(self._id_traffic(key, row) for key, row in sorted(self._slots.items())),
            unlisted_frames=self._unlisted,
            error_frames=self._kinds[ERROR_FLAG],
            remote_frames=self._kinds[REMOTE_FLAG],
            fd_frames=self._kinds[FD_FLAG],
            sent_frames=self._kinds[TX_FLAG],
            jumps=tuple(self._jumps),
            jump_count=self._jump_count,
            bus_load_ratio=load_ratio,
            peak_load_ratio=max(self._peak_bits / self._bitrate, load_ratio),  # of a log that has no whole second
        )

    def _segments(self, batch: FrameBatch, longest_step_ns: int) -> Iterator[tuple[FrameBatch, bool]]:
        """Cut a batch where bus time jumps."""
        before_ns = int(batch.t_ns[0]) if self._last_bus_ns is None else self._last_bus_ns
        steps_ns = np.diff(batch.t_ns, prepend=before_ns)
        cuts = np.flatnonzero((steps_ns < 0) | (steps_ns > longest_step_ns))
        self._bus_ns += int(np.clip(steps_ns, 0, JUMP_NS).sum())
        self._last_bus_ns = int(batch.t_ns[-1])
        self._jump_count += len(cuts)
        for cut in cuts[: MAX_JUMPS - len(self._jumps)].tolist():
            self._jumps.append(Jump(at_ns=int(batch.t_ns[cut] - steps_ns[cut]), by_ns=int(steps_ns[cut])))
        starts = [0, *(cut for cut in cuts.tolist() if cut)]
        for start, stop in zip(starts, [*starts[1:], len(batch)], strict=True):
            yield batch[start:stop], bool(len(cuts)) and start in cuts

    def _add_intervals(self, segment: FrameBatch) -> None:
        """Count the intervals between frames of one identifier."""
        key = segment.channel.astype(np.int64) << 32 | segment.can_id
        unique, inverse = np.unique(key, return_inverse=True)
        rows = np.array([self._row(key) for key in unique.tolist()], np.int64)[inverse]
        order = np.argsort(rows, kind="stable")[: np.count_nonzero(rows < MAX_IDS)]
        self._unlisted += len(rows) - len(order)
        if not len(order):
            return
        rows, t_ns = rows[order], segment.t_ns[order]
        begins = np.flatnonzero(np.diff(rows, prepend=-1))
        before_ns = np.concatenate((t_ns[:1], t_ns[:-1]))
        before_ns[begins] = self._last_ns[rows[begins]]
        known = before_ns > BEFORE_ALL_NS
        step_ns, row = (t_ns - before_ns)[known], rows[known]
        self._last_ns[rows[np.append(begins[1:], len(rows)) - 1]] = t_ns[np.append(begins[1:], len(rows)) - 1]
        np.add.at(self._count, rows, 1)
        np.maximum.at(self._length, rows, segment.length[order].astype(np.int64))
        np.add.at(self._elapsed_ns, row, step_ns)
        np.maximum.at(self._longest_ns, row, step_ns)
        steps = STEPS_PER_OCTAVE * np.log2(np.maximum(step_ns, 1000) / 1000.0)  # on a logarithmic scale
        cell = row * BIN_COUNT + np.minimum(steps, BIN_COUNT - 1).astype(np.int64)
        step_s = step_ns / NS_PER_S
        np.add.at(self._bins.reshape(-1), cell, 1)
        np.add.at(self._sums_s.reshape(-1), cell, step_s)
        np.add.at(self._squares_s2.reshape(-1), cell, step_s**2)

    def _row(self, key: int) -> int:
        """Return the row of a channel and identifier, MAX_IDS if there are too many."""
        is_listed = key in self._slots or len(self._slots) < MAX_IDS
        return self._slots.setdefault(key, len(self._slots)) if is_listed else MAX_IDS

    def _add_load(self, batch: FrameBatch) -> None:
        """Count the bits of each channel, and find the busiest second of any."""
        second, bits = batch.t_ns // NS_PER_S, frame_bits(batch)
        begins = np.flatnonzero(np.diff(second, prepend=second[0] - 1)).tolist()
        for begin, end in pairwise([*begins, len(batch)]):
            if second[begin] != self._second:
                self._second, self._second_bits = int(second[begin]), np.zeros(CHANNELS)
            total = np.bincount(batch.channel[begin:end], bits[begin:end], CHANNELS)
            self._bits += total
            self._second_bits += total
            self._peak_bits = max(self._peak_bits, float(self._second_bits.max()))

    def _id_traffic(self, key: int, row: int) -> IdTraffic:
        bins = self._bins[row]
        steps = int(bins.sum())
        middle = int(np.searchsorted(np.cumsum(bins), (steps + 1) // 2)) if steps else 0
        limit = min(BIN_COUNT, middle + 1 + round(STEPS_PER_OCTAVE * np.log2(GAP_RATIO)))
        regular = int(bins[:limit].sum())
        mean_s = float(self._sums_s[row, :limit].sum()) / max(regular, 1)
        variance_s2 = float(self._squares_s2[row, :limit].sum()) / max(regular, 1) - mean_s**2
        return IdTraffic(
            channel=key >> 32,
            can_id=key & 0xFFFF_FFFF,
            count=int(self._count[row]),
            length=int(self._length[row]),
            rate_hz=steps / (int(self._elapsed_ns[row]) / NS_PER_S) if self._elapsed_ns[row] else 0.0,
            period_s=mean_s,
            jitter_s=float(np.sqrt(max(0.0, variance_s2))),
            gap_count=steps - regular,
            longest_gap_s=int(self._longest_ns[row]) / NS_PER_S if steps > regular else 0.0,
        )
