"""The paper's method from signals to friction data, of each shift of a bus and of the samples of all together.

The paper's remark on vehicles: the torques that it takes from its simulation follow from engine and wheel speeds and
the equations of the driveline. A twist is the integral of a difference of two noisy speeds, which drifts away; a
smoother (Kalman filter forward, Rauch-Tung-Striebel backward) over the whole shift holds it by two facts: the engine
torque balances, eq. (1a), and a clutch whose pressure is below its touch point passes next to nothing.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.jit import kernel
from clutch_model.calibration import (
    Calibration,
    ClutchCalibration,
    FrictionCurve,
    InputSide,
    Viscosity,
    both_clutches,
    clutch_of_gear,
)
from clutch_model.pack import (
    FilmLaw,
    FrictionLaw,
    applied_pressure_pa,
    contact_pressure_pa,
    contact_torques_nm,
    equilibrium_film_m,
    film_law,
    friction_law,
    shear_factor_difference,
    stribeck_weight,
    viscosity_pa_s,
    viscous_torque_nm,
)
from clutch_results.records import Reason
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals, sample_times_s, usable_signals
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.paper.driveline import (
    Differentiator,
    Driveline,
    DrivelineModel,
    Index,
    Rated,
    Shaft,
    driveline_model,
    quiet_filter,
    steady_kalman,
)

TABLE_END_PA = 16.0e5  # above the line pressure
TABLE_STEP_PA = 500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmTable:
    """The paper's lookup table of film thickness over clutch pressure; linear between the points, constant beyond."""

    pressure_pa: FloatArray  # (k,), rising
    film_m: FloatArray  # (k,)

    def film_at(self, pressure_pa: FloatArray) -> FloatArray:
        """Return the film thickness [m] at each pressure, same shape."""
        return np.interp(pressure_pa, self.pressure_pa, self.film_m)


def static_table(law: FilmLaw) -> FilmTable:
    """Return the table of equilibria: inverse of P_C, the open gap below the touch point."""
    pressure_pa = np.arange(0.0, TABLE_END_PA, TABLE_STEP_PA)
    film_m = np.array(
        [equilibrium_film_m(applied_pressure_pa(float(piston_pa), law), law) for piston_pa in pressure_pa]
    )
    return FilmTable(pressure_pa=pressure_pa, film_m=film_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionData:
    """One point of the mu-v diagram per sample, and what the gates look at; all (n,)."""

    mu: FloatArray  # mu_i; 0 where the asperities carry nothing
    slip_rad_s: FloatArray
    shear_difference: FloatArray  # phi_f - phi_fs: which phase of lubrication
    pressure_rate_pa_s: FloatArray
    static_share: FloatArray  # e of eq. (18)
    is_shifting: BoolArray  # a shift is under way and its clutch has not stuck yet

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.mu)


def pooled(parts: list[FrictionData]) -> FrictionData:
    """Return the samples of several shifts or drives as one."""
    columns = {
        column.name: np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(FrictionData)
    }
    return FrictionData(**columns)


def viscous_torques_nm(
    slip_rad_s: FloatArray, film_m: FloatArray, oil_k: FloatArray, clutch: ClutchCalibration, oil: Viscosity
) -> FloatArray:
    """Return the viscous torque [N m], shape (n,), for the film of the table and the oil's temperature, eq. (17)."""
    viscous_nm = np.empty_like(film_m)
    _fill_viscous(slip_rad_s, film_m, oil_k, (oil.a_pa_s, oil.b_k, oil.pole_k), film_law(clutch), viscous_nm)
    return viscous_nm


