"""How well a gear change went: its parts with their units, one score, and what the control would have to adapt.

Parts, weights and their sources: docs/shift-quality.md. Signals that are missing leave parts out; the score is that of
the others.
"""

import math
from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from clutch_model.calibration import Calibration, ClutchCalibration, clutch_of_gear
from clutch_model.pack import clutch_heating_rate_k_s, contact_torque_nm, film_law
from diag_service.diagnosis.alignment import readings
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.events import EndReason, Event, EventKind
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import Knowledge, State
from diag_service.diagnosis.records import ShiftEstimate, ShiftQuality, from_plain
from diag_service.diagnosis.shifts.slip_tracking import LOADED_PA, SLIP_RAD_S

GRID_S = 0.01
BEFORE_S, AFTER_S = 0.3, 0.1  # of the signals around the event
NS_PER_S = 1e9
SLOPE_ROWS = 8  # of the parabola that differentiates the car's speed: 0.08 s on either side
JERK_ROWS = 10  # 0.1 s, over which a change of acceleration is felt as one
LOCKED_RAD_S = 2.0  # below it slip has ended
LANDING_ROWS = 10  # 0.1 s before, whose slope of slip is that at which the clutch locks
ASKED_NM = 2.0  # above it a clutch is asked to carry
LEAST_PAIRS = 10  # of commanded torque and pressure, which tell the touch point that a control believes in
MAP_PA = 0.05e5  # rms: beyond it the command is no straight line of the torque
PULSE_PA = 1.0e5  # above the touch point, with no torque asked for: the clutch is being filled
FILLED_ROWS = 4  # before torque is asked for, whose mean pressure tells how full the cavity is
PRESSURE_PA = 5.0e3  # of a reading, one deviation
FLOW_STD_RATIO = 0.2  # how well the flow of a pulse is known, of readings
FLOW_STD_S = 0.015  # likewise: a valve opens and closes late
WEAR_M3_J: Final = 1.4e-15  # of a wet paper lining, by Archard's law [C]: 1.4 mm3 per MJ
WORN_M: Final = 0.2e-3  # that each lining may lose [C]
ENERGY_BOUNDS_J: Final = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0)
LEAST_CHANGE: Final = {"touch_error_pa": 2.0e3, "fill_error_s": 0.04}  # a smaller one mends nothing that is felt
USUAL_M_S2: Final = 1.5  # acceleration of the car at which `free` and `felt` hold: a faster one hides more [C]
USUAL_S = 1.2  # from the request to the end of slip [C]
INTENDED_S: Final = {EventKind.COAST_SKIP: 1.8, EventKind.POWER_ON_SKIP: 1.8, EventKind.KICKDOWN: 1.5}  # other kinds
SCORED: Final = frozenset(
    {EventKind.SHIFT, EventKind.POWER_ON_UPSHIFT, EventKind.POWER_OFF_UPSHIFT, EventKind.COAST_DOWNSHIFT,
     EventKind.POWER_ON_DOWNSHIFT, *INTENDED_S}
)  # fmt: skip


class Part(NamedTuple):
    """What a part of the score is worth: up to ``free`` it costs nothing, at ``felt`` its weight."""

    name: str  # of the field of `ShiftQuality`
    weight: float
    free: float
    felt: float
    is_relative: bool = False  # it is felt beside the acceleration that the driver asked for


PARTS: Final = (
    Part("jerk_m_s3", 25.0, 12.0, 30.0, is_relative=True),
    Part("torque_hole_m_s2", 15.0, 0.8, 2.0, is_relative=True),
    Part("flare_rad_s", 15.0, 3.0, 15.0),
    Part("tie_up_nm", 15.0, 8.0, 40.0),
    Part("fill_error_s", 10.0, 0.04, 0.12),
    Part("touch_error_pa", 15.0, 0.05e5, 0.2e5),
    Part("lock_rate_rad_s2", 10.0, 100.0, 400.0),
    Part("overtime_s", 5.0, 0.1, 0.6),
    Part("temperature_rise_k", 5.0, 6.0, 30.0),
)


