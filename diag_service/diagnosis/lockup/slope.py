"""Slope of friction over slip of a lock-up clutch whose pressure is commanded: no level, but what damps the driveline.

While the controller holds a slip s, the engine's torque is (two-stage least squares: Wooldridge, Econometric Analysis
of Cross Section and Panel Data, chapter 5)

    T = a + c p + beta T_lining (s - s_mean) + k s w + e

with commanded pressure p, engine speed w, k of the converter's oil near lock, and e unknown to the torque model.
Pressure follows the stated torque, so slip gives way to e, and a plain fit of torque over slip finds less than there
is. Only the slip that is wanted moves from outside, or the mean of ten seconds, in which control takes away the rest.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from clutch_model.units import NS_PER_S, degc_from_k, k_from_degc, rpm_from_rad_s
from clutch_results.event_kinds import Shudder
from diag_service.diagnosis.columns import LOCKUP_SIGNALS, SLIP_SIGNALS, ColumnBatch, Signal
from diag_service.diagnosis.lockup.estimator import SwingBand, swings
from diag_service.diagnosis.lockup.state import LockupSamples, samples_of
from diag_service.diagnosis.lockup.whole_drive import WholeDrive

BLOCK_S: Final = 0.6  # rows of steady slip that count as one
CLUSTERS_S: Final = (10.0, 30.0)  # within which a torque model errs alike; whichever tells more
LEAST_ROWS: Final = 5  # in a block; and blocks with an open clutch, for the converter
LONGEST_GAP_NS: Final = NS_PER_S // 4  # between them
LEAST_CLUSTERS: Final = 4  # of ten seconds, for a slope
SLIP_RAD_S: Final = (0.4, 10.0)  # 4 rpm: closer a tooth decides; 95 rpm: more is not held
MOST_SLIP_STEP_RAD_S, MOST_PRESSURE_STEP = 1.6, 0.2  # within a block, of pressure over its mean
SETTLED_S, OPENED_S = 4.0, 1.0  # after pressure came (the piston fills, slip goes down its ramp), and after it went
OFF_RATIO: Final = 0.1  # of high pressure: below it the clutch is open
OPEN_SLIP_RAD_S, OPEN_RATIO = 2.0, 0.15  # and over engine speed: near lock the converter's torque is proportional to it
MOST_RATE_RAD_S2, LEAST_TURNING_RAD_S = 20.0, 60.0  # of the engine, of the turbine
APPLIED_RAD_S: Final = 3.0  # slip of an application at its end
LOCKED_RAD_S, LEAST_LOCKED = 0.05, 100  # slip that is wanted of a clutch that is to be locked, and its rows
BIN_K: Final = 10.0  # of oil temperature
FEED_FORWARD_R2: Final = 0.8  # of pressure by torque: beyond it pressure is what the torque model makes of it
RPM_10_RAD_S: Final = 10.0 * math.pi / 30.0
Known = tuple[float, float]  # mean and standard deviation, before any row:
LINING_S_RAD: Final = (0.0, 0.03 / RPM_10_RAD_S)  # wet linings: a sixth of mu over a Stribeck speed of 57 rpm
CONVERTER_NMS2: Final = (0.03, 0.02)  # of converters of 240 to 300 mm: torque over slip and speed near lock
INERTIA_KG_M2: Final = (0.25, 0.15)  # of engine and impeller
TORQUE_MODEL_NM: Final = (0.0, 6.0)  # by which torque models err, as an offset or over 100 rad/s of the engine
CURVED: Final = (0.0, 0.1)  # torque at twice the mean pressure, off its line over pressure
BY_HEAT_1_K: Final = (0.0, 3e-3)  # of friction
LAG_S, FREE = (0.0, 0.15), 1e6  # of pressure behind its command; deviation of what nothing is known of
NEARER_RATIO, SHAPE_RATIO = 1.1, 0.15  # of k under 50 rpm of slip over that at 100: capacity falls ever faster to lock
ALIKE_RATIO, ALIKE_OF_MEANS = 0.1, 0.5  # of the torque model's error goes along with wanted slip, with means of slip
LEAST_SEEN: Final = 3  # windows that swing: one or two may be chance
SHUDDER: Final = SwingBand(step_s=0.03, slowest_s=0.042, window=64, band_hz=(5.0, 15.0))  # 24 rows a second hold 10 Hz
HUNTING: Final = SwingBand(step_s=0.03, slowest_s=0.1, window=512, band_hz=(0.3, 2.0), line_hz=0.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeSlope:
    """Change of torque at fixed pressure over slip, relative to the torque [s/rad], and its 90 % interval."""

    mean_s_rad: float
    low_s_rad: float
    high_s_rad: float
    probability_positive: float

    @classmethod
    def of(cls, mean_s_rad: float, std_s_rad: float, freedom: float) -> Self:
        """Return Student's t as a slope."""
        from scipy.special import stdtr, stdtrit  # noqa: PLC0415 - a large library

        half = float(stdtrit(freedom, 0.95)) * std_s_rad
        chance = float(stdtr(freedom, mean_s_rad / std_s_rad))
        return cls(
            mean_s_rad=mean_s_rad,
            low_s_rad=mean_s_rad - half,
            high_s_rad=mean_s_rad + half,
            probability_positive=chance,
        )

    @property
    def word(self) -> str:
        """Whether torque rises or falls over slip; undecided where the interval holds both."""
        return "rises" if self.low_s_rad > 0.0 else "falls" if self.high_s_rad < 0.0 else "undecided"

    def __str__(self) -> str:
        sure = min(max(self.probability_positive, 0.001), 0.999)  # never certain
        mean, low, high = (100.0 * RPM_10_RAD_S * value for value in (self.mean_s_rad, self.low_s_rad, self.high_s_rad))
        return f"{mean:+.1f} % ({low:+.1f} to {high:+.1f}), {self.word}, positive with {100.0 * sure:.1f} %"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipSlope:
    """The slope of some rows: of clutch and converter together, which damps the driveline, and of the lining alone."""

    oil_k: tuple[float, float] | None  # None: all temperatures
    slip_s: float  # that it rests on
    together: RelativeSlope
    lining: RelativeSlope

    @property
    def name(self) -> str:
        """Which rows these are, for people."""
        low, high = (degc_from_k(end) for end in self.oil_k or (0.0, 0.0))
        return f"oil of {low:.0f} to {high:.0f} °C" if self.oil_k else "all temperatures"


