"""Frames made to go wrong as a scenario, or somebody at run time, asks for; counted, and the same for any cutting."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from canlog.e2e.message_contract import MessageContract
from canlog.e2e.profile1 import COUNTER_PERIOD, CRC_BYTE, PAYLOAD_BYTES, counter_of, protect
from canlog.frames import ERROR_FLAG
from ecu_emulator.bus.frames import EncodedFrames, joined, merge
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario.faults import BusFault, BusFaultKind, generator
from ecu_emulator.sensing import MS_PER_S, Onsets

Rows = npt.NDArray[np.int64]

ERROR_ID: Final = ERROR_FLAG | 0x88  # CAN_ERR_PROT, CAN_ERR_BUSERROR: a violation of the protocol
STUFF_ERROR_DATA: Final = (0, 0, 4, 0, 0, 0, 0, 0)  # CAN_ERR_PROT_STUFF in byte 2
SHORT_BYTES: Final = 4
FRAME_S: Final = 111.0 / 500e3  # eight bytes, standard identifier, no stuff bits: the most frames that 500 kbit/s carry
FOREIGN_IDS: Final = (0x500, 0x5FF)  # none of the wire contract's, and below all of them in priority


def without(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    return frames[np.delete(np.arange(len(frames)), rows)]


def postponed(frames: EncodedFrames, rows: Rows, by_s: FloatArray | float) -> EncodedFrames:
    """Return the frames, those in ``rows`` later by ``by_s``, shape (len(rows),) or one number."""
    t_s = frames.t_s.copy()
    t_s[rows] += by_s
    return replace(frames, t_s=t_s)


def with_bad_crc(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames, the CRC of those in ``rows`` inverted."""
    data = frames.data.copy()
    data[rows, CRC_BYTE] ^= 0xFF
    return replace(frames, data=data)