def friction_data(
    contact_nm: FloatArray,
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    pressure_rate_pa_s: FloatArray,
    is_shifting: BoolArray,
    clutch: ClutchCalibration,
) -> FrictionData:
    """Return the friction coefficient ``(T_F - T_V)*sgn(s)/(C*P_C(h))`` per sample; ``contact_nm`` is ``T_F - T_V``."""
    law = film_law(clutch)
    contact_pa, shear, share = (np.empty_like(film_m) for _ in range(3))
    _fill_surface(slip_rad_s, film_m, law, friction_law(clutch.friction), contact_pa, shear, share)
    capacity_nm = contact_torques_nm(np.ones_like(contact_pa), 1.0, contact_pa, law.contact_factor_m3)
    mu = np.divide(contact_nm * np.sign(slip_rad_s), capacity_nm, out=np.zeros_like(film_m), where=capacity_nm > 0.0)
    return FrictionData(
        mu=mu,
        slip_rad_s=slip_rad_s,
        shear_difference=shear,
        pressure_rate_pa_s=pressure_rate_pa_s,
        static_share=share,
        is_shifting=is_shifting,
    )


@kernel
def _fill_viscous(
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    oil_k: FloatArray,
    oil: tuple[float, float, float],
    law: FilmLaw,
    viscous_nm: FloatArray,
) -> None:
    for row in range(len(film_m)):
        viscosity = viscosity_pa_s(oil_k[row], oil[0], oil[1], oil[2])
        viscous_nm[row] = viscous_torque_nm(slip_rad_s[row], film_m[row], viscosity, law)