_PUBLIC: Final = (
    *(part.name for part in PARTS),
    "std_fill_error_s",
    "std_touch_error_pa",
    "slip_energy1_j",
    "slip_energy2_j",
    "believed_touch_pa",
    "fill_time_s",
    "pressure_lag_s",
    "pressure_reach_ratio",
    "pressure_short_pa",
    "acceleration_m_s2",
    "peak1_k",
    "peak2_k",
    "life1_ratio",
    "life2_ratio",
)


@dataclass(frozen=True, slots=True)
class _Pack:
    """What the calibration says of one clutch."""

    touch_pa: float
    torque_nm_pa: float  # that it carries per pressure beyond its touch point
    stroke_pa: float  # by which its spring's pressure grows while its cavity fills
    heat_j_k: float
    cooling_w_k: float
    life_j: float  # of slip, after which its linings are worn

    @classmethod
    def of(cls, clutch: ClutchCalibration) -> Self:
        film, piston = film_law(clutch), clutch.piston
        by_piston = film.piston_area_m2 / film.lining_area_m2
        return cls(
            touch_pa=clutch.touch_pressure_pa,
            torque_nm_pa=contact_torque_nm(1.0, clutch.friction.mu_c, by_piston, film.contact_factor_m3),
            stroke_pa=piston.spring_rate_n_m * piston.fill_stroke_m / film.piston_area_m2,
            heat_j_k=clutch.thermal.heat_capacity_j_k,
            cooling_w_k=clutch.thermal.convection_w_k,
            life_j=WORN_M * film.lining_area_m2 * clutch.geometry.interface_count / WEAR_M3_J,
        )


_PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_SHAFTS: Final = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
_COMMANDS: Final = (Signal.CLUTCH1_PRESSURE_COMMAND, Signal.CLUTCH2_PRESSURE_COMMAND)
_ASKINGS: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_SPEEDS: Final = (Signal.ENGINE_SPEED, Signal.HUB_SPEED, Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)
_SIGNALS: Final = (*_SPEEDS, *_SHAFTS, *_PRESSURES, *_COMMANDS, *_ASKINGS, Signal.ENGINE_TORQUE)
_ENGINE, _ON, _OFF, _CAR, _PRESSURE_ON, _PRESSURE_OFF, _COMMAND, _ASKED, _TORQUE, _SLOPE, _ROW_COUNT = range(11)


_NO_HEAT: Final = (math.nan, math.nan, math.nan, 0.0)


class _Found(NamedTuple):
    """What the signals of an event tell; NaN: nothing."""

    flare_rad_s: float = math.nan
    locked_s: float = math.nan  # after the start
    lock_rate_rad_s2: float = math.nan
    torque_hole_m_s2: float = math.nan
    jerk_m_s3: float = math.nan
    acceleration_m_s2: float = math.nan  # of the car before or after, whichever is larger
    tie_up_nm: float = math.nan
    energy_on_j: float = math.nan
    energy_off_j: float = math.nan
    peak_on_k: float = math.nan  # of the packs
    peak_off_k: float = math.nan
    believed_touch_pa: float = math.nan  # the touch point by which the control commands pressures
    believed_std_pa: float = math.nan
    share: float = math.nan  # of the cavity that is full as torque is asked for; above 1: it was too early
    fill_time_s: float = math.nan  # that a whole filling takes at the flow of this one
    pulse_s: float = math.nan  # that it was filled for
    early_s: float = math.nan  # by which it was full before the pulse ended; 0: it was not
    pressure_lag_s: float = math.nan  # of the pressure behind its command, the clutch closed
    pressure_reach_ratio: float = math.nan  # of the command that the pressure reaches beyond the touch point
    pressure_short_pa: float = math.nan  # by which it stays below the highest command