@dataclass(frozen=True, slots=True, kw_only=True)
class LockupSlope:
    """What a drive tells of a lock-up clutch without a level."""

    withheld: str  # why there is no level
    slip_s: float  # that was steady
    slopes: tuple[SlipSlope, ...]  # of all rows, then by oil temperature; none: too little steady slip
    feed_forward_r2: float  # share of the pressure's variance that follows torque
    shudder: Shudder | None  # None: rows are too slow for it, or slip never lasted
    hunting: Shudder | None  # the same of the slip control, slowly
    locked_slip_rad_s: float | None  # median where none is wanted; None: it never was
    application_heats_j: tuple[float, ...]  # of each time that pressure came and slip went

    def lines(self) -> Iterator[str]:
        """Yield what else is known, a sentence each, for people."""
        if not self.slopes:
            yield f"No slope: {self.slip_s:.0f} s of steady slip are too few."
        if self.feed_forward_r2 > FEED_FORWARD_R2:
            yield f"Pressure follows the torque model (R2 {self.feed_forward_r2:.2f}): that is no friction."
        yield from swing_lines(self.shudder, self.hunting)
        if self.locked_slip_rad_s is not None:
            yield f"Slip where none is wanted: {rpm_from_rad_s(self.locked_slip_rad_s):.0f} rpm."
        heats_kj = [heat / 1e3 for heat in self.application_heats_j]
        heat = f", heat {np.mean(heats_kj):.1f} kJ on average, {max(heats_kj):.1f} at most" if heats_kj else ""
        yield f"Applications: {len(heats_kj)}{heat}."


def swing_lines(shudder: Shudder | None, hunting: Shudder | None) -> Iterator[str]:
    """Yield whether slip swings by itself, fast and slowly, for people."""
    for what, swing in (("Shudder", shudder), ("Hunting of the slip control", hunting)):
        if swing is None:
            yield f"{what}: cannot be told, the rows are too slow or slip is too short."
        else:
            seen = f"seen, at {swing.frequency_hz:.1f} Hz" if swing.seen_count >= LEAST_SEEN else "none"
            yield f"{what}: {seen} ({swing.seen_count} of {swing.window_count} windows)."


def slope_lines(slope: LockupSlope | None) -> Iterator[str]:
    """Yield what a drive tells of a lock-up clutch without a level, for people."""
    if slope is None:
        return
    yield "Lock-up clutch, torque at fixed pressure for 10 rpm more slip (90 % interval):"
    for part in slope.slopes:
        yield f"  {part.name}, {part.slip_s:.0f} s: with converter {part.together}; lining alone {part.lining}"
    yield from (f"  {line}" for line in slope.lines())