@kernel
def _fill_surface(
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    law: FilmLaw,
    friction: FrictionLaw,
    contact_pa: FloatArray,
    shear: FloatArray,
    share: FloatArray,
) -> None:
    for row in range(len(film_m)):
        contact_pa[row] = contact_pressure_pa(film_m[row], law)
        shear[row] = shear_factor_difference(film_m[row] / law.roughness_m)
        share[row] = stribeck_weight(slip_rad_s[row], friction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """The numbers of the gates; None switches one off."""

    stick_tolerance_rad_s: float = 0.5
    mechanical_shear_max: float = 0.6  # also where partial lubrication begins
    partial_shear_max: float = 0.85
    slip_min_rad_s: float = 1.0
    is_shift_required: bool = True  # the torque is found "during a gear shift", which ends when the clutch sticks
    is_slip_signed: bool = True  # printed without bars: only clutches whose hub is faster
    prior_tolerance_ratio: float | None = None
    pressure_rate_min_pa_s: float | None = None


NOISELESS_GATES = Gates()
NOISY_GATES = Gates(prior_tolerance_ratio=0.20, pressure_rate_min_pa_s=2.0e5)  # the paper's X is lost: chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperEstimate:
    """Friction of one clutch as the paper estimates it; it states no uncertainty. None: no sample passed."""

    mu_c: float | None
    mu_s: float | None
    static_count: int  # samples that speak of mu_S
    coulomb_count: int  # samples that speak of mu_C


def static_gate(data: FrictionData, gates: Gates, lock_band_rad_s: float, prior_mu_s: float) -> BoolArray:
    """Return which samples speak of mu_S: slow slip in mechanical contact, with noise also near the previous mu_S."""
    excess_rad_s = np.abs(data.slip_rad_s) - lock_band_rad_s
    rows = _in_shift(data, gates) & (excess_rad_s > 0.0) & (excess_rad_s <= gates.stick_tolerance_rad_s)
    rows &= data.shear_difference < gates.mechanical_shear_max
    if gates.prior_tolerance_ratio is not None:
        rows &= np.abs(data.mu - prior_mu_s) <= gates.prior_tolerance_ratio * prior_mu_s
    return rows


def coulomb_gate(data: FrictionData, gates: Gates) -> BoolArray:
    """Return which samples speak of mu_C: partial lubrication, slipping, with noise also stroking."""
    slip_rad_s = data.slip_rad_s if gates.is_slip_signed else np.abs(data.slip_rad_s)
    rows = _in_shift(data, gates) & (slip_rad_s > gates.slip_min_rad_s)
    rows &= (data.shear_difference > gates.mechanical_shear_max) & (data.shear_difference < gates.partial_shear_max)
    if gates.pressure_rate_min_pa_s is not None:
        rows &= data.pressure_rate_pa_s > gates.pressure_rate_min_pa_s
    return rows


def fit(data: FrictionData, gates: Gates, curve: FrictionCurve, prior_mu_s: float | None = None) -> PaperEstimate:
    """Return mu_S, the mean of its samples, and mu_C by least squares with that mu_S, eq. (18).

    ``prior_mu_s`` is the previous estimate; the paper does not say what it starts from, here the curve's own. Where no
    sample speaks of mu_S, mu_C is found with the previous one.
    """
    prior = curve.mu_s if prior_mu_s is None else prior_mu_s
    static = static_gate(data, gates, curve.lock_band_rad_s, prior)
    coulomb = coulomb_gate(data, gates)
    mu_s = float(np.mean(data.mu[static])) if static.any() else None
    share = data.static_share[coulomb]
    weight = float(np.sum((1.0 - share) ** 2))
    latest_mu_s = prior if mu_s is None else mu_s
    mu_c = float(np.sum((1.0 - share) * (data.mu[coulomb] - latest_mu_s * share))) / weight if weight > 0.0 else None
    return PaperEstimate(mu_c=mu_c, mu_s=mu_s, static_count=int(static.sum()), coulomb_count=int(coulomb.sum()))


def _in_shift(data: FrictionData, gates: Gates) -> BoolArray:
    return data.is_shifting if gates.is_shift_required else np.ones(len(data), np.bool_)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSignals:
    """Signals of a drive or of a shift at even intervals; both clutches in one array, clutch 1 first."""

    period_s: float
    hub_rad_s: FloatArray  # (n,) w_H
    input_rad_s: FloatArray  # (2, n) w_L
    pressure_pa: FloatArray  # (2, n) P_K
    flywheel_nm: FloatArray  # (n,) T_FW
    shaft_nm: FloatArray  # (2, n) T_si
    oil_k: FloatArray  # (n,) sump
    is_shifting: BoolArray  # (n,) a shift is under way and its clutch has not stuck yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Differentiators:
    """How speeds and pressures are differentiated, and with noise filtered."""

    speed: Differentiator
    pressure: Differentiator


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """The speeds of eqs. (1) to (3) with their accelerations."""

    hub: Rated
    inputs: tuple[Rated, Rated]

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the slip of clutch 1 or 2 [rad/s], shape (n,): hub minus gearbox side."""
        return np.asarray(self.hub.value - self.inputs[clutch - 1].value)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchAnalysis:
    """One clutch on its way through the method; all (n,)."""

    pressure: Rated
    film_m: FloatArray
    friction_nm: FloatArray  # T_F
    viscous_nm: FloatArray  # T_V
    data: FrictionData


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperEstimates:
    """Both clutches, and the speeds they were seen with."""

    speeds: Speeds
    clutches: tuple[ClutchAnalysis, ClutchAnalysis]


def analyse(
    signals: PaperSignals,
    differentiators: Differentiators,
    tables: tuple[FilmTable, FilmTable],
    calibration: Calibration,
    driveline: Driveline,
) -> PaperEstimates:
    """Return the friction data of both clutches: eqs. (10) to (16), then (9), then (17)."""
    hub, first, second = (
        differentiators.speed(speed_rad_s, signals.period_s)
        for speed_rad_s in (signals.hub_rad_s, *signals.input_rad_s)
    )
    speeds = Speeds(hub=hub, inputs=(first, second))
    side = calibration.input_side
    friction_nm = clutch_torques_nm(speeds, signals.flywheel_nm, signals.shaft_nm, side, driveline.shafts)
    clutches = []
    for m, (clutch, table) in enumerate(zip(calibration.clutches, tables, strict=True)):
        pressure = differentiators.pressure(signals.pressure_pa[m], signals.period_s)
        slip_rad_s = speeds.slip_rad_s(m + 1)
        film_m = np.maximum(table.film_at(pressure.value), clutch.film.min_film_m)
        viscous_nm = viscous_torques_nm(slip_rad_s, film_m, signals.oil_k, clutch, calibration.viscosity)
        contact_nm = friction_nm[m] - viscous_nm
        data = friction_data(contact_nm, slip_rad_s, film_m, pressure.rate, signals.is_shifting, clutch)
        clutches.append(
            ClutchAnalysis(
                pressure=pressure, film_m=film_m, friction_nm=friction_nm[m], viscous_nm=viscous_nm, data=data
            )
        )
    return PaperEstimates(speeds=speeds, clutches=both_clutches(clutches))


def clutch_torques_nm(
    speeds: Speeds, flywheel_nm: FloatArray, shaft_nm: FloatArray, side: InputSide, shafts: tuple[Shaft, Shaft]
) -> FloatArray:
    """Return the friction torques T_F of clutch 1 and 2 [N m], shape (2, n).

    Eqs. (1) to (3) are three equations for two unknowns; this is their least squares solution; docs/model.md eq. (9).

    Parameters
    ----------
    flywheel_nm : (n,) array
        Torque T_FW of the flywheel on the hub.
    shaft_nm : (2, n) array
        Torques T_si that the input shafts carry off.
    """
    hub_nm = flywheel_nm - side.hub_damping_nms_rad * speeds.hub.value - side.hub_inertia_kg_m2 * speeds.hub.rate
    first_nm, second_nm = (
        shaft.clutch_inertia_kg_m2 * speed.rate + carried_nm + shaft.clutch_damping_nms_rad * speed.value
        for shaft, speed, carried_nm in zip(shafts, speeds.inputs, shaft_nm, strict=True)
    )
    return np.stack((hub_nm + 2.0 * first_nm - second_nm, hub_nm - first_nm + 2.0 * second_nm)) / 3.0


PERIOD_S = 0.01  # of the fast messages
GRID_STRIDE = round(PERIOD_S / GRID_S)
WHEEL_STD_RAD_S = 0.05  # mean of two wheels, quantisation included
OPEN_STD_NM = 2.0  # drag of an open clutch
SHIFT_PHASES = (1.0, 3.0)  # prefill to inertia: until the clutch has stuck
LOOSE = {
    Index.FLYWHEEL_TWIST: 0.2,
    Index.OUTPUT_TWIST: 0.5,
    Index.WHEEL_ACCELERATION: 20.0,
    Index.SHAFT1_TWIST: 0.1,
    Index.SHAFT2_TWIST: 0.1,
    Index.CLUTCH1_TORQUE: 500.0,
    Index.CLUTCH2_TORQUE: 500.0,
}
LOOSE_SPEED_RAD_S = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SmootherReadings:
    """What the smoother reads at every period."""

    engine_nm: FloatArray  # (n,)
    speeds_rad_s: FloatArray  # (n, 5) engine, hub, inputs, wheel
    speed_std_rad_s: FloatArray  # (5,)
    is_open: BoolArray  # (n, 2) pressure below the touch point


SPEED_STATES = (Index.ENGINE_SPEED, Index.HUB_SPEED, Index.INPUT1_SPEED, Index.INPUT2_SPEED, Index.WHEEL_SPEED)
TORQUE_STATES = (Index.CLUTCH1_TORQUE, Index.CLUTCH2_TORQUE)


def paper_signals(event: Event, calibration: Calibration, driveline: Driveline) -> PaperSignals | Reason:
    """Return a shift's signals with the torques of the vehicle route, or why there are none."""
    gathered = usable_signals(event, calibration)
    if isinstance(gathered, Reason):
        return gathered
    grid_s = gathered.grid_s[::GRID_STRIDE]
    wheel_m_s = _wheel_speed_m_s(event, grid_s)
    if wheel_m_s is None:
        return Reason.SIGNAL_MISSING
    readings = _readings(gathered, wheel_m_s / driveline.wheel_radius_m, calibration)
    gears = (event.from_gear, event.to_gear)
    if clutch_of_gear(event.from_gear) != 1:
        gears = gears[::-1]
    model = driveline_model(gears, PERIOD_S, calibration.input_side, driveline, calibration.noise.engine_torque_nm)
    states = smoothed_states(model, readings)
    return PaperSignals(
        period_s=PERIOD_S,
        hub_rad_s=gathered.hub_speed.on_grid[::GRID_STRIDE],
        input_rad_s=np.stack([speed.on_grid[::GRID_STRIDE] for speed in gathered.input_speed]),
        pressure_pa=np.stack([pressure.on_grid[::GRID_STRIDE] for pressure in gathered.pressure]),
        flywheel_nm=states @ model.flywheel_nm,
        shaft_nm=(states @ model.shaft_nm.T).T,
        oil_k=np.full(len(grid_s), gathered.oil_k),
        is_shifting=_is_shifting(event, grid_s),
    )


def smoothed_states(model: DrivelineModel, readings: SmootherReadings) -> FloatArray:
    """Return the state of the driveline at every period, shape (n, 13)."""
    size, count = len(Index), len(readings.engine_nm)
    mean, covariance = _start(readings)
    means, predicted_means = np.empty((count, size)), np.empty((count, size))
    covariances, predicted = np.empty((count, size, size)), np.empty((count, size, size))
    for k in range(count):
        predicted_means[k], predicted[k] = mean, covariance
        means[k], covariances[k] = _updated(mean, covariance, readings, k)
        mean = model.transition @ means[k] + model.engine * readings.engine_nm[k]
        covariance = model.transition @ covariances[k] @ model.transition.T + model.noise
    for k in range(count - 2, -1, -1):
        gain = np.linalg.solve(predicted[k + 1], model.transition @ covariances[k]).T
        means[k] += gain @ (means[k + 1] - predicted_means[k + 1])
    return means


def _start(readings: SmootherReadings) -> tuple[FloatArray, FloatArray]:
    mean = np.zeros(len(Index))
    mean[list(SPEED_STATES)] = readings.speeds_rad_s[0]
    mean[Index.DIFF_SPEED] = mean[Index.WHEEL_SPEED]
    spread = np.full(len(Index), LOOSE_SPEED_RAD_S)
    for state, std in LOOSE.items():
        spread[state] = std
    return mean, np.diag(spread**2)


def _updated(
    mean: FloatArray, covariance: FloatArray, readings: SmootherReadings, k: int
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance after the readings of one period; they are independent, so one after the other."""
    measured = [
        (state, value, std)
        for state, value, std in zip(SPEED_STATES, readings.speeds_rad_s[k], readings.speed_std_rad_s, strict=True)
    ]
    measured += [
        (state, 0.0, OPEN_STD_NM) for state, is_open in zip(TORQUE_STATES, readings.is_open[k], strict=True) if is_open
    ]
    for state, value, std in measured:
        gain = covariance[:, state] / (covariance[state, state] + std**2)
        mean = mean + gain * (value - mean[state])
        covariance = covariance - np.outer(gain, covariance[state])
    return mean, 0.5 * (covariance + covariance.T)


def _readings(gathered: AlignedSignals, wheel_rad_s: FloatArray, calibration: Calibration) -> SmootherReadings:
    torque_nm = gathered.engine_torque.on_grid[::GRID_STRIDE]
    speeds = (gathered.engine_speed, gathered.hub_speed, *gathered.input_speed)
    noise = calibration.noise
    stds = (noise.engine_speed_rad_s, noise.hub_speed_rad_s, noise.input_speed_rad_s, noise.input_speed_rad_s)
    return SmootherReadings(
        engine_nm=0.5 * (torque_nm + np.append(torque_nm[1:], torque_nm[-1])),  # mean over the period to come
        speeds_rad_s=np.column_stack([*(speed.on_grid[::GRID_STRIDE] for speed in speeds), wheel_rad_s]),
        speed_std_rad_s=np.array([*stds, WHEEL_STD_RAD_S]),
        is_open=np.column_stack(
            [
                pressure.on_grid[::GRID_STRIDE] < clutch.touch_pressure_pa - noise.pressure_pa
                for pressure, clutch in zip(gathered.pressure, calibration.clutches, strict=True)
            ]
        ),
    )


def _wheel_speed_m_s(event: Event, grid_s: FloatArray) -> FloatArray | None:
    """Return the mean speed of the driven (front) wheels on the grid, or None if it is not on the bus."""
    wheels = [event.columns.get(signal) for signal in (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED)]
    driven = [wheel for wheel in wheels if wheel is not None and len(wheel.t_ns)]
    if len(driven) < len(wheels):
        return None
    on_grid = [np.interp(grid_s, sample_times_s(wheel, event.start_ns), wheel.value) for wheel in driven]
    return np.asarray(np.mean(on_grid, axis=0))


def _is_shifting(event: Event, grid_s: FloatArray) -> BoolArray:
    """Return which grid points lie in the shift before its clutch stuck; without phases on the bus, in the shift."""
    in_shift: BoolArray = grid_s >= 0.0
    phase = event.columns.get(Signal.SHIFT_PHASE)
    if phase is None or not len(phase.t_ns):
        return in_shift
    latest = np.searchsorted(sample_times_s(phase, event.start_ns), grid_s, side="right") - 1
    held = phase.value[np.maximum(latest, 0)]
    return np.asarray(in_shift & (held >= SHIFT_PHASES[0]) & (held <= SHIFT_PHASES[1]))


# q of the speed filter: matched with the hub acceleration of emulated shifts at 2 rpm of noise, as the paper does.
SPEED_RATE_VARIANCE = 2.0e6  # (rad/s^3)^2
RATE_GATE_STD = 4.0  # the gate of the pressure rate, in standard deviations of the rate's noise


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperShift:
    """What one shift says by the paper's method about the clutch that engaged."""

    number: int
    from_gear: int
    to_gear: int
    clutch: int
    reason: Reason | None  # why it says nothing; None: it was analysed
    estimate: PaperEstimate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledClutch:
    """What all shifts together say about one clutch; the method states no uncertainty and leads to no verdict."""

    clutch: int
    estimate: PaperEstimate | None  # None before the first usable shift
    shift_count: int


class PaperCollection:
    """Analyses shifts one by one and keeps their samples, some tens per shift."""

    def __init__(self, calibration: Calibration, driveline: Driveline) -> None:
        noise = calibration.noise
        rate_limit_pa_s = NOISY_GATES.pressure_rate_min_pa_s or 0.0
        self._calibration = calibration
        self._driveline = driveline
        self._differentiators = Differentiators(
            speed=steady_kalman(PERIOD_S, SPEED_RATE_VARIANCE, noise.hub_speed_rad_s**2),
            pressure=quiet_filter(PERIOD_S, noise.pressure_pa, rate_limit_pa_s / RATE_GATE_STD),
        )
        self._tables = both_clutches(static_table(film_law(clutch)) for clutch in calibration.clutches)
        self._samples: tuple[list[FrictionData], list[FrictionData]] = ([], [])

    def add(self, event: Event) -> PaperShift:
        """Analyse a shift and add its samples of both clutches to the pool."""
        shift = PaperShift(
            number=event.number,
            from_gear=event.from_gear,
            to_gear=event.to_gear,
            clutch=clutch_of_gear(event.to_gear),
            reason=None,
            estimate=None,
        )
        if clutch_of_gear(event.from_gear) == shift.clutch:
            return replace(shift, reason=Reason.NO_SLIP_WINDOW)
        signals = paper_signals(event, self._calibration, self._driveline)
        if isinstance(signals, Reason):
            return replace(shift, reason=signals)
        analysis = analyse(signals, self._differentiators, self._tables, self._calibration, self._driveline)
        for samples, clutch in zip(self._samples, analysis.clutches, strict=True):
            samples.append(clutch.data)
        return replace(shift, estimate=self._fitted(shift.clutch, analysis.clutches[shift.clutch - 1].data))

    def pooled(self) -> tuple[PooledClutch, PooledClutch]:
        """Return what the shifts so far say together."""
        return both_clutches(
            PooledClutch(
                clutch=clutch,
                estimate=self._fitted(clutch, pooled(samples)) if samples else None,
                shift_count=len(samples),
            )
            for clutch, samples in enumerate(self._samples, start=1)
        )

    def _fitted(self, clutch: int, data: FrictionData) -> PaperEstimate:
        return fit(data, NOISY_GATES, self._calibration.clutches[clutch - 1].friction)
