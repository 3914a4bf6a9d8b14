"""Which of several candidates for a quantity is right: they compete on the data of a log, by relations of physics.

Names propose, motion decides. Each relation says by how much a candidate misses what the other signals demand of it,
at each moment at which the candidates differ. The least misfit wins if it is less by far, and surely so; else the name
decides, and that is said.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import product
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from clutch_model.units import NS_PER_S, bar_from_pa, rpm_from_rad_s
from clutchdiag_io.people import digits
from diag_service.diagnosis.columns import SUMMED_SIGNALS, Signal
from diag_service.mapping.proposal import Candidate
from diag_service.mapping.signal_words import signal_words
from diag_service.mapping.units import TO_SI, USUAL, UnitReading

Best = Mapping[Signal, Sequence[Candidate]]
Tracks = Mapping[tuple[Signal, int], Series]
"""Values [SI] of candidates, by quantity and rank by name."""
NOTHING: Final = np.empty(0)
Moments = Mapping[Signal, FloatArray]
Misses = Callable[[Moments, Signal, FloatArray], FloatArray]
MOST_CANDIDATES: Final = 4
GRID_S: Final = 0.05
LONGEST_GAP_S: Final = 2.5  # between samples: beyond, nobody knows what was between them
BLOCK_S: Final = 2.0  # moments that are nearer are one: what makes them miss lasts
LEAST_BLOCKS: Final = 4  # at which the candidates differ: fewer are too little motion
DIFFER_RATIO, DIFFER = 0.02, 2.0  # of values, and rad/s, m/s or Nm: less is alike
ANOTHER_GEAR: Final = 0.5
MANY: Final = 10.0  # times what is alike: that much a signal moves in any drive
FAR_RATIO: Final = 1.5  # of two misfits: less is nearly equal
SURE_RATIO: Final = 3.0
LEAST_STDS, SURE_STDS = 3.0, 5.0  # of the difference of two misfits, over the blocks
MOST_OFF: Final = 0.3  # of a logarithm: a gear change or a wrong gear is no worse than that
TURNS_RAD_S: Final = 50.0
MOVES: Final = 2.0  # rad/s or m/s
SMOOTH_S: Final = 0.4  # over which acceleration is taken
SLOWEST_RAD_S: Final = 0.2  # of a shaft that turns, whatever its unit
_SHAFT: Final = (0.33, 3.0)
OVER_ENGINE: Final[Mapping[Signal, tuple[float, float]]] = {
    **dict.fromkeys((Signal.TURBINE_SPEED, Signal.INPUT_SPEED, Signal.HUB_SPEED), _SHAFT),
    **dict.fromkeys((Signal.INPUT1_SPEED, Signal.INPUT2_SPEED), _SHAFT),
    Signal.OUTPUT_SPEED: (0.4, 25.0),
}
"""How many times as fast as a shaft an engine turns, in the middle of a drive; an axle's is slower by its own ratio."""


class Sureness(Enum):
    """How sure a choice is."""

    SURE = "sure"
    LIKELY = "likely"
    EQUAL = "nearly equal on this log: chosen by name"
    TOO_LITTLE = "too little motion to tell: chosen by name"
    BY_NAME = "by name only: no relation of physics tells them apart"
    NONE = "none fits"