class SlopeSurvey:
    """Takes up the columns of a drive, whole."""

    def __init__(self, *, is_commanded: bool) -> None:
        self._is_commanded = is_commanded  # the pressure
        self._drive = WholeDrive(_WANTED)

    def feed(self, batch: ColumnBatch) -> None:
        """Keep the next columns."""
        self._drive.add(batch)

    def slope(self) -> LockupSlope | None:
        """Return what the drive tells; None if a signal never came."""
        rows = self.rows()
        return None if rows is None else lockup_slope(*rows, is_commanded=self._is_commanded)

    def rows(self) -> tuple[LockupSamples, FloatArray] | None:
        """Return samples, and the slip that is wanted (NaN: nobody says); None if a signal is missing."""
        columns = dict(self._drive.columns)
        if Signal.LOCKUP_PRESSURE_COMMAND in columns:
            columns.setdefault(Signal.LOCKUP_PRESSURE, columns[Signal.LOCKUP_PRESSURE_COMMAND])
        if {Signal.LOCKUP_SLIP, Signal.ENGINE_SPEED} <= columns.keys() and Signal.TURBINE_SPEED not in columns:
            slip, engine = columns[Signal.LOCKUP_SLIP], columns[Signal.ENGINE_SPEED]
            turbine = np.interp(slip.t_ns, engine.t_ns, engine.value) - slip.value
            columns[Signal.TURBINE_SPEED] = replace(slip, value=turbine)
        samples, wanted = samples_of(columns, LONGEST_GAP_NS), columns.get(Signal.LOCKUP_SLIP_COMMAND)
        if samples is None:
            return None
        t_ns = samples.t_ns
        return samples, np.full(len(t_ns), np.nan) if wanted is None else np.interp(t_ns, wanted.t_ns, wanted.value)


_WANTED: Final = LOCKUP_SIGNALS | SLIP_SIGNALS | {Signal.SUMP_TEMPERATURE}


def lockup_slope(samples: LockupSamples, wanted_rad_s: FloatArray, *, is_commanded: bool) -> LockupSlope:
    """Return what a drive tells of its lock-up clutch."""
    blocks, open_blocks = cut(samples, wanted_rad_s)
    k_nms2, open_pa = converter_of(open_blocks), _open_pa(samples)
    lows_k = k_from_degc(np.floor(degc_from_k(blocks.oil_k) / BIN_K) * BIN_K)
    parts: list[tuple[tuple[float, float] | None, SlipBlocks]] = [(None, blocks)]
    parts += [((low_k, low_k + BIN_K), blocks.where(lows_k == low_k)) for low_k in np.unique(lows_k).tolist()]
    slopes = [slope for bounds, part in parts if (slope := slope_of(part, k_nms2, bounds)) is not None]
    is_settled = _since(samples.t_ns / NS_PER_S, samples.pressure_pa < open_pa) > SETTLED_S
    locked = np.abs(samples.slip_rad_s[is_settled & (wanted_rad_s < LOCKED_RAD_S) & (samples.torque_nm > 0.0)])
    why = "pressure is commanded, its lag and scale unknown" if is_commanded else "the scale of pressure is unknown"
    return LockupSlope(
        withheld=f"The level of friction is withheld: {why}.",
        slip_s=BLOCK_S * len(blocks.t_s),
        slopes=tuple(slopes),
        feed_forward_r2=float(np.corrcoef(blocks.pressure_pa, blocks.torque_nm)[0, 1] ** 2) if slopes else 0.0,
        shudder=swings(samples, SHUDDER, open_pa),
        hunting=swings(samples, HUNTING, open_pa),
        locked_slip_rad_s=float(np.median(locked)) if len(locked) > LEAST_LOCKED else None,
        application_heats_j=tuple(application_heats_j(samples, k_nms2[0])),
    )


def _open_pa(samples: LockupSamples) -> float:
    """Return the pressure below which the clutch is open."""
    return OFF_RATIO * float(np.percentile(samples.pressure_pa, 95.0))


def _since(t_s: FloatArray, happens: BoolArray) -> FloatArray:
    """Return for how long it has not happened at each time [s]; infinite before the first."""
    return np.asarray(t_s - np.maximum.accumulate(np.where(happens, t_s, -np.inf)))