class ShiftScorer:
    """Says how well the events of one vehicle go.

    Parameters
    ----------
    calibration
        Of the vehicle: touch points, torque per pressure, heat capacities.
    gears
        By which the speeds of input shafts are known that the bus does not tell.
    """

    def __init__(self, calibration: Calibration, gears: GearRatios | None) -> None:
        self._packs = tuple(_Pack.of(clutch) for clutch in calibration.clutches)
        self._gears = gears
        nothing = np.full((_ROW_COUNT, 30), np.nan)
        none, pack = (0.0, 0.0), (0.0, 1.0, 0.0)
        _measure(nothing, 15, 20, True, 0.0, none, (pack, pack), 1.0, _NO_HEAT)  # compiled before the first event
        _response_told(nothing, 15, 20, 0.0)

    def score(self, event: Event, known: Knowledge | None, warm: PackTemperatures | None = None) -> ShiftQuality | None:
        """Return how well an event went; None if the stream broke off.

        ``known`` are the touch points and the zeros of the pressure sensors; None: what pressures mean is not known.
        ``warm`` are the packs after an earlier event; None: they begin as warm as the oil.
        """
        duration_s = (event.end_ns - event.start_ns) / NS_PER_S
        if event.end_reason is EndReason.INTERRUPTED or duration_s <= 0.0:
            return None
        on, off = clutch_of_gear(event.to_gear) - 1, clutch_of_gear(event.from_gear) - 1
        grid_s = np.arange(-BEFORE_S, duration_s + AFTER_S, GRID_S)
        rows, packs = np.full((_ROW_COUNT, len(grid_s)), np.nan), (self._packs[on], self._packs[off])
        values = readings(
            event.columns, _SIGNALS if self._gears is None else (*_SIGNALS, self._gears.over), event.start_ns, grid_s
        )
        skew_s = self._fill_speeds(event, (on, off), values, rows)
        touch_pa = packs[0].touch_pa, packs[1].touch_pa
        if known is not None:
            for row, signal, zero_pa in (
                (_PRESSURE_ON, _PRESSURES[on], known.mean[State.ZERO1 + on]),
                (_PRESSURE_OFF, _PRESSURES[off], known.mean[State.ZERO1 + off]),
                (_COMMAND, _COMMANDS[on], 0.0),
                (_ASKED, _ASKINGS[on], 0.0),
                (_TORQUE, Signal.ENGINE_TORQUE, 0.0),
            ):
                if signal in values:
                    rows[row] = values[signal] - zero_pa
            touch_pa = (
                touch_pa[0] + float(known.mean[State.TOUCH1 + on]),
                touch_pa[1] + float(known.mean[State.TOUCH1 + off]),
            )
        first, stop = round(BEFORE_S / GRID_S), round((BEFORE_S + duration_s) / GRID_S)
        on_pack, off_pack = ((pack.torque_nm_pa, pack.heat_j_k, pack.cooling_w_k) for pack in packs)
        heat, oil = _NO_HEAT, event.columns.get(Signal.SUMP_TEMPERATURE)
        if oil is not None and len(oil.value):
            oil_k = float(oil.value.mean())
            heat = oil_k, oil_k, oil_k, 0.0
            if warm is not None and event.start_ns > warm.at_ns:
                age_s = (event.start_ns - warm.at_ns) / NS_PER_S
                heat = oil_k, warm.clutch_k[on], warm.clutch_k[off], age_s
        stroke_pa = packs[0].stroke_pa
        parts = _measure(rows, first, stop, on != off, skew_s, touch_pa, (on_pack, off_pack), stroke_pa, heat)
        found = _Found._make((*parts, *_response_told(rows, first, stop, touch_pa[0])))
        adaptable = {} if known is None else self._adaptable(on, found, touch_pa[0], known)
        return _judged(event, found, adaptable, packs, is_second=on == 1)

    def _fill_speeds(
        self, event: Event, clutches: tuple[int, int], values: Mapping[Signal, FloatArray], rows: FloatArray
    ) -> float:
        """Fill in the speeds of engine, both shafts and the car; return by how much they may be apart [s]."""
        skew_s, gears = 0.0, self._gears
        for signal in (Signal.ENGINE_SPEED, Signal.HUB_SPEED):
            if signal in values:
                rows[_ENGINE] = values[signal]
        for row, clutch, gear in zip((_ON, _OFF), clutches, (event.to_gear, event.from_gear), strict=True):
            if _SHAFTS[clutch] in values:
                rows[row] = values[_SHAFTS[clutch]]
            elif gears is not None and gears.over in values:  # asked for after the engine's speed
                t_ns = event.columns[gears.over].t_ns
                skew_s = float(t_ns[-1] - t_ns[0]) / NS_PER_S / (len(t_ns) - 1)
                if 1 <= gear <= len(gears.ratios):
                    rows[row] = gears.ratios[gear - 1] * values[gears.over]
        speed = event.columns.get(Signal.VEHICLE_SPEED)
        if speed is not None and len(speed.value):
            turning = values.get(Signal.OUTPUT_SPEED)  # finer than the car's own
            if turning is not None:
                rows[_CAR] = turning * (speed.value.mean() / mean if (mean := turning.mean()) > 1.0 else math.nan)
            elif Signal.VEHICLE_SPEED in values:
                rows[_CAR] = values[Signal.VEHICLE_SPEED]
        return skew_s

    def _adaptable(self, on: int, found: _Found, touch_pa: float, known: Knowledge) -> dict[str, tuple[float, float]]:
        """Return what could be adapted of the on-coming clutch, by part: value and deviation."""
        adaptable = {}
        std_pa = math.sqrt(known.covariance[State.TOUCH1 + on, State.TOUCH1 + on])
        if math.isfinite(found.believed_touch_pa):
            adaptable["touch_error_pa"] = touch_pa - found.believed_touch_pa, math.hypot(std_pa, found.believed_std_pa)
        if math.isfinite(found.share):
            s_per_share = found.fill_time_s
            longer_s = -found.early_s if found.share >= 1.0 else (1.0 - found.share) * s_per_share
            read_std = math.hypot(std_pa, PRESSURE_PA / math.sqrt(FILLED_ROWS)) / self._packs[on].stroke_pa
            flow_std = math.hypot(FLOW_STD_RATIO, FLOW_STD_S / found.pulse_s) * longer_s
            adaptable["fill_error_s"] = longer_s, math.hypot(read_std * s_per_share, flow_std, GRID_S)
        return adaptable


