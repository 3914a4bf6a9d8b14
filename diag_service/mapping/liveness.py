"""Which mapped signals stand still where physics demands that they move, so that a drive is read without them.

Engine and road that turn faster and slower together, at one ratio, prove that the clutch is closed and all shafts
between them turn: a *joint move*. Two joint moves one after the other at different ratios prove a change of gear.
Neither happens in a standing car, and no change of gear in one that drives in one gear. Temperatures, selectors and
switches are never judged: they may stand still for a whole drive.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Series
from clutch_model.units import NS_PER_S, for_people
from clutchdiag_io.people import digits
from diag_service.diagnosis.columns import NO_SAMPLES, ColumnBatch, Signal
from diag_service.mapping.signal_words import signal_words

GRID_S: Final = 0.09  # between samples that are looked at: a closed gear of a fast change lasts half a second
LONGEST_GAP_S: Final = 2.5  # between two samples: beyond, nobody knows what was between them
SLOWEST_RAD_S: Final = 50.0  # of what drives: below it drives nothing, or its steps are too coarse
SLOWEST_BEHIND: Final = 2.0  # rad/s or m/s
ONE_RATIO: Final = 0.025  # of a ratio, by which a closed clutch scatters: whole km/h at 40 km/h
JOINT_MOVE: Final = 0.08  # of a speed: more than noise, less than any gear is driven through
LEAST_POINTS: Final = 4  # of a joint move
OTHER_GEAR: Final = 0.13  # logarithm of two ratios: neighbouring gears are 15 % apart, a converter slips by less
MOVED_COUNT: Final = 3  # values away from the first one: fewer may be damage
STILL: Final[Mapping[str, float]] = {"_rad_s": 1.0, "_m_s": 0.3, "_nm": 1.0}
"""By how much a signal that stands still may scatter, by the unit that ends its name."""
LEAST_RECORDED: Final = 2  # occasions at the end of a log that make a still signal an absent one
LEAST_LIVE: Final = 3  # of a bus, of which nobody knows what comes


class Occasion(Enum):
    """What a signal cannot stand still through."""

    JOINT_MOVE = "engine and road speed moved together"
    BOTH_WAYS = "engine and road speed rose and fell together"
    GEAR_CHANGE = "the ratio of engine and road speed changed from one gear's to another's"


DEMANDS: Final[Mapping[Signal, Occasion]] = {
    **dict.fromkeys(
        (Signal.TURBINE_SPEED, Signal.INPUT_SPEED, Signal.OUTPUT_SPEED, Signal.HUB_SPEED), Occasion.JOINT_MOVE
    ),
    **dict.fromkeys((Signal.ENGINE_SPEED, Signal.VEHICLE_SPEED), Occasion.JOINT_MOVE),
    # A shaft turns with the road while one of its gears is engaged: both do in a drive through several gears.
    **dict.fromkeys((Signal.INPUT1_SPEED, Signal.INPUT2_SPEED), Occasion.GEAR_CHANGE),
    **dict.fromkeys((Signal.CURRENT_GEAR, Signal.TARGET_GEAR), Occasion.GEAR_CHANGE),
    Signal.ENGINE_TORQUE: Occasion.BOTH_WAYS,
    Signal.CLUTCH_TORQUE: Occasion.GEAR_CHANGE,
    **dict.fromkeys((Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND), Occasion.GEAR_CHANGE),
}
"""Which occasion each signal must move at; the others may stand still through any drive. Wheels are not among them,
as on a dynamometer an axle stands, nor pressures: a sensor that fails is a matter of data quality."""
_FRONTS: Final = (Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.INPUT_SPEED)
_BEHINDS: Final = (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED, Signal.WHEEL_FL_SPEED, Signal.WHEEL_RL_SPEED)
COUPLED: Final = frozenset({*_FRONTS, *_BEHINDS})
"""What proves that the others must move."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSpan:
    """What the values of a signal were until now [SI]."""

    first: float
    count: int = 0
    away_count: int = 0  # values that were elsewhere than the first one

    @property
    def is_still(self) -> bool:
        """Whether it stood still, whatever a few damaged values say."""
        return self.away_count < MOVED_COUNT


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """Joint moves and changes of ratio of two speeds, of which the first drives the second."""

    front: Signal
    behind: Signal
    rises: int = 0  # joint moves upwards
    falls: int = 0
    changes: int = 0  # of ratio, from one joint move to the next
    level: float | None = None  # logarithm of the ratio of the last joint move
    held: tuple[int, float] | None = None  # last sample of the front speed: ns, rad/s
    looked_ns: int | None = None  # last sample that was looked at
    ratio: float | None = None  # logarithm, at the beginning of the stretch that is open
    points: int = 0  # of it
    anchor: tuple[float, float] = (0.0, 0.0)  # logarithms of both speeds where its next joint move begins

    def count(self, occasion: Occasion) -> int:
        """Return how often there was such an occasion."""
        if occasion is Occasion.GEAR_CHANGE:
            return self.changes
        moves = self.rises + self.falls
        return moves if occasion is Occasion.JOINT_MOVE or (self.rises and self.falls) else 0

    def advanced(self, batch: ColumnBatch) -> "Coupling":
        """Return the counts with one more batch."""
        front = batch.columns.get(self.front, NO_SAMPLES)
        behind = batch.columns.get(self.behind, NO_SAMPLES)
        state = self.forgotten() if batch.breaks_before else self
        if not len(front.t_ns) and state.held is None:
            return state
        held = state.held if not len(front.t_ns) else (int(front.t_ns[-1]), float(front.value[-1]))
        if len(behind.t_ns):
            rows = _spaced(behind, state.looked_ns)
            t_ns, value = behind.t_ns[rows], behind.value[rows]
            front_ns, front_value = front.t_ns, front.value
            if state.held is not None:
                front_ns = np.append(state.held[0], front_ns)
                front_value = np.append(state.held[1], front_value)
            driving = np.interp(t_ns, front_ns, front_value)
            age_ns = t_ns - front_ns[np.maximum(front_ns.searchsorted(t_ns, side="right") - 1, 0)]
            is_known = np.abs(age_ns) < LONGEST_GAP_S * NS_PER_S
            state = state.walked(t_ns.tolist(), np.where(is_known, driving, 0.0), value)
        return replace(state, held=held)

    def forgotten(self) -> "Coupling":
        """Return the counts where time jumped: what comes next is another stretch."""
        return replace(self, held=None, looked_ns=None, ratio=None, points=0)

    def walked(self, t_ns: list[int], front: FloatArray, behind: FloatArray) -> "Coupling":
        """Return the counts after samples of both speeds at the same times."""
        is_driven = (front > SLOWEST_RAD_S) & (behind > SLOWEST_BEHIND)
        logs = np.log(np.where(is_driven, [front, behind], 1.0))
        ratio, points, anchor, level = self.ratio, self.points, self.anchor, self.level
        rises, falls, changes, looked_ns = self.rises, self.falls, self.changes, self.looked_ns
        for now_ns, drives, ln_front, ln_behind in zip(t_ns, is_driven.tolist(), *logs.tolist(), strict=True):
            is_far = looked_ns is not None and now_ns - looked_ns > LONGEST_GAP_S * NS_PER_S
            looked_ns = now_ns
            if not drives or is_far or ratio is None or abs(ln_front - ln_behind - ratio) > ONE_RATIO:
                ratio = ln_front - ln_behind if drives else None
                points, anchor = 1, (ln_front, ln_behind)
                continue
            points += 1
            moved_front, moved_behind = ln_front - anchor[0], ln_behind - anchor[1]
            if points < LEAST_POINTS or min(abs(moved_front), abs(moved_behind)) < JOINT_MOVE:
                continue
            rises, falls = rises + (moved_front > 0.0), falls + (moved_front < 0.0)
            middle = 0.5 * (ratio + ln_front - ln_behind)
            changes += level is not None and abs(middle - level) > OTHER_GEAR
            level, points, anchor = middle, 1, (ln_front, ln_behind)
        return replace(
            self, rises=rises, falls=falls, changes=changes, level=level, looked_ns=looked_ns,
            ratio=ratio, points=points, anchor=anchor,
        )  # fmt: skip


