"""How well a gear change went: the parts of its quality, one score.

Parts, weights and their sources: docs/verdict.md. Signals that are missing leave parts out; the score is that of the
others.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
from clutch_model.calibration import Calibration, ClutchCalibration, both_clutches, clutch_of_gear
from clutch_model.pack import clutch_heating_rate_k_s, clutch_later_k, contact_torque_nm, film_law
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import GEAR_CHANGES, EndReason, EventKind, ShiftQuality
from clutch_results.loads import PARTS
from clutch_results.records import quality_from, quality_keys
from diag_service.diagnosis.alignment import readings
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.condition.index_signals import car_speed
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import Knowledge, State
from diag_service.diagnosis.shifts.shifts import LOADED_PA, PRESSURES, SHAFTS, SLIP_RAD_S

GRID_S = 0.01  # of the rows on which the parts are computed: the period of the fast messages
BEFORE_S, AFTER_S = 0.3, 0.1  # of the signals around the event
SLOPE_ROWS = 8  # of the straight line that differentiates the car's speed: 0.08 s on either side
JERK_ROWS = 10  # 0.1 s, over which a change of acceleration is felt as one
LOCKED_RAD_S = 2.0  # below it slip has ended
LANDING_ROWS = 10  # 0.1 s before, whose slope of slip is that at which the clutch locks
ASKED_NM = 2.0  # above it a clutch is asked to carry
STEADY_NM = 15.0  # over two rows: commanded torque that changes less is steady, though its pressure comes a row later
LEAST_PAIRS = 10  # of commanded torque and pressure, which tell the touch point that a control believes in
LEAST_SPREAD_NM = 10.0  # of commanded torque, one deviation: less tells no straight line
MAP_PA = 0.05e5  # rms: beyond it the command is no straight line of the torque
COMMAND_STEP_PA = 1.0e3  # resolution of a commanded pressure
PULSE_PA = 1.0e5  # above the touch point, with no torque asked for: the clutch is being filled
FILLED_ROWS = 4  # before torque is asked for, whose mean pressure tells how full the cavity is
LEAST_FILLED = 0.1  # of the cavity, by a pulse: beyond it the flow is not known
PRESSURE_PA = 5.0e3  # of a reading, one deviation
FLOW_STD_RATIO = 0.2  # how well the flow of a pulse is known, of readings
FLOW_STD_S = 0.015  # likewise: a valve opens and closes late
WEAR_M3_J: Final = 1.4e-15  # of a wet paper lining, by Archard's law [C]: 1.4 mm3 per MJ
WORN_M: Final = 0.2e-3  # that each lining may lose [C]
USUAL_M_S2: Final = 1.5  # acceleration of the car at which `free` and `felt` hold: a faster one hides more [C]
USUAL_S = 1.2  # from the request to the end of slip [C]
INTENDED_S: Final = {EventKind.COAST_SKIP: 1.8, EventKind.POWER_ON_SKIP: 1.8, EventKind.KICKDOWN: 1.5}  # other kinds
MOST = 1e12  # of any part, whatever its unit: a damaged value of a log may be any number

_COMMANDS: Final = (Signal.CLUTCH1_PRESSURE_COMMAND, Signal.CLUTCH2_PRESSURE_COMMAND)
_ASKINGS: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_SPEEDS: Final = (Signal.ENGINE_SPEED, Signal.HUB_SPEED, Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED, *SHAFTS)
_SIGNALS: Final = tuple(  # by which clutch comes on
    (*_SPEEDS, *PRESSURES, *of_clutch, Signal.ENGINE_TORQUE) for of_clutch in zip(_COMMANDS, _ASKINGS, strict=True)
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

    def heated(self, power_w: FloatArray, start_k: float, oil_k: float) -> tuple[float, float]:
        """Return the slip energy [J] of some rows and the highest temperature [K]; the pack is warm throughout."""
        return float(power_w.sum()) * GRID_S, _peak_k(power_w, start_k, oil_k, self.heat_j_k, self.cooling_w_k)


@kernel
def _peak_k(power_w: FloatArray, start_k: float, oil_k: float, heat_j_k: float, cooling_w_k: float) -> float:
    """Return the highest temperature of a pack [K] that a power heats from row to row."""
    k = peak_k = start_k
    for row in range(power_w.size):
        k += GRID_S * clutch_heating_rate_k_s(power_w[row], k, oil_k, heat_j_k, cooling_w_k)
        peak_k = max(peak_k, k)
    return peak_k


@dataclass(slots=True)
class _Rows:
    """The signals of an event on an even grid around it, shape (n,) each; NaN where nothing tells."""

    engine_rad_s: FloatArray
    on_rad_s: FloatArray  # input shaft of the on-coming clutch
    off_rad_s: FloatArray
    car_m_s: FloatArray
    on_pa: FloatArray  # pressure of the on-coming clutch, its sensor's zero deducted
    off_pa: FloatArray
    command_pa: FloatArray  # of the on-coming clutch
    asked_nm: FloatArray  # likewise
    torque_nm: FloatArray  # of the engine
    first: int = 0  # the event lasts from this row
    stop: int = 0  # to before this one
    skew_s: float = 0.0  # by which the speeds may be apart
    touch_pa: tuple[float, float] = (math.nan, math.nan)  # of the on-coming and the off-going clutch
    start_k: tuple[float, float] = (math.nan, math.nan)  # of their packs
    oil_k: float = math.nan


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
        packs, is_handover = (self._packs[on], self._packs[off]), on != off
        rows = self._rows(event, (on, off), duration_s, known, warm)
        parts = {
            **_speed_parts(rows, is_handover=is_handover),
            **_car_parts(_slopes(rows.car_m_s), rows.first, rows.stop),
            **_load_parts(rows, packs, is_handover=is_handover),
            **_pressure_map(rows.command_pa[: rows.stop], rows.asked_nm[: rows.stop]),
            **_filling(rows, packs[0].stroke_pa),
            **_pressure_response(rows),
        }
        if known is not None:
            parts |= self._errors(on, parts, rows.touch_pa[0], known)
        return _scored(event, parts, packs, is_second=on == 1)

    def _rows(
        self,
        event: Event,
        clutches: tuple[int, int],
        duration_s: float,
        known: Knowledge | None,
        warm: PackTemperatures | None,
    ) -> _Rows:
        """Return the signals of an event and what is known of its clutches; ``clutches`` are those that come and go."""
        on, off = clutches
        grid_s = np.arange(-BEFORE_S, duration_s + AFTER_S, GRID_S)
        rows = _Rows(*np.full((9, len(grid_s)), np.nan))
        rows.first, rows.stop = round(BEFORE_S / GRID_S), round((BEFORE_S + duration_s) / GRID_S)
        signals = _SIGNALS[on] if self._gears is None else (*_SIGNALS[on], self._gears.over)
        values = readings(event.columns, signals, event.start_ns, grid_s)
        self._fill_speeds(event, clutches, values, rows)
        if Signal.OUTPUT_SPEED not in values and (car := car_speed(event.columns, event.start_ns)) is not None:
            rows.car_m_s = car.at(grid_s) if car.is_fine else rows.car_m_s
        first_pa, second_pa = self._packs[on].touch_pa, self._packs[off].touch_pa
        if known is not None:
            for name, signal, zero_pa in (
                ("on_pa", PRESSURES[on], known.mean[State.ZERO1 + on]),
                ("off_pa", PRESSURES[off], known.mean[State.ZERO1 + off]),
                ("command_pa", _COMMANDS[on], 0.0),
                ("asked_nm", _ASKINGS[on], 0.0),
                ("torque_nm", Signal.ENGINE_TORQUE, 0.0),
            ):
                if signal in values:
                    setattr(rows, name, values[signal] - zero_pa)
            first_pa += float(known.mean[State.TOUCH1 + on])
            second_pa += float(known.mean[State.TOUCH1 + off])
        rows.touch_pa = first_pa, second_pa
        oil = event.columns.get(Signal.SUMP_TEMPERATURE)
        if oil is not None and len(oil.value):
            rows.oil_k = oil_k = float(oil.value.mean())
            rows.start_k = oil_k, oil_k
            if warm is not None and event.start_ns > warm.at_ns:
                age_s = (event.start_ns - warm.at_ns) / NS_PER_S
                rows.start_k = both_clutches(
                    clutch_later_k(warm.clutch_k[m], oil_k, 0.0, age_s, pack.heat_j_k, pack.cooling_w_k)
                    for m, pack in zip(clutches, (self._packs[on], self._packs[off]), strict=True)
                )
        return rows

    def _fill_speeds(
        self, event: Event, clutches: tuple[int, int], values: Mapping[Signal, FloatArray], rows: _Rows
    ) -> None:
        """Fill in the speeds of engine, both shafts and the car, and by how much they may be apart in time."""
        gears = self._gears
        for signal in (Signal.ENGINE_SPEED, Signal.HUB_SPEED):
            rows.engine_rad_s = values.get(signal, rows.engine_rad_s)
        for name, clutch, gear in zip(
            ("on_rad_s", "off_rad_s"), clutches, (event.to_gear, event.from_gear), strict=True
        ):
            if SHAFTS[clutch] in values:
                setattr(rows, name, values[SHAFTS[clutch]])
            elif gears is not None and gears.over in values:  # asked for after the engine's speed
                t_ns = event.columns[gears.over].t_ns
                rows.skew_s = float(t_ns[-1] - t_ns[0]) / NS_PER_S / (len(t_ns) - 1)
                if 1 <= gear <= len(gears.ratios):
                    setattr(rows, name, gears.ratios[gear - 1] * values[gears.over])
        speed = event.columns.get(Signal.VEHICLE_SPEED)
        if speed is not None and len(speed.value):
            turning = values.get(Signal.OUTPUT_SPEED)  # finer than the car's own
            if turning is not None:
                rows.car_m_s = turning * (speed.value.mean() / mean if (mean := turning.mean()) > 1.0 else math.nan)

    def _errors(self, on: int, parts: Mapping[str, float], touch_pa: float, known: Knowledge) -> dict[str, float]:
        """Return what the control has wrong of the on-coming clutch, and the standard deviations, by part."""
        errors = {}
        std_pa = math.sqrt(known.covariance[State.TOUCH1 + on, State.TOUCH1 + on])
        if (believed_pa := parts.get("believed_touch_pa")) is not None:
            errors["touch_error_pa"] = touch_pa - believed_pa
            errors["std_touch_error_pa"] = math.hypot(std_pa, parts["believed_std_pa"])
        if (share := parts.get("filled_share")) is not None:
            pulse_s, fill_time_s = parts["pulse_s"], parts["fill_time_s"]
            filled, missing = pulse_s / fill_time_s, max(1.0 - share, 0.0)
            longer_s = missing * fill_time_s or -parts["early_s"]
            std_share = math.hypot(std_pa, PRESSURE_PA / math.sqrt(FILLED_ROWS)) / self._packs[on].stroke_pa
            # a later touch point leaves more to fill and makes the flow smaller: both lengthen, out of proportion
            later_s = (missing + std_share) * pulse_s / max(filled - std_share, LEAST_FILLED)
            flow_std_s = math.hypot(FLOW_STD_RATIO, FLOW_STD_S / pulse_s) * longer_s
            errors["fill_error_s"] = longer_s
            errors["std_fill_error_s"] = math.hypot(later_s - missing * fill_time_s, flow_std_s, GRID_S)
        return errors


def _slopes(car_m_s: FloatArray) -> FloatArray:
    """Return the slope of a straight line around each row [m/s2]; NaN near both ends."""
    slopes, along = np.full(len(car_m_s), np.nan), np.arange(-SLOPE_ROWS, SLOPE_ROWS + 1)
    if len(car_m_s) > 2 * SLOPE_ROWS:
        slopes[SLOPE_ROWS:-SLOPE_ROWS] = np.correlate(car_m_s, along, "valid") / (along @ along * GRID_S)
    return slopes


def _speed_parts(rows: _Rows, *, is_handover: bool) -> dict[str, float]:
    """Return flare [rad/s], when slip ended after the start [s], and how fast it did [rad/s2]."""
    first, stop, parts = rows.first, rows.stop, dict[str, float]()
    engine, on, off = rows.engine_rad_s, rows.on_rad_s, rows.off_rad_s
    if is_handover:
        around, skew = np.arange(first - 1, stop + 1), round(rows.skew_s / GRID_S)
        low, high = np.minimum(on[around], off[around]), np.maximum(on[around], off[around])
        engines = engine[np.clip(around + np.arange(-skew, skew + 1)[:, np.newaxis], 0, len(engine) - 1)]
        beyond = np.maximum(np.maximum(engines - high, low - engines), 0.0) / 3.0
        least = np.fmin.reduce(beyond[:, :-2] + beyond[:, 1:-1] + beyond[:, 2:])
        parts["flare_rad_s"] = float(np.fmax.reduce(least, initial=np.nan))
    if first == stop:
        return parts
    turning = engine - on
    slip = np.nan_to_num(np.abs(turning[first:stop]))
    at = first + int(slip.argmax())
    sign = 1.0 if turning[at] > 0.0 else -1.0
    ended = np.flatnonzero(~(sign * turning[at:stop] >= LOCKED_RAD_S))  # or beyond: rows may be far apart
    if slip[at - first] < SLIP_RAD_S or not len(ended):
        return parts
    row = at + int(ended[0])
    along = np.arange(LANDING_ROWS) - 0.5 * (LANDING_ROWS - 1)
    slope = float(along @ np.abs(turning[row - LANDING_ROWS : row])) / float(along @ along) / GRID_S
    return parts | {"locked_s": (row - first) * GRID_S, "lock_rate_rad_s2": max(-slope, 0.0)}


def _car_parts(slopes: FloatArray, first: int, stop: int) -> dict[str, float]:
    """Return by how much the car's acceleration fell below that before and after, its jerk, and the larger of both."""
    end = min(stop + 1, len(slopes) - SLOPE_ROWS)
    if end <= first:
        return {}
    before = float(slopes[SLOPE_ROWS : first - SLOPE_ROWS // 2].mean())
    after = float(slopes[end - SLOPE_ROWS : end].mean())
    if math.isnan(before + after):
        return {}
    rises = np.abs(slopes[first:end] - slopes[first - JERK_ROWS : end - JERK_ROWS])
    hole = float(np.fmax.reduce(min(before, after) - slopes[first:end]))
    return {
        "torque_hole_m_s2": max(hole, 0.0),
        "jerk_m_s3": float(np.fmax.reduce(rises)) / (JERK_ROWS * GRID_S),
        "acceleration_m_s2": max(abs(before), abs(after)),
    }


def _mean_around(values: FloatArray, first: int, stop: int, reach: int) -> FloatArray:
    """Return the mean of each row and those within ``reach`` of it."""
    shifts = range(-reach, reach + 1)
    return np.asarray(sum([values[first + shift : stop + shift] for shift in shifts]) / len(shifts))


def _load_parts(rows: _Rows, packs: tuple[_Pack, _Pack], *, is_handover: bool) -> dict[str, float]:
    """Return what both clutches carried against each other [N m], the slip energy and the peak of each [J, K]."""
    first, stop = rows.first, rows.stop
    if first == stop or math.isnan(rows.on_pa[first]):
        return {}
    on_pa = _mean_around(rows.on_pa, first, stop, 1) - rows.touch_pa[0]
    off_pa = _mean_around(rows.off_pa, first, stop, 1) - rows.touch_pa[1]
    on_nm, off_nm = np.maximum(on_pa, 0.0) * packs[0].torque_nm_pa, np.maximum(off_pa, 0.0) * packs[1].torque_nm_pa
    engine_rad_s = rows.engine_rad_s[first:stop]
    on_slip = np.abs(engine_rad_s - rows.on_rad_s[first:stop])
    off_slip = np.abs(engine_rad_s - rows.off_rad_s[first:stop])
    on_w = np.where(on_slip > LOCKED_RAD_S, on_nm * on_slip, 0.0)
    energy_j, peak_k = packs[0].heated(on_w, rows.start_k[0], rows.oil_k)
    parts = {"energy_on_j": energy_j, "energy_off_j": 0.0, "peak_on_k": peak_k}
    if not is_handover:
        return parts
    off_w = np.where((off_slip > LOCKED_RAD_S) & (off_pa > LOADED_PA), off_nm * off_slip, 0.0)
    energy_j, peak_k = packs[1].heated(off_w, rows.start_k[1], rows.oil_k)
    spare_nm = on_nm - np.abs(_mean_around(rows.torque_nm, first, stop, 2))
    both_nm = np.minimum(spare_nm, np.where(off_pa > LOADED_PA, off_nm, 0.0))
    tie_up_nm = max(float(np.fmax.reduce(both_nm)), 0.0)
    return parts | {"tie_up_nm": tie_up_nm, "energy_off_j": energy_j, "peak_off_k": peak_k}


def _pressure_map(command_pa: FloatArray, asked_nm: FloatArray) -> dict[str, float]:
    """Return the pressure at which the control believes that the clutch carries nothing [Pa], and its deviation."""
    before, here, after = asked_nm[:-2], asked_nm[1:-1], asked_nm[2:]
    is_steady = np.abs(after - before) < STEADY_NM
    is_usable = is_steady & (np.minimum(np.minimum(before, after), here) > ASKED_NM)
    x, y = here[is_usable], command_pa[1:-1][is_usable]
    across = float(x.var()) if len(x) >= LEAST_PAIRS else 0.0
    if not across > LEAST_SPREAD_NM**2:
        return {}
    slope = float((x - x.mean()) @ y) / len(x) / across
    rms = math.sqrt(max(float(y.var()) - slope * slope * across, 0.0))
    if rms > MAP_PA or math.isnan(rms):
        return {}
    std = rms * math.sqrt((1.0 + float(x.mean()) ** 2 / across) / len(x))
    believed_pa = float(y.mean()) - slope * float(x.mean())
    return {"believed_touch_pa": believed_pa, "believed_std_pa": std + 0.5 * COMMAND_STEP_PA}


def _filling(rows: _Rows, stroke_pa: float) -> dict[str, float]:
    """Return how full the cavity is as torque is asked for, how long all takes, the pulse, what was too long [s]."""
    touch_pa, first, stop = rows.touch_pa[0], rows.first, rows.stop
    command, asked, pressure = (values.tolist() for values in (rows.command_pa, rows.asked_nm, rows.on_pa))
    row, pulse, ended, full = first, 0, first, -1
    while row < stop and not (asked[row] >= ASKED_NM and pulse > 0):
        if asked[row] < ASKED_NM and command[row] > touch_pa + PULSE_PA:
            pulse, ended = pulse + 1, row + 1
        if full < 0 and pressure[row] > touch_pa + LOADED_PA and pressure[row + 1] > touch_pa + LOADED_PA:
            full = row if pulse > 0 else -1
        row += 1
    if row >= stop or pulse == 0 or stroke_pa <= 0.0:  # such a spring does not tell how far its piston has gone
        return {}
    pulse_s, early_s = pulse * GRID_S, max((ended - full) * GRID_S, 0.0)
    if full >= 0:
        return {"filled_share": 1.0, "fill_time_s": pulse_s, "pulse_s": pulse_s, "early_s": early_s}

    at_end, share = (
        1.0 - max(touch_pa - sum(pressure[at - FILLED_ROWS : at]) / FILLED_ROWS, 0.0) / stroke_pa
        for at in (min(ended + 1 + FILLED_ROWS, row), row)  # a valve goes on for a moment
    )
    fill_time_s = pulse_s / max(at_end, LEAST_FILLED)
    return {"filled_share": share, "fill_time_s": fill_time_s, "pulse_s": pulse_s, "early_s": 0.0}


def _pressure_response(rows: _Rows) -> dict[str, float]:
    """Return how the pressure of a closed clutch follows its command: lag [s], ratio, and what the highest lacks [Pa].

    By least squares: the pressure is a part of the command and of its slope.
    """
    command, pressure = rows.command_pa - rows.touch_pa[0], rows.on_pa - rows.touch_pa[0]
    at = np.arange(rows.first + 2, min(rows.stop + 8, len(command) - 2))
    is_closed = (pressure[at - 2] > LOADED_PA) & (pressure[at] > LOADED_PA)
    at = at[is_closed & (np.minimum(command[at - 2], command[at + 2]) > PULSE_PA)]
    if len(at) < LEAST_PAIRS:
        return {}
    by = np.stack([command[at], (command[at + 1] - command[at - 1]) / (2.0 * GRID_S)])
    by -= by.mean(axis=1, keepdims=True)
    (cc, cd), (_, dd) = (by @ by.T).tolist()
    pc, pd = (by @ pressure[at]).tolist()
    whole = cc * dd - cd * cd
    if not whole > 0.0:
        return {}
    reach, by_slope = (pc * dd - pd * cd) / whole, (pd * cc - pc * cd) / whole
    top = int(at[command[at].argmax()])
    stays = min(top + 4, len(pressure) - 3)
    short_pa = float(command[top] - pressure[stays - 2 : stays + 3].mean())
    return {"pressure_lag_s": -by_slope / reach, "pressure_reach_ratio": reach, "pressure_short_pa": short_pa}


def _scored(event: Event, parts: dict[str, float], packs: tuple[_Pack, _Pack], *, is_second: bool) -> ShiftQuality:
    """Return the parts of an event and what they cost."""
    if (locked_s := parts.get("locked_s")) is not None:
        parts["overtime_s"] = max(locked_s - INTENDED_S.get(event.kind, USUAL_S), 0.0)
    if "energy_on_j" in parts:
        energies_j = parts["energy_on_j"], parts["energy_off_j"]
        peaks_k = parts["peak_on_k"], parts.get("peak_off_k", math.nan)
        parts["temperature_rise_k"] = max(energies_j[0] / packs[0].heat_j_k, energies_j[1] / packs[1].heat_j_k)
        for clutch, side in ((1, is_second), (2, not is_second)):
            parts[f"slip_energy{clutch}_j"] = energies_j[side]
            parts[f"peak{clutch}_k"] = peaks_k[side]
            parts[f"life{clutch}_ratio"] = energies_j[side] / packs[side].life_j
    public = {name: float(parts[name]) for name in quality_keys() if abs(parts.get(name, math.nan)) < MOST}
    score, reasons = weighed(public) if event.kind in GEAR_CHANGES else (None, [])
    return quality_from({**public, "score": score, "reasons": reasons})


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
    weight = sum([part.weight for part in PARTS if part.name in costs])
    if not weight:
        return None, []
    dear = sorted([name for name in costs if costs[name] >= 0.01 * weight], key=costs.__getitem__, reverse=True)
    return 100.0 * math.exp(-sum(costs.values()) / weight), dear