def _judged(
    event: Event,
    found: _Found,
    adaptable: dict[str, tuple[float, float]],
    packs: tuple[_Pack, _Pack],
    *,
    is_second: bool,
) -> ShiftQuality:
    """Return the parts of an event, what they cost, and what of the control is wrong for sure."""
    energies_j, peaks_k = (found.energy_on_j, found.energy_off_j), (found.peak_on_k, found.peak_off_k)
    told: dict[str, float] = {
        **found._asdict(),
        **{name: value for name, (value, _) in adaptable.items()},
        **{f"std_{name}": std for name, (_, std) in adaptable.items()},
        "overtime_s": max(found.locked_s - INTENDED_S.get(event.kind, USUAL_S), 0.0 * found.locked_s),
        "temperature_rise_k": max(energies_j[0] / packs[0].heat_j_k, energies_j[1] / packs[1].heat_j_k),
        "slip_energy1_j": energies_j[is_second],
        "slip_energy2_j": energies_j[not is_second],
        "peak1_k": peaks_k[is_second],
        "peak2_k": peaks_k[not is_second],
        "life1_ratio": energies_j[is_second] / packs[is_second].life_j,
        "life2_ratio": energies_j[not is_second] / packs[not is_second].life_j,
    }
    parts = {name: float(told[name]) for name in _PUBLIC if math.isfinite(told.get(name, math.nan))}
    record: dict[str, object] = {"score": None, **parts}
    if event.kind in SCORED:
        record["score"], record["reasons"] = weighed(parts)
        record["corrections"] = [
            name for name, (value, std) in adaptable.items() if abs(value) > max(2.0 * std, LEAST_CHANGE[name])
        ]
    return from_plain(record, ShiftQuality)