def shortened(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames, those in ``rows`` cut to ``SHORT_BYTES``."""
    data, length = frames.data.copy(), frames.length.copy()
    data[rows, SHORT_BYTES:] = 0
    length[rows] = SHORT_BYTES
    return replace(frames, length=length, data=data)


def recounted(frames: EncodedFrames, rows: Rows, data_id: int, counter: Rows) -> EncodedFrames:
    """Return the frames, those in ``rows``, of one message, with other counters, shape (len(rows),), and sound CRCs."""
    data = frames.data.copy()
    data[rows] = protect(data[rows], data_id, counter % COUNTER_PERIOD)
    return replace(frames, data=data)


def counters(frames: EncodedFrames, rows: Rows) -> Rows:
    return counter_of(frames.data[rows]).astype(np.int64)


def error_frames(t_s: FloatArray) -> EncodedFrames:
    count = len(t_s)
    return EncodedFrames(
        t_s=t_s,
        can_id=np.full(count, ERROR_ID, np.uint32),
        length=np.full(count, PAYLOAD_BYTES, np.uint8),
        data=np.tile(np.array(STUFF_ERROR_DATA, np.uint8), (count, 1)),
    )


def foreign_frames(t_s: FloatArray, random: np.random.Generator) -> EncodedFrames:
    """Return frames of nobody's interest at these times."""
    count = len(t_s)
    drawn = random.integers(0, 2**64, (count, 2), np.uint64)  # whole words: the draws do not depend on their batches
    first, last = FOREIGN_IDS
    return EncodedFrames(
        t_s=t_s,
        can_id=(first + drawn[:, 0] % np.uint64(last - first + 1)).astype(np.uint32),
        length=np.full(count, PAYLOAD_BYTES, np.uint8),
        data=np.ascontiguousarray(drawn[:, 1]).view(np.uint8).reshape(-1, PAYLOAD_BYTES),
    )


def crowded(
    ready_s: FloatArray, free_s: float, until_s: float, load_ratio: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return when the vehicle's and foreign frames are sent on a bus whose idle time foreign frames fill.

    Parameters
    ----------
    ready_s : (n,) array
        When the vehicle's frames are ready, in order; they win every arbitration, but wait for the frame on the bus.
    free_s, until_s : float
        When the bus becomes free, and up to when foreign frames want it.
    load_ratio : float
        Share of the bit rate that is used: 1 leaves no gap.

    Returns
    -------
    tuple
        Send times of the vehicle's (n,) and foreign frames (m,), and when the bus becomes free again.
    """
    sent_s = np.empty_like(ready_s)
    foreign_s = []
    row = 0
    while row < len(ready_s) or free_s < until_s:
        if row < len(ready_s) and (ready_s[row] <= free_s or free_s >= until_s):
            sent_s[row] = max(free_s, float(ready_s[row]))
            free_s = sent_s[row] + FRAME_S
            row += 1
        else:
            foreign_s.append(free_s)
            free_s += FRAME_S / load_ratio
    return sent_s, np.array(foreign_s), free_s


LATE_CYCLES: Final = 1.5  # behind the successor, before the one after it
SPOOF_CYCLES: Final = 0.5  # the second sender keeps clear of the first
GAP_S: Final = 1.5e-3  # rows that are farther apart belong to different trips


class FrameLoss:
    """Loses a share of the frames; which ones depends on the seed only, not on how the stream was cut."""

    def __init__(self, loss_ratio: float, seed: int) -> None:
        self._loss_ratio = loss_ratio
        self._random = generator(seed, "frame loss")

    def surviving(self, frames: EncodedFrames) -> EncodedFrames:
        """Return the frames that arrive; alive counters show the gaps."""
        if self._loss_ratio == 0.0:
            return frames
        return frames[np.flatnonzero(self._random.random(len(frames)) >= self._loss_ratio)]


class _Injector:
    """One fault: what it strikes, what it remembers of each message, what it holds back, and how often it struck."""

    def __init__(self, fault: BusFault, number: int, seed: int, contracts: Mapping[int, MessageContract]) -> None:
        self._fault = fault
        self._contracts = contracts
        self._targets = np.array(_targets(fault, contracts), np.uint32)
        self._random = generator(seed, f"bus fault {number}")
        self._held = merge([])
        self._memory: dict[int, int] = {}  # by identifier: a counter, or by how much it was moved
        self._payload: dict[int, EncodedFrames] = {}  # what a second sender repeats
        self._latest_s: dict[int, float] = {}
        self._free_s = -np.inf
        self.count = 0

    def feed(
        self, frames: EncodedFrames, span_s: tuple[float, float], drive_s: tuple[float, float], *, is_last: bool
    ) -> EncodedFrames:
        """Return the frames that leave by now, held back before or not; ``drive_s``: since when the car drives, now."""
        (start_s, stop_s), (driven_from_s, end_s) = span_s, drive_s
        if start_s <= end_s:
            if self._fault.kind is BusFaultKind.OVERLOAD:
                start_s = min(max(start_s, driven_from_s), stop_s)  # the bus of a parked car is silent
            frames = self._changed(frames, start_s, stop_s, end_s)
        if len(self._held):
            frames = merge([self._held, frames])
        elif np.any(np.diff(frames.t_s) < 0.0):
            frames = merge([frames])
        leaving = len(frames) if is_last else int(np.searchsorted(frames.t_s, end_s, side="right"))
        self._held = frames[leaving:]
        return frames[:leaving]

    def _changed(self, frames: EncodedFrames, start_s: float, stop_s: float, end_s: float) -> EncodedFrames:
        if self._fault.kind is BusFaultKind.OVERLOAD:
            return self._crowded(frames, start_s, min(stop_s, end_s))
        is_target = np.isin(frames.can_id, self._targets)
        rows = np.flatnonzero(is_target & (frames.t_s >= start_s) & (frames.t_s < stop_s))
        if self._fault.share < 1.0:
            rows = rows[self._random.random(len(rows)) < self._fault.share]
        self.count += len(rows)
        if self._fault.kind is BusFaultKind.RESTART:
            frames = self._counted_from_zero(frames, np.flatnonzero(is_target & (frames.t_s >= stop_s)))
        return _ACTIONS[self._fault.kind](self, frames, rows)

    def reordered(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, those in ``rows`` behind their successors."""
        cycles_s = [self._contracts[can_id].cycle_ms / MS_PER_S for can_id in frames.can_id[rows].tolist()]
        return postponed(frames, rows, LATE_CYCLES * np.array(cycles_s))

    def _by_message(self, frames: EncodedFrames, rows: Rows) -> list[tuple[int, Rows]]:
        ids = frames.can_id[rows]
        return [(can_id, rows[ids == can_id]) for can_id in np.unique(ids).tolist()]

    def _data_id(self, can_id: int) -> int:
        return self._contracts[can_id].data_id or 0

    def _counted_from_zero(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        for can_id, affected in self._by_message(frames, rows):
            counter = counters(frames, affected)
            base = self._memory.setdefault(can_id, int(counter[0]))
            frames = recounted(frames, affected, self._data_id(can_id), counter - base)
        return frames

    def stuck(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, those in ``rows`` with the counter of the first one."""
        for can_id, affected in self._by_message(frames, rows):
            if can_id not in self._memory:
                self._memory[can_id] = int(counters(frames, affected[:1])[0])
                self.count -= 1  # the first one is as it should be
            counter = np.full(len(affected), self._memory[can_id])
            frames = recounted(frames, affected, self._data_id(can_id), counter)
        return frames

    def skipping(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, the counters of those in ``rows`` ahead by as many as asked for."""
        for can_id, affected in self._by_message(frames, rows):
            counter = counters(frames, affected) + self._fault.skip
            frames = recounted(frames, affected, self._data_id(can_id), counter)
        return frames

    def spoofed(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames and those of a second sender, one for each in ``rows``, which repeats what it once saw."""
        spoofed = frames
        for can_id, affected in self._by_message(frames, rows):
            pattern = self._payload.setdefault(can_id, frames[int(affected[0]) : int(affected[0]) + 1])
            sent = self._memory.get(can_id, 0)
            self._memory[can_id] = sent + len(affected)
            copies = replace(
                frames[affected],
                t_s=frames.t_s[affected] + SPOOF_CYCLES * self._contracts[can_id].cycle_ms / MS_PER_S,
                data=np.repeat(pattern.data, len(affected), axis=0),
            )
            numbers = sent + np.arange(len(affected))
            spoofed = joined(spoofed, recounted(copies, np.arange(len(affected)), self._data_id(can_id), numbers))
        return spoofed

    def delayed(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, those in ``rows`` later, no message overtaking itself."""
        by_s = self._fault.delay_s + self._fault.jitter_s * self._random.random(len(rows))
        late = postponed(frames, rows, by_s)
        targets = np.flatnonzero(np.isin(frames.can_id, self._targets))
        for can_id, affected in self._by_message(frames, targets):
            queued_s = np.maximum.accumulate(late.t_s[affected])
            late.t_s[affected] = np.maximum(queued_s, self._latest_s.get(can_id, -np.inf))
            self._latest_s[can_id] = float(late.t_s[affected[-1]])
        return late

    def _crowded(self, frames: EncodedFrames, start_s: float, until_s: float) -> EncodedFrames:
        self._free_s = max(self._free_s, start_s)
        waiting = np.flatnonzero((frames.t_s >= start_s) & (frames.t_s <= max(until_s, self._free_s)))
        sent_s, foreign_s, self._free_s = crowded(frames.t_s[waiting], self._free_s, until_s, self._fault.share)
        self.count += len(foreign_s)
        moved = postponed(frames, waiting, sent_s - frames.t_s[waiting])
        return joined(moved, foreign_frames(foreign_s, self._random))


_ACTIONS: Final[Mapping[BusFaultKind, Callable[[_Injector, EncodedFrames, Rows], EncodedFrames]]] = {
    BusFaultKind.LOSS: lambda _, frames, rows: without(frames, rows),
    BusFaultKind.SILENCE: lambda _, frames, rows: without(frames, rows),
    BusFaultKind.RESTART: lambda _, frames, rows: without(frames, rows),
    BusFaultKind.DUPLICATE: lambda _, frames, rows: joined(
        frames, postponed(frames[rows], np.arange(len(rows)), FRAME_S)
    ),
    BusFaultKind.BAD_CRC: lambda _, frames, rows: with_bad_crc(frames, rows),
    BusFaultKind.SHORT: lambda _, frames, rows: shortened(frames, rows),
    BusFaultKind.ERROR_FRAME: lambda _, frames, rows: joined(frames, error_frames(frames.t_s[rows] + FRAME_S)),
    BusFaultKind.REORDER: _Injector.reordered,
    BusFaultKind.DELAY: _Injector.delayed,
    BusFaultKind.STUCK_COUNTER: _Injector.stuck,
    BusFaultKind.SKIPPING_COUNTER: _Injector.skipping,
    BusFaultKind.SPOOF: _Injector.spoofed,
}


class BusFaults:
    """All faults of the bus, in the order in which they were asked for; each acts on what the one before left.

    Raises
    ------
    ConfigError
        If a fault names a message that the wire contract does not have.
    """

    def __init__(self, faults: Sequence[BusFault], seed: int, contracts: Mapping[str, MessageContract]) -> None:
        self.onsets: Final = Onsets[BusFault]()
        self._seed = seed
        self._contracts = {contract.can_id: contract for contract in contracts.values()}
        self._injectors: list[_Injector] = []
        self._driven_from_s = self._end_s = -np.inf
        for fault in faults:
            self.add(fault)

    @property
    def counts(self) -> tuple[int, ...]:
        """How many frames each fault has struck, or added."""
        return tuple(injector.count for injector in self._injectors)

    def check(self, fault: BusFault) -> None:
        """Raise ConfigError if the fault could not be added."""
        _targets(fault, self._contracts)

    def add(self, fault: BusFault, origin_s: float = 0.0) -> None:
        """Take one more fault; without a shift its start counts from ``origin_s``."""
        self._injectors.append(_Injector(fault, len(self._injectors), self._seed, self._contracts))
        self.onsets.add(fault, origin_s)

    def feed(
        self, frames: EncodedFrames, rows: FloatArray, first_ms: int, end_s: float, *, is_last: bool
    ) -> EncodedFrames:
        """Return what is sent up to ``end_s`` [s] of the frames encoded so far.

        Parameters
        ----------
        frames : EncodedFrames
            The next frames, none later than ``end_s``.
        rows : (n, len(Col)) array
            The plant rows from ``first_ms`` [ms] on, one per millisecond, in which faults may be triggered.
        is_last : bool
            Nothing follows: what is held back leaves as well.
        """
        self.onsets.feed(rows, first_ms)
        if first_ms / MS_PER_S > self._end_s + GAP_S:
            self._driven_from_s = first_ms / MS_PER_S
        self._end_s = end_s
        for injector, span_s in zip(self._injectors, self.onsets.spans_s, strict=True):
            frames = injector.feed(frames, span_s, (self._driven_from_s, end_s), is_last=is_last)
        return frames


def _targets(fault: BusFault, contracts: Mapping[int, MessageContract]) -> list[int]:
    if not fault.message:
        return list(contracts)
    named = [contract for contract in contracts.values() if contract.name == fault.message]
    if not named:
        known = ", ".join(contract.name for contract in contracts.values())
        raise EmulatorConfigError(f"message {fault.message!r} is not on the bus; known: {known}")
    if fault.kind is BusFaultKind.RESTART:
        return [can_id for can_id, contract in contracts.items() if contract.sender == named[0].sender]
    return [named[0].can_id]
