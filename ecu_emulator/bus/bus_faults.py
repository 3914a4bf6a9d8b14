"""Frames made to go wrong as a scenario, or somebody at run time, asks for; counted, and the same for any cutting."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from canlog.e2e.message_contract import MessageContract
from ecu_emulator.bus import frame_changes as change
from ecu_emulator.bus.frame_changes import Rows
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.errors import ConfigError
from ecu_emulator.scenario.faults import BusFault, BusFaultKind
from ecu_emulator.scenario.signals import generator
from ecu_emulator.sensing.sensor_faults import MS_PER_S, Onsets

LATE_CYCLES: Final = 1.5  # behind the successor, before the one after it
SPOOF_CYCLES: Final = 0.5  # the second sender keeps clear of the first


class FrameLoss:
    """Loses a share of the frames; which ones depends on the seed only, not on how the stream was cut."""

    def __init__(self, loss_ratio: float, seed: int) -> None:
        self._loss_ratio = loss_ratio
        self._random = generator(seed, "frame loss")

    def surviving(self, frames: EncodedFrames) -> EncodedFrames:
        """Return the frames that arrive; alive counters show the gaps."""
        if self._loss_ratio == 0.0:
            return frames
        kept = np.flatnonzero(self._random.random(len(frames)) >= self._loss_ratio)
        return EncodedFrames(
            t_s=frames.t_s[kept], can_id=frames.can_id[kept], length=frames.length[kept], data=frames.data[kept]
        )


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

    def feed(self, frames: EncodedFrames, span_s: tuple[float, float], end_s: float, *, is_last: bool) -> EncodedFrames:
        """Return the frames that leave up to ``end_s``, those of this stretch and those held back before."""
        start_s, stop_s = span_s
        if start_s <= end_s:
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
        return change.postponed(frames, rows, LATE_CYCLES * np.array(cycles_s))

    def _by_message(self, frames: EncodedFrames, rows: Rows) -> list[tuple[int, Rows]]:
        ids = frames.can_id[rows]
        return [(can_id, rows[ids == can_id]) for can_id in np.unique(ids).tolist()]

    def _data_id(self, can_id: int) -> int:
        return self._contracts[can_id].data_id or 0

    def _counted_from_zero(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        for can_id, own in self._by_message(frames, rows):
            counter = change.counters(frames, own)
            base = self._memory.setdefault(can_id, int(counter[0]))
            frames = change.recounted(frames, own, self._data_id(can_id), counter - base)
        return frames

    def stuck(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, those in ``rows`` with the counter of the first one."""
        for can_id, own in self._by_message(frames, rows):
            if can_id not in self._memory:
                self._memory[can_id] = int(change.counters(frames, own[:1])[0])
                self.count -= 1  # the first one is as it should be
            counter = np.full(len(own), self._memory[can_id])
            frames = change.recounted(frames, own, self._data_id(can_id), counter)
        return frames

    def skipping(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, the counters of those in ``rows`` ahead by as many as asked for."""
        for can_id, own in self._by_message(frames, rows):
            counter = change.counters(frames, own) + self._fault.skip
            frames = change.recounted(frames, own, self._data_id(can_id), counter)
        return frames

    def spoofed(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames and those of a second sender, one for each in ``rows``, which repeats what it once saw."""
        spoofed = frames
        for can_id, own in self._by_message(frames, rows):
            pattern = self._payload.setdefault(can_id, frames[int(own[0]) : int(own[0]) + 1])
            sent = self._memory.get(can_id, 0)
            self._memory[can_id] = sent + len(own)
            copies = EncodedFrames(
                t_s=frames.t_s[own] + SPOOF_CYCLES * self._contracts[can_id].cycle_ms / MS_PER_S,
                can_id=frames.can_id[own],
                length=frames.length[own],
                data=np.repeat(pattern.data, len(own), axis=0),
            )
            numbers = sent + np.arange(len(own))
            spoofed = change.joined(
                spoofed, change.recounted(copies, np.arange(len(own)), self._data_id(can_id), numbers)
            )
        return spoofed

    def delayed(self, frames: EncodedFrames, rows: Rows) -> EncodedFrames:
        """Return the frames, those in ``rows`` later, no message overtaking itself."""
        by_s = self._fault.delay_s + self._fault.jitter_s * self._random.random(len(rows))
        late = change.postponed(frames, rows, by_s)
        targets = np.flatnonzero(np.isin(frames.can_id, self._targets))
        for can_id, own in self._by_message(frames, targets):
            queued_s = np.maximum.accumulate(late.t_s[own])
            late.t_s[own] = np.maximum(queued_s, self._latest_s.get(can_id, -np.inf))
            self._latest_s[can_id] = float(late.t_s[own[-1]])
        return late

    def _crowded(self, frames: EncodedFrames, start_s: float, until_s: float) -> EncodedFrames:
        self._free_s = max(self._free_s, start_s)
        waiting = np.flatnonzero((frames.t_s >= start_s) & (frames.t_s <= max(until_s, self._free_s)))
        sent_s, foreign_s, self._free_s = change.crowded(frames.t_s[waiting], self._free_s, until_s, self._fault.share)
        self.count += len(foreign_s)
        moved = change.postponed(frames, waiting, sent_s - frames.t_s[waiting])
        return change.joined(moved, change.foreign_frames(foreign_s, self._random))


_ACTIONS: Final[Mapping[BusFaultKind, Callable[[_Injector, EncodedFrames, Rows], EncodedFrames]]] = {
    BusFaultKind.LOSS: lambda _, frames, rows: change.without(frames, rows),
    BusFaultKind.SILENCE: lambda _, frames, rows: change.without(frames, rows),
    BusFaultKind.RESTART: lambda _, frames, rows: change.without(frames, rows),
    BusFaultKind.DUPLICATE: lambda _, frames, rows: change.duplicated(frames, rows),
    BusFaultKind.BAD_CRC: lambda _, frames, rows: change.with_bad_crc(frames, rows),
    BusFaultKind.SHORT: lambda _, frames, rows: change.shortened(frames, rows),
    BusFaultKind.ERROR_FRAME: lambda _, frames, rows: change.joined(
        frames, change.error_frames(frames.t_s[rows] + change.FRAME_S)
    ),
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
        self._seed = seed
        self._contracts = {contract.can_id: contract for contract in contracts.values()}
        self._faults: list[BusFault] = []
        self._injectors: list[_Injector] = []
        self._onsets = Onsets(())
        for fault in faults:
            self.add(fault)

    @property
    def faults(self) -> tuple[BusFault, ...]:
        """All faults asked for."""
        return tuple(self._faults)

    @property
    def counts(self) -> tuple[int, ...]:
        """How many frames each fault has struck, or added."""
        return tuple(injector.count for injector in self._injectors)

    @property
    def spans_s(self) -> tuple[tuple[float, float], ...]:
        """Begin and end [s] of each fault, infinite while not known."""
        spans_ms = map(self._onsets.span_ms, range(len(self._faults)))
        return tuple((start_ms / MS_PER_S, stop_ms / MS_PER_S) for start_ms, stop_ms in spans_ms)

    def check(self, fault: BusFault) -> None:
        """Raise ConfigError if the fault could not be added."""
        _targets(fault, self._contracts)

    def add(self, fault: BusFault, origin_s: float = 0.0) -> None:
        """Take one more fault; without a shift its start counts from ``origin_s``."""
        self._injectors.append(_Injector(fault, len(self._faults), self._seed, self._contracts))
        self._faults.append(fault)
        self._onsets.add(fault, origin_s * MS_PER_S)

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
        self._onsets.feed(rows, first_ms)
        for injector, span_s in zip(self._injectors, self.spans_s, strict=True):
            frames = injector.feed(frames, span_s, end_s, is_last=is_last)
        return frames


def _targets(fault: BusFault, contracts: Mapping[int, MessageContract]) -> list[int]:
    """Return the identifiers that a fault strikes."""
    if not fault.message:
        return list(contracts)
    named = [contract for contract in contracts.values() if contract.name == fault.message]
    if not named:
        known = ", ".join(contract.name for contract in contracts.values())
        raise ConfigError(f"message {fault.message!r} is not on the bus; known: {known}")
    if fault.kind is BusFaultKind.RESTART:
        return [can_id for can_id, contract in contracts.items() if contract.sender == named[0].sender]
    return [named[0].can_id]