@dataclass(frozen=True, slots=True, kw_only=True)
class Contest:
    """The candidates of one quantity, the best first, and what decided."""

    signal: Signal
    relation: str  # in words; empty if there is none
    unit: str  # of the misfits
    places: tuple[str, ...]  # of the candidates, the chosen one first; of none that fits the least wrong one
    misfits: tuple[float, ...]  # of each, in that unit; empty if nothing was reckoned
    sureness: Sureness

    @property
    def text(self) -> str:
        """A line for people: candidates with misfits, the choice, and how sure it is."""
        told = [digits(misfit) for misfit in self.misfits]
        shown = [f"{place!r} {misfit} {self.unit}" for place, misfit in zip(self.places, told, strict=False)]
        against = ", ".join(shown or map(repr, self.places))
        why = f", by {self.relation}" if self.relation else ""
        chosen = "" if self.sureness is Sureness.NONE else f"; chosen: {self.places[0]!r}"
        return f"Contest for {signal_words(self.signal)}{why}: {against}{chosen} ({self.sureness.value})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Relation:
    """What physics demands of a quantity, and by how much a candidate misses it.

    ``misses`` takes the signals at the same moments, with the candidate among them, and the mean of its rivals, and
    returns how far off it is at each, shape (n,), NaN where nothing is demanded.
    """

    words: str
    unit: str
    of: frozenset[Signal]  # quantities whose candidates it tells apart
    needs: tuple[Signal, ...]  # besides
    misses: Misses


def _slip_misses(at: Moments, _: Signal = Signal.LOCKUP_SLIP, _others: FloatArray = NOTHING) -> FloatArray:
    """Return the misses of slip, which is engine less turbine speed by definition [rpm]."""
    off = at[Signal.ENGINE_SPEED] - at[Signal.TURBINE_SPEED] - at[Signal.LOCKUP_SLIP]
    return np.asarray(rpm_from_rad_s(1.0) * np.abs(off), np.float64)


def _by_gear(level: FloatArray, gears: FloatArray) -> FloatArray:
    """Return by how much values differ from the middle of their gear [%]; NaN where there is none."""
    off = np.full(len(level), np.nan)
    for gear in np.unique(gears[np.isfinite(level) & (gears >= 1.0)]).tolist():
        own = np.isfinite(level) & (gears == gear)
        off[own] = np.minimum(np.abs(level[own] - np.median(level[own])), MOST_OFF)
    return np.asarray(100.0 * off, np.float64)


