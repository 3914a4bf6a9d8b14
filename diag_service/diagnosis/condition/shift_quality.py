"""What a gear change was like: indices by speeds and torques alone; parts of its quality, one score.

Definitions and limits of the indices: docs/model.md. Parts, weights and their sources: docs/verdict.md. Signals
that are missing leave parts out; the score is that of the others.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration, ClutchCalibration, clutch_of_gear
from clutch_model.pack import contact_torque_nm, film_law
from clutch_results.event_kinds import GEAR_CHANGES, EndReason, EventKind
from clutch_results.loads import PARTS
from clutch_results.records import ShiftIndices, ShiftQuality
from diag_service.diagnosis.alignment import readings
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.condition import shift_kernels as loops
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import Knowledge, State
from diag_service.diagnosis.shifts.slip_tracking import LOADED_NM, LOADED_PA, PRESSURES, SHAFTS, SLIP_RAD_S

BEFORE_S, AFTER_S = 0.3, 0.1  # of the signals around the event
NS_PER_S = 1e9
PRESSURE_PA = 5.0e3  # of a reading, one deviation
FLOW_STD_RATIO = 0.2  # how well the flow of a pulse is known, of readings
FLOW_STD_S = 0.015  # likewise: a valve opens and closes late
WEAR_M3_J: Final = 1.4e-15  # of a wet paper lining, by Archard's law [C]: 1.4 mm3 per MJ
WORN_M: Final = 0.2e-3  # that each lining may lose [C]
USUAL_M_S2: Final = 1.5  # acceleration of the car at which `free` and `felt` hold: a faster one hides more [C]
USUAL_S = 1.2  # from the request to the end of slip [C]
INTENDED_S: Final = {EventKind.COAST_SKIP: 1.8, EventKind.POWER_ON_SKIP: 1.8, EventKind.KICKDOWN: 1.5}  # other kinds
MOST = 1e12  # of any part, whatever its unit: a damaged value of a log may be any number
INDEX_GRID_S = 0.005
MIN_WINDOW_S = 0.1
CORRELATION_S = 0.1  # residuals are alike for about as long as torque lags
INERTIA_STD_RATIO = 0.2  # of the engine inertia: below the first tier nobody has calibrated it for the vehicle


_PUBLIC: Final = tuple(one.name for one in fields(ShiftQuality) if one.name not in {"score", "reasons"})


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


_COMMANDS: Final = (Signal.CLUTCH1_PRESSURE_COMMAND, Signal.CLUTCH2_PRESSURE_COMMAND)
_ASKINGS: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_SPEEDS: Final = (Signal.ENGINE_SPEED, Signal.HUB_SPEED, Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED, *SHAFTS)
_SIGNALS: Final = tuple(  # by which clutch comes on
    (*_SPEEDS, *PRESSURES, *of_clutch, Signal.ENGINE_TORQUE) for of_clutch in zip(_COMMANDS, _ASKINGS, strict=True)
)


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

    @np.errstate(over="ignore", invalid="ignore")  # a damaged value of a log may be any number
    def score(self, event: Event, known: Knowledge | None, warm: PackTemperatures | None = None) -> ShiftQuality | None:
        """Return how well an event went; None if the stream broke off.

        ``known`` are the touch points and the zeros of the pressure sensors; None: what pressures mean is not known.
        ``warm`` are the packs after an earlier event; None: they begin as warm as the oil.
        """
        duration_s = (event.end_ns - event.start_ns) / NS_PER_S
        if event.end_reason is EndReason.INTERRUPTED or duration_s <= 0.0:
            return None
        on, off = clutch_of_gear(event.to_gear) - 1, clutch_of_gear(event.from_gear) - 1
        grid_s = np.arange(-BEFORE_S, duration_s + AFTER_S, loops.GRID_S)
        rows, packs = np.full((loops.ROW_COUNT, len(grid_s)), np.nan), (self._packs[on], self._packs[off])
        signals = _SIGNALS[on] if self._gears is None else (*_SIGNALS[on], self._gears.over)
        values = readings(event.columns, signals, event.start_ns, grid_s)
        skew_s = self._fill_speeds(event, (on, off), values, rows)
        touch_pa = packs[0].touch_pa, packs[1].touch_pa
        if known is not None:
            for row, signal, zero_pa in (
                (loops.PRESSURE_ON, PRESSURES[on], known.mean[State.ZERO1 + on]),
                (loops.PRESSURE_OFF, PRESSURES[off], known.mean[State.ZERO1 + off]),
                (loops.COMMAND, _COMMANDS[on], 0.0),
                (loops.ASKED, _ASKINGS[on], 0.0),
                (loops.TORQUE, Signal.ENGINE_TORQUE, 0.0),
            ):
                if signal in values:
                    rows[row] = values[signal] - zero_pa
            touch_pa = (
                touch_pa[0] + float(known.mean[State.TOUCH1 + on]),
                touch_pa[1] + float(known.mean[State.TOUCH1 + off]),
            )
        first, stop = round(BEFORE_S / loops.GRID_S), round((BEFORE_S + duration_s) / loops.GRID_S)
        on_pack, off_pack = ((pack.torque_nm_pa, pack.heat_j_k, pack.cooling_w_k) for pack in packs)
        heat, oil = _NO_HEAT, event.columns.get(Signal.SUMP_TEMPERATURE)
        if oil is not None and len(oil.value):
            oil_k = float(oil.value.mean())
            heat = oil_k, oil_k, oil_k, 0.0
            if warm is not None and event.start_ns > warm.at_ns:
                age_s = (event.start_ns - warm.at_ns) / NS_PER_S
                heat = oil_k, warm.clutch_k[on], warm.clutch_k[off], age_s
        stroke_pa = packs[0].stroke_pa
        found = _Found._make(
            loops.quality_told(
                rows, first, stop, skew_s, touch_pa, (on_pack, off_pack), stroke_pa, heat, is_handover=on != off
            )
        )
        errors = {} if known is None else self._control_errors(on, found, touch_pa[0], known)
        return _judged(event, found, errors, packs, is_second=on == 1)

    def _fill_speeds(
        self, event: Event, clutches: tuple[int, int], values: Mapping[Signal, FloatArray], rows: FloatArray
    ) -> float:
        """Fill in the speeds of engine, both shafts and the car; return by how much they may be apart [s]."""
        skew_s, gears = 0.0, self._gears
        for signal in (Signal.ENGINE_SPEED, Signal.HUB_SPEED):
            if signal in values:
                rows[loops.ENGINE] = values[signal]
        for row, clutch, gear in zip((loops.ON, loops.OFF), clutches, (event.to_gear, event.from_gear), strict=True):
            if SHAFTS[clutch] in values:
                rows[row] = values[SHAFTS[clutch]]
            elif gears is not None and gears.over in values:  # asked for after the engine's speed
                t_ns = event.columns[gears.over].t_ns
                skew_s = float(t_ns[-1] - t_ns[0]) / NS_PER_S / (len(t_ns) - 1)
                if 1 <= gear <= len(gears.ratios):
                    rows[row] = gears.ratios[gear - 1] * values[gears.over]
        speed = event.columns.get(Signal.VEHICLE_SPEED)
        if speed is not None and len(speed.value):
            turning = values.get(Signal.OUTPUT_SPEED)  # finer than the car's own
            if turning is not None:
                rows[loops.CAR] = turning * (speed.value.mean() / mean if (mean := turning.mean()) > 1.0 else math.nan)
            elif Signal.VEHICLE_SPEED in values:
                rows[loops.CAR] = values[Signal.VEHICLE_SPEED]
        return skew_s

    def _control_errors(self, on: int, found: _Found, touch_pa: float, known: Knowledge) -> dict[str, float]:
        """Return what the control has wrong of the on-coming clutch, and the standard deviations, by part."""
        errors = {}
        std_pa = math.sqrt(known.covariance[State.TOUCH1 + on, State.TOUCH1 + on])
        if math.isfinite(found.believed_touch_pa):
            errors["touch_error_pa"] = touch_pa - found.believed_touch_pa
            errors["std_touch_error_pa"] = math.hypot(std_pa, found.believed_std_pa)
        if math.isfinite(found.share):
            filled, missing = found.pulse_s / found.fill_time_s, max(1.0 - found.share, 0.0)
            longer_s = missing * found.fill_time_s or -found.early_s
            std_share = math.hypot(std_pa, PRESSURE_PA / math.sqrt(loops.FILLED_ROWS)) / self._packs[on].stroke_pa
            # a later touch point leaves more to fill and makes the flow smaller: both lengthen, out of proportion
            later_s = (missing + std_share) * found.pulse_s / max(filled - std_share, loops.LEAST_FILLED)
            flow_std_s = math.hypot(FLOW_STD_RATIO, FLOW_STD_S / found.pulse_s) * longer_s
            errors["fill_error_s"] = longer_s
            errors["std_fill_error_s"] = math.hypot(later_s - missing * found.fill_time_s, flow_std_s, loops.GRID_S)
        return errors


def _judged(
    event: Event,
    found: _Found,
    errors: Mapping[str, float],
    packs: tuple[_Pack, _Pack],
    *,
    is_second: bool,
) -> ShiftQuality:
    """Return the parts of an event and what they cost."""
    energies_j, peaks_k = (found.energy_on_j, found.energy_off_j), (found.peak_on_k, found.peak_off_k)
    told: dict[str, float] = {
        **found._asdict(),
        **errors,
        "overtime_s": max(found.locked_s - INTENDED_S.get(event.kind, USUAL_S), 0.0 * found.locked_s),
        "temperature_rise_k": max(energies_j[0] / packs[0].heat_j_k, energies_j[1] / packs[1].heat_j_k),
        "slip_energy1_j": energies_j[is_second],
        "slip_energy2_j": energies_j[not is_second],
        "peak1_k": peaks_k[is_second],
        "peak2_k": peaks_k[not is_second],
        "life1_ratio": energies_j[is_second] / packs[is_second].life_j,
        "life2_ratio": energies_j[not is_second] / packs[not is_second].life_j,
    }
    parts = {name: float(told[name]) for name in _PUBLIC if abs(told.get(name, math.nan)) < MOST}
    score, reasons = weighed(parts) if event.kind in GEAR_CHANGES else (None, [])
    return ShiftQuality(score=score, reasons=tuple(reasons), **parts)


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


_INDEX_SPEEDS: Final = (Signal.HUB_SPEED, Signal.ENGINE_SPEED, *SHAFTS, Signal.INPUT_SPEED)
_TORQUES: Final = (Signal.CLUTCH_TORQUE, Signal.ENGINE_TORQUE)
_INDEX_SIGNALS: Final = (*_INDEX_SPEEDS, Signal.CLUTCH_SLIP, *PRESSURES, *_ASKINGS, *_TORQUES)


class _Grid(NamedTuple):
    """The signals of a shift on one even grid from its start to its end."""

    t_s: FloatArray  # (n,) since the start of the shift
    values: dict[Signal, FloatArray]  # (n,) each, linear between samples; without those that are not there
    event: Event
    clutch: int  # that of the gear


@np.errstate(over="ignore", invalid="ignore")  # likewise
def measure(event: Event, calibration: Calibration) -> ShiftIndices:
    """Return the indices of a shift as far as its signals go."""
    is_complete = event.end_reason is EndReason.COMPLETE and event.end_ns > event.start_ns
    shift_time_s = (event.end_ns - event.start_ns) / NS_PER_S
    t_s = np.arange(0.0, max(shift_time_s, INDEX_GRID_S), INDEX_GRID_S)
    values = readings(event.columns, _INDEX_SIGNALS, event.start_ns, t_s)
    grid = _Grid(t_s, values, event, clutch_of_gear(event.to_gear))
    slip_rad_s = _slip(grid) if is_complete else None
    if slip_rad_s is None:
        return ShiftIndices(
            shift_time_s=shift_time_s if is_complete else None,
            slip_duration_s=None,
            peak_slip_rad_s=None,
            slip_angle_rad=None,
            torque_capacity_ratio=None,
            std_torque_capacity_ratio=None,
        )
    size = np.abs(slip_rad_s)
    ratio, std = _torque_capacity(grid, slip_rad_s, calibration) or (None, None)
    return ShiftIndices(
        shift_time_s=shift_time_s,
        slip_duration_s=float(np.count_nonzero(size > SLIP_RAD_S) * INDEX_GRID_S),
        peak_slip_rad_s=float(size.max()),
        slip_angle_rad=float(size.sum() * INDEX_GRID_S),
        torque_capacity_ratio=ratio,
        std_torque_capacity_ratio=std,
        reslip_rad_s=_reslip(size, _pressed(grid, calibration)),
    )


def _reslip(slip_rad_s: FloatArray, is_pressed: BoolArray) -> float:
    """Return the largest slip under load after it had begun and ended once [rad/s]: stick-slip, if there is much.

    Slip has begun when it is as large as three quarters of the largest: as a clutch bites, its shaft swings. It has
    ended when the clutch sticks, not as it passes zero. A clutch that was let go in between begins anew, and so does
    one that is let slip for long.
    """
    pressed_rad_s = np.where(is_pressed, slip_rad_s, 0.0)
    begun_rad_s = max(SLIP_RAD_S, 0.75 * float(pressed_rad_s.max()))
    first, stop = loops.stuck_rows(pressed_rad_s, slip_rad_s, is_pressed, begun_rad_s)
    return loops.largest_swing(slip_rad_s[first:stop], pressed_rad_s[first:stop]) if first < stop else 0.0


def _pressed(grid: _Grid, calibration: Calibration) -> BoolArray:
    """Return where the clutch of the gear carries load, shape (n,); everywhere if nothing tells."""
    pressure_pa = grid.values.get(PRESSURES[grid.clutch - 1])
    if pressure_pa is not None:
        return pressure_pa > calibration.clutches[grid.clutch - 1].touch_pressure_pa + LOADED_PA
    asked_nm = grid.values.get(_ASKINGS[grid.clutch - 1])
    return np.ones(len(grid.t_s), np.bool_) if asked_nm is None else asked_nm > LOADED_NM


def _slip(grid: _Grid) -> FloatArray | None:
    """Return the slip of the on-coming clutch: its input side less the shaft of the gear that engages."""
    hub = grid.values.get(Signal.HUB_SPEED)
    engine = hub if hub is not None else grid.values.get(Signal.ENGINE_SPEED)
    is_first = grid.clutch == 1
    shaft = grid.values.get(Signal.INPUT1_SPEED if is_first else Signal.INPUT2_SPEED)
    shaft = shaft if shaft is not None else grid.values.get(Signal.INPUT_SPEED)
    if engine is None:
        return None
    stated = None if shaft is not None else grid.values.get(Signal.CLUTCH_SLIP)
    return engine * stated if stated is not None else None if shaft is None else engine - shaft


def _torque_capacity(grid: _Grid, slip_rad_s: FloatArray, calibration: Calibration) -> tuple[float, float] | None:
    """Return the torque transmitted at slip over the one asked for, and its standard deviation; docs/model.md eq. (I4).

    Least squares through the origin; the deviation adds the scatter of the residuals, the gain and the offset of the
    engine torque, and the inertia.
    """
    asked = _asked(grid)
    engine_nm = grid.values.get(Signal.ENGINE_TORQUE)
    if asked is None or engine_nm is None or Signal.ENGINE_SPEED not in grid.event.columns:
        return None
    on_nm, off_nm, is_signed = asked
    rows = np.flatnonzero(loops.asked_alone(slip_rad_s, on_nm, off_nm))
    if len(rows) * INDEX_GRID_S < MIN_WINDOW_S:
        return None
    asked_nm = on_nm[rows] if is_signed else on_nm[rows] * np.where(slip_rad_s[rows] > 0.0, 1.0, -1.0)
    speed, accelerations = grid.event.columns[Signal.ENGINE_SPEED], np.zeros(len(rows))
    loops.fit_slopes((speed.t_ns - grid.event.start_ns) / NS_PER_S, speed.value, grid.t_s[rows], accelerations)
    inertia_nm = calibration.input_side.engine_inertia_kg_m2 * accelerations
    by_engine, by_offset, by_inertia, scatter = loops.fit_ratio(asked_nm, engine_nm[rows], inertia_nm)
    spread = calibration.uncertainty
    parts = (
        scatter * math.sqrt(CORRELATION_S / INDEX_GRID_S),
        spread.torque_gain_ratio * by_engine,
        spread.torque_offset_nm * by_offset,
        INERTIA_STD_RATIO * by_inertia,
    )
    ratio, std = by_engine - by_inertia, math.hypot(*parts)
    return (ratio, std) if abs(ratio) + std < MOST else None


def _asked(grid: _Grid) -> tuple[FloatArray, FloatArray, bool] | None:
    """Return the torques asked of the on-coming and of the off-going clutch, and whether their signs are the slip's."""
    on, off = grid.values.get(_ASKINGS[grid.clutch - 1]), grid.values.get(_ASKINGS[2 - grid.clutch])
    if on is not None and off is not None:
        return on, off, False
    total = grid.values.get(Signal.CLUTCH_TORQUE)
    return None if total is None else (total, np.zeros(len(total)), True)