def application_heats_j(samples: LockupSamples, k_nms2: float) -> Iterator[float]:
    """Yield the heat of each application: torque of the clutch times slip, from when pressure comes until slip goes."""
    is_on, slip = samples.pressure_pa > _open_pa(samples), samples.slip_rad_s
    lining_nm, slips = samples.torque_nm - k_nms2 * slip * samples.engine_rad_s, slip > APPLIED_RAD_S
    heat_w = np.maximum(lining_nm, 0.0) * slip
    for start in np.flatnonzero(is_on[1:] & ~is_on[:-1] & slips[1:]) + 1:
        stop = start + int(np.argmax(~(is_on & slips)[start:]))
        if stop > start and is_on[stop]:
            yield float(np.trapezoid(heat_w[start : stop + 1], samples.t_ns[start : stop + 1] / NS_PER_S))


class SlipBlocks(NamedTuple):
    """Means of blocks, (m,) each, and how speed and pressure change in them."""

    t_s: FloatArray
    slip_rad_s: FloatArray
    engine_rad_s: FloatArray
    torque_nm: FloatArray
    pressure_pa: FloatArray
    wanted_rad_s: FloatArray
    oil_k: FloatArray
    engine_rate_rad_s2: FloatArray
    pressure_rate_pa_s: FloatArray

    def where(self, chosen: BoolArray) -> "SlipBlocks":
        return SlipBlocks(*(column[chosen] for column in self))

    @property
    def clusters(self) -> list[Int64Array]:
        """Which blocks are near each other, by each of the lengths that count as near."""
        return [np.unique(self.t_s // length_s, return_inverse=True)[1] for length_s in CLUSTERS_S]


def cut(samples: LockupSamples, wanted_rad_s: FloatArray) -> tuple[SlipBlocks, SlipBlocks]:
    """Return the blocks of steady slip, and those in which the clutch is open near lock."""
    t_s, slip, engine, pressure = samples.t_ns / NS_PER_S, samples.slip_rad_s, samples.engine_rad_s, samples.pressure_pa
    place = t_s // BLOCK_S
    begins = np.flatnonzero(np.diff(place, prepend=place[0] - 1.0))
    sizes = np.diff(begins, append=len(place))

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, begins) / sizes)

    away_s = t_s - np.repeat(mean(t_s), sizes)

    def rate(values: FloatArray) -> FloatArray:
        return np.asarray(mean(away_s * values) / np.maximum(mean(away_s**2), 1e-12))

    def always(happens: BoolArray) -> BoolArray:
        return np.asarray(np.logical_and.reduceat(happens, begins))

    columns = (t_s, slip, engine, samples.torque_nm, pressure, wanted_rad_s, samples.oil_k)
    blocks = SlipBlocks(*[*map(mean, columns), rate(engine), rate(pressure)])
    is_open, mean_slip = pressure < _open_pa(samples), blocks.slip_rad_s
    is_steady = (
        (sizes >= LEAST_ROWS)
        & always(~samples.is_bridged)
        & (np.abs(rate(slip)) * BLOCK_S < MOST_SLIP_STEP_RAD_S)
        & (np.abs(blocks.engine_rate_rad_s2) < MOST_RATE_RAD_S2)
        & (blocks.engine_rad_s - mean_slip > LEAST_TURNING_RAD_S)
        & (blocks.torque_nm > 0.0)
    )
    slips = (
        always(~is_open & (slip > 0.0) & (_since(t_s, is_open) > SETTLED_S))
        & (mean_slip > SLIP_RAD_S[0])
        & (mean_slip < SLIP_RAD_S[1])
        & (np.abs(blocks.pressure_rate_pa_s) * BLOCK_S < MOST_PRESSURE_STEP * blocks.pressure_pa)
    )
    opens = always(is_open & (_since(t_s, ~is_open) > OPENED_S)) & (mean_slip > OPEN_SLIP_RAD_S)
    opens &= mean_slip < OPEN_RATIO * blocks.engine_rad_s
    return blocks.where(is_steady & slips), blocks.where(is_steady & opens)