def _spaced(series: Series, before_ns: int | None) -> list[int]:
    """Return which samples are looked at: at least ``GRID_S`` apart, also from the last one before."""
    grid_ns, t_ns = int(GRID_S * NS_PER_S), series.t_ns
    row = 0 if before_ns is None else int(t_ns.searchsorted(before_ns + grid_ns))
    rows = list[int]()
    while row < len(t_ns):
        rows.append(row)
        row = max(row + 1, int(t_ns.searchsorted(t_ns[row] + grid_ns)))
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class StillSignal:
    """A mapped signal that stands still where it must move."""

    signal: Signal
    value: float | None  # at which [SI]; None: no value ever came
    occasion: Occasion
    count: int  # of occasions

    def text(self, place: str) -> str:
        """Return a sentence; ``place`` is where the profile finds the signal."""
        stands = "never had a value"
        if self.value is not None:
            _, shown, unit = for_people(self.signal.value, self.value)
            stands = f"is {digits(shown)} {unit if shown else ''}".rstrip() + " throughout"
        why = f"{signal_words(self.signal)}; {self.occasion.value} {self.count} times"
        return f"{place or self.signal.value} {stands}: taken as absent ({why})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Liveness:
    """What the signals of a bus or log did until now; `advanced` returns the next state."""

    signals: frozenset[Signal]  # that are mapped
    spans: Mapping[Signal, SignalSpan] = field(default_factory=lambda: MappingProxyType({}))
    couplings: tuple[Coupling, ...] = ()

    @classmethod
    def of(cls, signals: AbstractSet[Signal]) -> "Liveness":
        """Return the state before the first sample of a bus with these signals."""
        pairs = ((front, behind) for front in _FRONTS for behind in _BEHINDS if {front, behind} <= signals)
        return cls(
            signals=frozenset(signals), couplings=tuple(Coupling(front=front, behind=behind) for front, behind in pairs)
        )

    @property
    def is_settled(self) -> bool:
        """Whether every signal that could be found still has moved: nothing more is to learn."""
        judged = self.signals & DEMANDS.keys()
        return all(signal in self.spans and not self.spans[signal].is_still for signal in judged)

    def advanced(self, batch: ColumnBatch) -> "Liveness":
        """Return the state with one more batch of columns."""
        if self.is_settled:
            return self
        spans = dict(self.spans)
        for signal, series in batch.columns.items():
            if signal in DEMANDS and len(series.value):
                spans[signal] = _spanned(signal, series.value, spans.get(signal))
        couplings = tuple(coupling.advanced(batch) for coupling in self.couplings)
        return replace(self, spans=MappingProxyType(spans), couplings=couplings)

    def still(self, least: int) -> tuple[StillSignal, ...]:
        """Return the signals that stood still through at least so many occasions at which they must have moved."""
        return tuple(found for signal in Signal if (found := self._still(signal, least)) is not None)

    def _still(self, signal: Signal, least: int) -> StillSignal | None:
        span, occasion = self.spans.get(signal), DEMANDS.get(signal)
        if signal not in self.signals or occasion is None or (span is not None and not span.is_still):
            return None
        others = (coupling for coupling in self.couplings if signal not in {coupling.front, coupling.behind})
        count = max((coupling.count(occasion) for coupling in others), default=0)
        if count < least or (signal is Signal.ENGINE_SPEED and not self._engine_works):
            return None
        value = None if span is None else span.first
        return StillSignal(signal=signal, value=value, occasion=occasion, count=count)

    @property
    def _engine_works(self) -> bool:
        """Whether the engine's torque moved: of a hybrid that drives by its battery the engine stands truly."""
        torque = self.spans.get(Signal.ENGINE_TORQUE)
        return torque is not None and not torque.is_still


def _spanned(signal: Signal, value: FloatArray, span: SignalSpan | None) -> SignalSpan:
    span = span or SignalSpan(first=float(value[0]))
    bound = next((bound for unit, bound in STILL.items() if signal.value.endswith(unit)), 0.5)
    away_count = span.away_count + int(np.count_nonzero(~(np.abs(value - span.first) <= bound)))
    return replace(span, count=span.count + len(value), away_count=away_count)