def weighed(parts: Mapping[str, float]) -> tuple[float | None, list[str]]:
    """Return the score of some parts by their names, None of none, and those that cost a point, the dearest first.

    Twice as much is felt less than twice as strongly: beyond `felt` the logarithm bends what a part costs.
    """
    hides = (1.0 + parts.get("acceleration_m_s2", USUAL_M_S2)) / (1.0 + USUAL_M_S2)
    costs = {}
    for part in PARTS:
        if part.name in parts:
            size = abs(parts[part.name]) / (hides if part.is_relative else 1.0)
            beyond = max(size - part.free, 0.0) / (part.felt - part.free)
            costs[part.name] = part.weight * math.log1p((math.e - 1.0) * beyond)
    weight = sum(part.weight for part in PARTS if part.name in costs)
    if not weight:
        return None, []
    dear = sorted((name for name in costs if costs[name] >= 0.01 * weight), key=lambda name: -costs[name])
    return 100.0 * math.exp(-sum(costs.values()) / weight), dear


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one clutch had to bear."""

    clutch: int
    counts: tuple[int, ...] = (0,) * (len(ENERGY_BOUNDS_J) + 1)  # events by slip energy, bounds as ENERGY_BOUNDS_J
    energy_j: float = 0.0
    peak_k: float | None = None  # of the pack
    launch_count: int = 0
    life_ratio: float = 0.0  # of a lining's life that this energy consumes: an index, docs/shift-quality.md


_UNLOADED: Final = Load(clutch=0)


def borne(before: Mapping[int, Load], estimate: ShiftEstimate) -> dict[int, Load]:
    """Return what each clutch had to bear after one more event; slip without pressures tells no energy."""
    found, quality = dict(before), estimate.shift_quality
    if quality is None:
        return found
    for clutch, energy_j, peak_k, life_ratio in (
        (1, quality.slip_energy1_j, quality.peak1_k, quality.life1_ratio),
        (2, quality.slip_energy2_j, quality.peak2_k, quality.life2_ratio),
    ):
        is_launch = estimate.kind is EventKind.LAUNCH and estimate.clutch == clutch
        if energy_j or is_launch:
            old = found.get(clutch, _UNLOADED)
            counts = list(old.counts)
            counts[bisect(ENERGY_BOUNDS_J, energy_j or 0.0)] += bool(energy_j)
            found[clutch] = Load(
                clutch=clutch,
                counts=tuple(counts),
                energy_j=old.energy_j + (energy_j or 0.0),
                peak_k=max(peak_k or 0.0, old.peak_k or 0.0) or None,
                launch_count=old.launch_count + is_launch,
                life_ratio=old.life_ratio + (life_ratio or 0.0),
            )
    return found


@array_kernel
def _mean(row: FloatArray, first: int, stop: int) -> float:
    """Return the mean of some rows."""
    total = 0.0
    for place in range(first, stop):
        total += row[place]
    return total / max(stop - first, 1)


@array_kernel
def _differentiate(car_m_s: FloatArray, slopes: FloatArray) -> None:
    """Fill in the slope of a straight line around each row [m/s2]; near both ends it stays."""
    square = 0.0
    for k in range(-SLOPE_ROWS, SLOPE_ROWS + 1):
        square += k * k
    for row in range(SLOPE_ROWS, len(car_m_s) - SLOPE_ROWS):
        moment = 0.0
        for k in range(-SLOPE_ROWS, SLOPE_ROWS + 1):
            moment += k * car_m_s[row + k]
        slopes[row] = moment / square / GRID_S


@array_kernel
def _speeds_told(
    rows: FloatArray,
    first: int,
    stop: int,
    is_handover: bool,  # noqa: FBT001
    skew_s: float,
) -> tuple[float, float, float]:
    """Return flare [rad/s], when slip ended [s], and how fast it did [rad/s2]."""
    engine, on, off = rows[_ENGINE], rows[_ON], rows[_OFF]
    flare, peak, at, skew = np.nan, 0.0, -1, round(skew_s / GRID_S)
    for row in range(first, stop):
        slip = abs(engine[row] - on[row])
        if slip > peak:
            peak, at = slip, row
        if is_handover:
            least = np.inf
            for apart in range(-skew, skew + 1):
                beyond = 0.0
                for place in range(row - 1, row + 2):
                    low, high = min(on[place], off[place]), max(on[place], off[place])
                    one = engine[min(max(place + apart, 0), len(engine) - 1)]
                    beyond += max(one - high, low - one, 0.0) / 3.0
                least = min(least, beyond)
            flare = least if least < np.inf and not flare > least else flare
    if at < 0 or peak < SLIP_RAD_S:
        return flare, np.nan, np.nan
    row, sign = at, 1.0 if engine[at] > on[at] else -1.0
    while row < stop and sign * (engine[row] - on[row]) >= LOCKED_RAD_S:  # or beyond: rows may be far apart
        row += 1
    if row == stop:
        return flare, np.nan, np.nan
    moment, square, middle = 0.0, 0.0, 0.5 * (LANDING_ROWS - 1)
    for k in range(LANDING_ROWS):
        place = row - LANDING_ROWS + k
        moment += (k - middle) * abs(engine[place] - on[place])
        square += (k - middle) ** 2
    return flare, (row - first) * GRID_S, max(-moment / square / GRID_S, 0.0)


@array_kernel
def _car_told(slopes: FloatArray, first: int, stop: int) -> tuple[float, float, float]:
    """Return by how much the car's acceleration fell below that before and after, its jerk, and the larger of both."""
    end = min(stop + 1, len(slopes) - SLOPE_ROWS)
    before, after = _mean(slopes, SLOPE_ROWS, first - SLOPE_ROWS // 2), _mean(slopes, end - SLOPE_ROWS, end)
    level = min(before, after)
    hole, jerk = 0.0, 0.0
    for row in range(first, end):
        hole = max(hole, level - slopes[row])
        jerk = max(jerk, abs(slopes[row] - slopes[row - JERK_ROWS]) / (JERK_ROWS * GRID_S))
    return (np.nan, np.nan, np.nan) if math.isnan(level) else (hole, jerk, max(abs(before), abs(after)))


@array_kernel
def _loads_told(
    rows: FloatArray,
    first: int,
    stop: int,
    is_handover: bool,  # noqa: FBT001
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    heat: tuple[float, float, float, float],
) -> tuple[float, float, float, float, float]:
    """Return what both clutches carried against each other [N m], the slip energy and the peak of each [J, K].

    ``heat`` is the oil, both packs and how long ago they were so warm [K, s]; a pack is warm throughout. ``packs``
    are of each the torque that it carries by pressure, what warms it and what cools it [N m/Pa, J/K, W/K].
    """
    tie_up, energy_on, energy_off = np.nan, 0.0, 0.0
    if math.isnan(rows[_PRESSURE_ON, first]):
        return tie_up, np.nan, np.nan, np.nan, np.nan
    oil_k, age_s = heat[0], heat[3]
    (on_nm_pa, on_j_k, on_w_k), (off_nm_pa, off_j_k, off_w_k) = packs
    on_k = oil_k + (heat[1] - oil_k) * math.exp(-age_s * on_w_k / on_j_k)
    off_k = oil_k + (heat[2] - oil_k) * math.exp(-age_s * off_w_k / off_j_k)
    peak_on_k, peak_off_k = on_k, off_k
    for row in range(first, stop):
        on_pa = _mean(rows[_PRESSURE_ON], row - 1, row + 2) - touch_pa[0]
        off_pa = _mean(rows[_PRESSURE_OFF], row - 1, row + 2) - touch_pa[1]
        on_nm, off_nm = max(on_pa, 0.0) * on_nm_pa, max(off_pa, 0.0) * off_nm_pa
        on_slip = abs(rows[_ENGINE, row] - rows[_ON, row])
        power_w = on_nm * on_slip if on_slip > LOCKED_RAD_S else 0.0
        energy_on += power_w * GRID_S
        on_k += GRID_S * clutch_heating_rate_k_s(power_w, on_k, oil_k, on_j_k, on_w_k)
        peak_on_k = max(peak_on_k, on_k)
        if is_handover:
            off_slip = abs(rows[_ENGINE, row] - rows[_OFF, row])
            power_w = off_nm * off_slip if off_slip > LOCKED_RAD_S and off_pa > LOADED_PA else 0.0
            energy_off += power_w * GRID_S
            off_k += GRID_S * clutch_heating_rate_k_s(power_w, off_k, oil_k, off_j_k, off_w_k)
            peak_off_k = max(peak_off_k, off_k)
            both_nm = min(on_nm - abs(_mean(rows[_TORQUE], row - 2, row + 3)), off_nm if off_pa > LOADED_PA else 0.0)
            if not math.isnan(both_nm) and not tie_up > both_nm:
                tie_up = max(both_nm, 0.0)
    return tie_up, energy_on, energy_off, peak_on_k, peak_off_k if is_handover else np.nan


@array_kernel
def _map_told(rows: FloatArray, stop: int) -> tuple[float, float]:
    """Return the pressure at which the control believes that the clutch carries nothing [Pa], and its deviation."""
    command, asked = rows[_COMMAND], rows[_ASKED]
    count, x1, x2, y1, y2, xy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(1, stop - 1):
        is_steady = abs(asked[row + 1] - asked[row - 1]) < 15.0  # commands of two messages, a row apart
        if is_steady and asked[row] > ASKED_NM and asked[row - 1] > ASKED_NM and asked[row + 1] > ASKED_NM:
            count, x1, y1 = count + 1, x1 + asked[row], y1 + command[row]
            x2, y2, xy = x2 + asked[row] ** 2, y2 + command[row] ** 2, xy + asked[row] * command[row]
    if count < LEAST_PAIRS:
        return np.nan, np.nan
    x1, y1 = x1 / count, y1 / count
    across = x2 / count - x1 * x1
    if not across > 100.0:  # 10 N m
        return np.nan, np.nan
    slope = (xy / count - x1 * y1) / across
    rms = math.sqrt(max(y2 / count - y1 * y1 - slope * slope * across, 0.0))
    if rms > MAP_PA:
        return np.nan, np.nan
    return y1 - slope * x1, rms * math.sqrt((1.0 + x1 * x1 / across) / count) + 500.0  # half a step of the command


@array_kernel
def _fill_told(
    rows: FloatArray, first: int, stop: int, touch_pa: float, stroke_pa: float
) -> tuple[float, float, float, float]:
    """Return how full the cavity is as torque is asked for, how long all takes, the pulse, what was too long [s]."""
    command, asked, pressure = rows[_COMMAND], rows[_ASKED], rows[_PRESSURE_ON]
    row, pulse, ended, full = first, 0, first, -1
    while row < stop and not (asked[row] >= ASKED_NM and pulse > 0):
        if asked[row] < ASKED_NM and command[row] > touch_pa + PULSE_PA:
            pulse, ended = pulse + 1, row + 1
        if full < 0 and pressure[row] > touch_pa + LOADED_PA and pressure[row + 1] > touch_pa + LOADED_PA:
            full = row if pulse > 0 else -1
        row += 1
    if row >= stop or pulse == 0:
        return np.nan, np.nan, np.nan, np.nan
    if full >= 0:
        return 1.0, pulse * GRID_S, pulse * GRID_S, max((ended - full) * GRID_S, 0.0)
    last = min(ended + 1 + FILLED_ROWS, row)  # a valve goes on for a moment
    at_end = 1.0 - max(touch_pa - _mean(pressure, last - FILLED_ROWS, last), 0.0) / stroke_pa
    short_pa = touch_pa - _mean(pressure, row - FILLED_ROWS, row)
    return 1.0 - max(short_pa, 0.0) / stroke_pa, pulse * GRID_S / max(at_end, 0.1), pulse * GRID_S, 0.0


@array_kernel
def _response_told(rows: FloatArray, first: int, stop: int, touch_pa: float) -> tuple[float, float, float]:
    """Return how the pressure of a closed clutch follows its command: lag [s], ratio, and what the highest lacks [Pa].

    By least squares: the pressure is a part of the command and of its slope.
    """
    command, pressure = rows[_COMMAND], rows[_PRESSURE_ON]
    n, c1, d1, cc, cd, dd, p1, pc, pd, top, top_row = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1
    for row in range(first + 2, min(stop + 8, len(command) - 2)):
        here = command[row] - touch_pa
        least = min(command[row - 2], command[row + 2]) - touch_pa
        if not (least > PULSE_PA and pressure[row - 2] > touch_pa + LOADED_PA and pressure[row] > touch_pa + LOADED_PA):
            continue
        slope, read = (command[row + 1] - command[row - 1]) / (2.0 * GRID_S), pressure[row] - touch_pa
        n, c1, d1, p1 = n + 1, c1 + here, d1 + slope, p1 + read
        cc, cd, dd = cc + here * here, cd + here * slope, dd + slope * slope
        pc, pd = pc + read * here, pd + read * slope
        if here > top:
            top, top_row = here, row
    if n < LEAST_PAIRS:
        return np.nan, np.nan, np.nan
    cc, cd, dd, pc, pd = cc - c1 * c1 / n, cd - c1 * d1 / n, dd - d1 * d1 / n, pc - p1 * c1 / n, pd - p1 * d1 / n
    whole = cc * dd - cd * cd
    if whole <= 0.0:
        return np.nan, np.nan, np.nan
    reach, by_slope = (pc * dd - pd * cd) / whole, (pd * cc - pc * cd) / whole
    stays = min(top_row + 4, len(pressure) - 3)
    return -by_slope / reach, reach, top - (_mean(pressure, stays - 2, stays + 3) - touch_pa)


@array_kernel
def _measure(
    rows: FloatArray,
    first: int,
    stop: int,
    is_handover: bool,  # noqa: FBT001 - a compiled function
    skew_s: float,
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    stroke_pa: float,
    heat: tuple[float, float, float, float],
) -> tuple[float, ...]:
    """Return the fields of `_Found`; the event lasts from row ``first`` to before ``stop``."""
    flare, locked_s, lock_rate = _speeds_told(rows, first, stop, is_handover, skew_s)
    _differentiate(rows[_CAR], rows[_SLOPE])
    hole, jerk, acceleration = _car_told(rows[_SLOPE], first, stop)
    tie_up, energy_on, energy_off, peak_on, peak_off = _loads_told(
        rows, first, stop, is_handover, touch_pa, packs, heat
    )
    believed, believed_std = _map_told(rows, stop)
    share, fill_s, pulse_s, early_s = _fill_told(rows, first, stop, touch_pa[0], stroke_pa)
    return (
        flare, locked_s, lock_rate, hole, jerk, acceleration, tie_up, energy_on, energy_off, peak_on, peak_off,
        believed, believed_std, share, fill_s, pulse_s, early_s,
    )  # fmt: skip