def converter_of(blocks: SlipBlocks) -> Known:
    """Return torque over slip and engine speed near lock [N m s2], by blocks with an open clutch if there are some."""
    if len(blocks.t_s) < LEAST_ROWS:
        return CONVERTER_NMS2
    own = blocks.slip_rad_s * blocks.engine_rad_s
    columns = np.column_stack([own, np.ones(len(own)), blocks.engine_rate_rad_s2])
    known = (CONVERTER_NMS2, TORQUE_MODEL_NM, INERTIA_KG_M2)
    mean, covariance = fitted(columns, blocks.torque_nm, known, blocks.clusters, ALIKE_RATIO)
    k_nms2 = NEARER_RATIO * float(mean[0])
    return k_nms2, math.hypot(NEARER_RATIO * math.sqrt(covariance[0, 0]), SHAPE_RATIO * k_nms2)


def slope_of(blocks: SlipBlocks, k_nms2: Known, oil_k: tuple[float, float] | None) -> SlipSlope | None:
    """Return the slope of some blocks by two-stage least squares; None if they are too few."""
    clusters, alike = blocks.clusters, ALIKE_RATIO
    if (freedom := int(clusters[0].max(initial=0))) < LEAST_CLUSTERS - 1:
        return None
    t_s, slip, engine, torque, pressure, wanted, oil, rate, pressure_rate = blocks
    if np.isnan(wanted).any():
        near = clusters[0]
        wanted, alike = (np.bincount(near, slip) / np.bincount(near))[near], ALIKE_OF_MEANS
    over, mean_nm, ones = pressure / pressure.mean() - 1.0, float(torque.mean()), np.ones(len(t_s))
    per_pressure_nm, middle_nm = np.polyfit(over, torque, 1)
    middle_rad_s, scaled_engine = float(slip.mean()), (engine - engine.mean()) / 100.0
    lining = np.maximum(per_pressure_nm * over + middle_nm - k_nms2[0] * middle_rad_s * engine, 1.0)
    own = np.column_stack([lining * (slip - middle_rad_s), slip * engine])
    late, warmer = -per_pressure_nm * pressure_rate / pressure.mean(), lining * (oil - oil.mean())
    others = np.column_stack([ones, over, rate, mean_nm * over**2, scaled_engine, warmer, late])
    known = (LINING_S_RAD, k_nms2, (mean_nm, FREE), (per_pressure_nm, FREE), INERTIA_KG_M2, CURVED, TORQUE_MODEL_NM)
    outside = np.column_stack([others, lining * (wanted - wanted.mean()), engine * (wanted - wanted.mean()), engine])
    outside /= np.linalg.norm(outside, axis=0) + 1e-12
    columns = np.column_stack([outside @ np.linalg.lstsq(outside, own, rcond=None)[0], others])
    mean, covariance = fitted(columns, torque, (*known, BY_HEAT_1_K, LAG_S), clusters, alike)
    shares = np.array([lining.mean(), engine.mean()]) / mean_nm
    both = float(shares @ mean[:2])
    variance = float(shares @ covariance[:2, :2] @ shares) + (both * TORQUE_MODEL_NM[1] / mean_nm) ** 2
    return SlipSlope(
        oil_k=oil_k,
        slip_s=BLOCK_S * len(t_s),
        together=RelativeSlope.of(both, math.sqrt(variance), freedom),
        lining=RelativeSlope.of(float(mean[0]), math.sqrt(covariance[0, 0]), freedom),
    )


def fitted(
    columns: FloatArray, torque_nm: FloatArray, known: Sequence[Known], clusters: Sequence[Int64Array], alike: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean (p,) and covariance (p, p) of coefficients by least squares beside what is known of them.

    ``columns`` (m, p) are torques [N m] of blocks by each coefficient, ``clusters`` numbers (m,) of neighbours. Blocks
    count for less by how much errors in clusters agree, as they weigh on the first coefficient, and by the part of all
    error that goes along with it, which no number of rows takes away.
    """
    means, stds = np.array(known, np.float64).T
    off, prior, information = torque_nm - columns @ means, np.diag(stds**-2.0), columns.T @ columns
    variance, left = float(off @ off) / len(off), off
    for _ in range(3):
        left = off - columns @ np.linalg.solve(information + prior * variance, columns.T @ off)
        variance = max(float(left @ left) / max(len(off) - len(means), 1), 0.01)
    weight = columns @ np.linalg.inv(information + prior * variance)[0]
    alone = variance * float(weight @ weight)
    as_one = [float((np.bincount(numbers, weight * left) ** 2).sum()) / alone for numbers in clusters]
    variance *= max(1.0, *as_one) + alike**2 * len(off)
    covariance = np.asarray(np.linalg.inv(information / variance + prior), np.float64)
    return means + covariance @ (columns.T @ off) / variance, covariance