def _ratio(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the logarithm of two speeds' ratio; NaN where one of them hardly moves."""
    moves = (one > MOVES) & (other > MOVES)
    return np.asarray(np.where(moves, np.log(np.where(moves, one, 1.0) / np.where(moves, other, 1.0)), np.nan))


def _geared_misses(behind: Signal) -> Misses:
    """Return the misses of a shaft before the gears: within a gear it has one ratio to what is behind them [%]."""

    def misses(at: Moments, signal: Signal, _others: FloatArray) -> FloatArray:
        return _by_gear(_ratio(at[signal], at[behind]), at[Signal.CURRENT_GEAR])

    return misses


def _gear_misses(front: Signal, behind: Signal) -> Misses:
    """Return the misses of a gear: within it the speeds before and behind the gears have one ratio [%]."""

    def misses(at: Moments, signal: Signal, _others: FloatArray) -> FloatArray:
        return _by_gear(_ratio(at[front], at[behind]), np.rint(at[signal]))

    return misses


def _rolling_misses(at: Moments, _: Signal, _others: FloatArray) -> FloatArray:
    """Return the misses of what turns with the output shaft: their ratio is one [%]."""
    level = _ratio(at[Signal.VEHICLE_SPEED], at[Signal.OUTPUT_SPEED])
    return _by_gear(level, np.ones(len(level)))


def _torque_misses(at: Moments, signal: Signal, _others: FloatArray) -> FloatArray:
    """Return the misses of a torque: by it, less what rolling and air take, the engine gains speed in a gear [rpm/s].

    Newton's law for the car as the engine feels it: ``gain = (torque - a - b speed^2) / J`` with ``J > 0``, ``a`` and
    ``b`` fitted to each gear. A torque that tells nothing, or goes the other way, leaves the gain as it is.
    """
    torque, speed, gears = at[signal], at[Signal.ENGINE_SPEED], at[Signal.CURRENT_GEAR]
    width = max(round(SMOOTH_S / GRID_S), 1)
    kernel = np.ones(width) / width
    gain = np.convolve(np.gradient(speed, GRID_S), kernel, "same")
    smooth = np.convolve(torque, kernel, "same")
    off = np.full(len(gain), np.nan)
    for gear in np.unique(gears[gears >= 1.0]).tolist():
        own = (gears == gear) & (speed > TURNS_RAD_S) & np.isfinite(gain) & np.isfinite(smooth)
        if np.count_nonzero(own) < LEAST_BLOCKS * width:
            continue
        rest = np.column_stack([np.ones(np.count_nonzero(own)), speed[own] ** 2])
        left = np.column_stack([smooth[own], gain[own]])
        left = left - rest @ np.linalg.lstsq(rest, left, rcond=None)[0]
        slope = max(float(left[:, 0] @ left[:, 1]) / max(float(left[:, 0] @ left[:, 0]), 1e-9), 0.0)
        off[own] = np.abs(left[:, 1] - slope * left[:, 0])
    return np.asarray(rpm_from_rad_s(1.0) * off, np.float64)


def _pressure_misses(at: Moments, signal: Signal, others: FloatArray) -> FloatArray:
    """Return the misses of a measured pressure: what is asked for leads it, by a lag of first order [bar].

    ``asked - measured = lag * d(measured)/dt`` with ``lag >= 0``: what leads can only be what is asked for.
    """
    rate_pa_s = np.gradient(at[signal], GRID_S)
    behind_pa = others - at[signal]
    lag_s = max(float(rate_pa_s @ behind_pa) / max(float(rate_pa_s @ rate_pa_s), 1e-9), 0.0)
    return np.asarray(bar_from_pa(1.0) * np.abs(behind_pa - lag_s * rate_pa_s), np.float64)


_GEAR: Final = Signal.CURRENT_GEAR
_BEFORE: Final = frozenset({Signal.INPUT_SPEED, Signal.TURBINE_SPEED})
RELATIONS: Final[tuple[Relation, ...]] = (
    Relation(
        words="engine less turbine speed against slip",
        unit="rpm",
        of=frozenset({Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP, Signal.ENGINE_SPEED}),
        needs=(Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP),
        misses=_slip_misses,
    ),
    *(
        Relation(
            words=f"its ratio to {signal_words(behind)} in each gear",
            unit="%",
            of=_BEFORE,
            needs=(behind, _GEAR),
            misses=_geared_misses(behind),
        )
        for behind in (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)
    ),
    *(
        Relation(
            words=f"{signal_words(front)} over {signal_words(behind)} in each gear",
            unit="%",
            of=frozenset({_GEAR}),
            needs=(front, behind),
            misses=_gear_misses(front, behind),
        )
        for front, behind in product(
            (Signal.TURBINE_SPEED, Signal.INPUT_SPEED, Signal.ENGINE_SPEED),
            (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED),
        )
    ),
    Relation(
        words="road speed over output shaft speed",
        unit="%",
        of=frozenset({Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED}),
        needs=(Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED),
        misses=_rolling_misses,
    ),
    Relation(
        words="torque against inertia and the engine's gain of speed in each gear",
        unit="rpm/s",
        of=frozenset({Signal.ENGINE_TORQUE}),
        needs=(Signal.ENGINE_SPEED, _GEAR),
        misses=_torque_misses,
    ),
    Relation(
        words="what is measured follows what is asked for",
        unit="bar",
        of=frozenset({Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE, Signal.LOCKUP_PRESSURE}),
        needs=(),
        misses=_pressure_misses,
    ),
)
"""The first relation whose signals a log has decides. Temperatures have none: sump and coolant differ by name only."""
_HELD: Final = frozenset({Signal.CURRENT_GEAR, Signal.TARGET_GEAR})


def thinned(series: Series) -> Series:
    """Return one sample of each cell of the grid: what is more tells candidates no better apart."""
    cells = series.t_ns // int(GRID_S * NS_PER_S)
    rows = np.flatnonzero(np.diff(cells, prepend=cells[:1] - 1))
    return Series(t_ns=series.t_ns[rows], sequence=series.sequence[rows], value=series.value[rows])


def joined(pieces: Sequence[Series]) -> Series:
    """Return the pieces of a signal as one, in order of time."""
    t_ns = np.concatenate([piece.t_ns for piece in pieces])
    order = np.argsort(t_ns, kind="stable")
    value, sequence = (
        np.concatenate([getattr(piece, name) for piece in pieces])[order] for name in ("value", "sequence")
    )
    return Series(t_ns=t_ns[order], sequence=sequence, value=value)


def contested(best: Best) -> frozenset[Signal]:
    """Return the quantities that have several candidates."""
    return frozenset(signal for signal, candidates in best.items() if len(candidates) > 1)


def needs_tracks(best: Best) -> bool:
    """Return whether a log must be read again to order candidates, or to tell units."""
    return bool(contested(best)) or best.keys() >= SUMMED_SIGNALS or any(_is_assumed(*found) for found in best.items())


def _is_assumed(signal: Signal, candidates: Sequence[Candidate]) -> bool:
    """Return whether nothing says in which unit a shaft's speed is."""
    return signal in OVER_ENGINE and any(candidate.reading.why.startswith("assumed") for candidate in candidates)


def by_engine(best: Best, tracks: Tracks) -> tuple[Best, Tracks]:
    """Return candidates and their values with the units of shafts that engine speed allows, where nothing says them.

    Gears span a bounded range of ratios, and rpm and rad/s differ by 9.55: read in the wrong one, a shaft would be
    slower or faster than any gear makes it.
    """
    engine = tracks.get((Signal.ENGINE_SPEED, 0))
    if engine is None:
        return best, tracks
    units, values = {signal: list(candidates) for signal, candidates in best.items()}, dict(tracks)
    for signal, rank in tracks:
        candidate = best[signal][rank]
        if not _is_assumed(signal, [candidate]):
            continue
        grid_ns = _grid(engine, tracks[signal, rank])
        driving, shaft = (np.interp(grid_ns, one.t_ns, one.value) for one in (engine, tracks[signal, rank]))
        turns = (driving > TURNS_RAD_S) & (shaft > SLOWEST_RAD_S)
        if np.count_nonzero(turns) < LEAST_BLOCKS * BLOCK_S / GRID_S:
            continue
        lowest, highest = OVER_ENGINE[signal]
        ratio, now = float(np.median(driving[turns] / shaft[turns])), TO_SI["rad_s"][candidate.unit].factor
        fitting = [
            unit
            for unit in USUAL["rad_s"]
            if lowest < ratio * now / TO_SI["rad_s"][unit].factor < highest and not lowest < ratio < highest
        ]
        if fitting:
            why = f"assumed: in {candidate.unit} the engine would turn {digits(ratio)} times as fast"
            units[signal][rank] = replace(candidate, reading=UnitReading(unit=fitting[0], why=why))
            series, scale = tracks[signal, rank], TO_SI["rad_s"][fitting[0]].factor / now
            values[signal, rank] = Series(t_ns=series.t_ns, sequence=series.sequence, value=scale * series.value)
    return units, values


def judged(best: Best, tracks: Tracks) -> tuple[dict[Signal, list[Candidate]], tuple[Contest, ...]]:
    """Return the candidates as physics orders them, and the contests that decided.

    Parameters
    ----------
    best
        Candidates of each quantity as names order them.
    tracks
        What they were in a log.
    """
    best, tracks = by_engine(best, tracks)
    ordered, contests = {signal: list(candidates) for signal, candidates in best.items()}, list[Contest]()
    ranks = dict.fromkeys(ordered, 0)  # of the candidates that stand for their quantities
    for signal in Signal:
        if signal in contested(best):
            contest, rank = _contest(signal, best, tracks, ranks)
            contests += [contest] if len(contest.places) > 1 else []
            ranks[signal] = rank
            ordered[signal].insert(0, ordered[signal].pop(rank))
    if (veto := _engine_again(best, tracks, ranks)) is not None:
        contests = [contest for contest in contests if contest.signal is not veto.signal] + [veto]
        del ordered[veto.signal]
    return ordered, tuple(contests)


def _contest(signal: Signal, best: Best, tracks: Tracks, ranks: Mapping[Signal, int]) -> tuple[Contest, int]:
    """Return the contest for a quantity, and the rank of the candidate that it chose."""
    elsewhere = {best[other][rank].statistics.place for other, rank in ranks.items() if other is not signal}
    rivals = [
        rank
        for rank, candidate in enumerate(best[signal][:MOST_CANDIDATES])
        if rank == 0 or candidate.statistics.place not in elsewhere
    ]
    places = [candidate.statistics.place for candidate in best[signal][:MOST_CANDIDATES]]
    relation = next((one for one in RELATIONS if signal in one.of and _has(one, signal, tracks, ranks)), None)
    words, unit = ("", "") if relation is None else (relation.words, relation.unit)
    rival_places = tuple(places[rank] for rank in rivals)
    plain = Contest(
        signal=signal, relation=words, unit=unit, places=rival_places, misfits=(), sureness=Sureness.BY_NAME
    )
    if len(rivals) < 2 or any((signal, rank) not in tracks for rank in rivals):
        return plain, 0
    others = [] if relation is None else [other for other in relation.needs if other is not signal]
    series = {other: tracks[other, ranks[other]] for other in others}
    grid_ns = _grid(*series.values(), *(tracks[signal, rank] for rank in rivals))
    values = [_on_grid(signal, tracks[signal, rank], grid_ns) for rank in rivals]
    differs = _differ(signal, values)
    if not differs.any() and max((float(np.ptp(one)) for one in values if len(one)), default=0.0) > MANY * DIFFER:
        return replace(plain, sureness=Sureness.EQUAL), 0
    if relation is None:
        return plain, 0
    around = {other: _on_grid(other, one, grid_ns) for other, one in series.items()}
    total, rest = np.sum(values, axis=0), len(values) - 1
    misses = np.array([relation.misses({**around, signal: one}, signal, (total - one) / rest) for one in values])
    counts = np.isfinite(misses).all(axis=0) & differs
    blocks = (grid_ns / (BLOCK_S * NS_PER_S)).astype(np.int64)[counts]
    if len(np.unique(blocks)) < LEAST_BLOCKS:
        return replace(plain, sureness=Sureness.TOO_LITTLE), 0
    means = np.array([_by_block(one[counts], blocks) for one in misses])
    return _decided(plain, rivals, means)


def _decided(plain: Contest, rivals: Sequence[int], means: FloatArray) -> tuple[Contest, int]:
    """Return the contest after the misfits of the candidates in each block, shape (candidates, blocks)."""
    misfits = means.mean(axis=1)
    order = np.argsort(misfits, kind="stable").tolist()
    sureness, chosen = Sureness.EQUAL, 0  # the name's choice, unless another one is better by far
    if order[0] != 0 and (better := _sureness(means[order[0]], means[0])) is not Sureness.EQUAL:
        sureness, chosen = better, order[0]
    rest = [place for place in order if place != chosen]
    nearest = _sureness(means[chosen], means[rest[0]])
    if chosen == 0:
        sureness = nearest
    elif nearest is Sureness.EQUAL:
        sureness = Sureness.LIKELY  # against the name's choice it is sure, against a third one it is not
    ranked = [chosen, *rest]
    contest = replace(
        plain,
        places=tuple(plain.places[place] for place in ranked),
        misfits=tuple(float(misfits[place]) for place in ranked),
        sureness=sureness,
    )
    return contest, rivals[chosen]


def _sureness(good: FloatArray, bad: FloatArray) -> Sureness:
    """Return how surely the first of two candidates misses less, by their mean misses in each block."""
    ratio = float(bad.mean()) / max(float(good.mean()), 1e-9)
    more = bad - good
    stds = float(more.mean()) / max(float(more.std()) / np.sqrt(len(more)), 1e-9)
    if ratio < FAR_RATIO or stds < LEAST_STDS:
        return Sureness.EQUAL
    return Sureness.SURE if ratio >= SURE_RATIO and stds >= SURE_STDS else Sureness.LIKELY


def _engine_again(best: Best, tracks: Tracks, ranks: Mapping[Signal, int]) -> Contest | None:
    """Return the contest that a turbine speed loses which is engine speed once more, by the slip that is told."""
    needs = (Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP)
    if any(signal not in ranks or (signal, ranks[signal]) not in tracks for signal in needs):
        return None
    series = {signal: tracks[signal, ranks[signal]] for signal in needs}
    grid_ns = _grid(*series.values())
    at = {signal: _on_grid(signal, one, grid_ns) for signal, one in series.items()}
    slips = np.abs(at[Signal.LOCKUP_SLIP]) > DIFFER
    blocks = (grid_ns / (BLOCK_S * NS_PER_S)).astype(np.int64)[slips]
    if len(np.unique(blocks)) < LEAST_BLOCKS:
        return None
    misses = _slip_misses(at)[slips]
    same = rpm_from_rad_s(1.0) * np.abs(at[Signal.ENGINE_SPEED] - at[Signal.TURBINE_SPEED])[slips]
    found = _sureness(_by_block(np.asarray(same, np.float64), blocks), _by_block(misses, blocks))
    if found is not Sureness.SURE:
        return None
    place = best[Signal.TURBINE_SPEED][ranks[Signal.TURBINE_SPEED]].statistics.place
    return Contest(
        signal=Signal.TURBINE_SPEED,
        relation=f"{RELATIONS[0].words}: it is engine speed",
        unit="rpm",
        places=(place,),
        misfits=(float(misses.mean()),),
        sureness=Sureness.NONE,
    )


def _has(relation: Relation, signal: Signal, tracks: Tracks, ranks: Mapping[Signal, int]) -> bool:
    return all(other is signal or (other in ranks and (other, ranks[other]) in tracks) for other in relation.needs)


def _grid(*series: Series) -> Int64Array:
    """Return moments at which all have values: a grid over the time that they share."""
    if not all(len(one.t_ns) for one in series):
        return np.empty(0, np.int64)
    first, last = max(int(one.t_ns[0]) for one in series), min(int(one.t_ns[-1]) for one in series)
    grid_ns = np.arange(first, max(last, first), int(GRID_S * NS_PER_S), dtype=np.int64)
    is_known = np.ones(len(grid_ns), np.bool_)
    for one in series:
        behind = np.clip(one.t_ns.searchsorted(grid_ns, side="right"), 1, max(len(one.t_ns) - 1, 1))
        is_known &= np.take(one.t_ns, behind, mode="clip") - one.t_ns[behind - 1] < LONGEST_GAP_S * NS_PER_S
    return grid_ns[is_known]


def _on_grid(signal: Signal, series: Series, grid_ns: Int64Array) -> FloatArray:
    """Return a signal at other times: numbers of gears as they were told last, all others between two samples."""
    if signal in _HELD:
        return series.value[np.maximum(series.t_ns.searchsorted(grid_ns, side="right") - 1, 0)]
    return np.asarray(np.interp(grid_ns, series.t_ns, series.value), np.float64)


def _differ(signal: Signal, values: Sequence[FloatArray]) -> BoolArray:
    """Return where candidates are not alike: elsewhere nothing is decided."""
    table = np.array(values)
    spread, scale = np.ptp(table, axis=0), np.abs(table).max(axis=0, initial=0.0)
    differs = spread >= ANOTHER_GEAR if signal in _HELD else (spread > DIFFER) & (spread > DIFFER_RATIO * scale)
    return np.asarray(differs, np.bool_)


def _by_block(values: FloatArray, blocks: Int64Array) -> FloatArray:
    """Return the mean of each block."""
    _, place = np.unique(blocks, return_inverse=True)
    return np.asarray(np.bincount(place, values) / np.bincount(place), np.float64)
