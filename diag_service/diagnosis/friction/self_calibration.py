"""Self-calibration: what a vehicle's sensors and masses really are, found from many of its shifts at once.

Maximum a posteriori over friction and everything that `State` and `Considered` list, by Gauss-Newton on the impulse
balances of all shifts and free engine run-ups; docs/model.md, section "Self-calibration". Shifts alone show latencies,
offsets and inertia over torque gain; the gain itself, the scale of friction, only run-ups with open *and* closed
clutches.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration, JointUncertainty, Viscosity, both_clutches
from clutch_model.errors import CalibrationError
from clutch_model.units import degc_from_k
from clutch_results.records import Reason
from diag_service.diagnosis.alignment import AlignedSignals, usable_signals
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.balance import WORKING_K, Balance, measurements_of, motoring_corrected_nm, noise_of
from diag_service.diagnosis.friction.drives import (
    PackTemperatures,
    SlipWindow,
    Weights,
    measured_drives,
    on_other_grid,
    sines,
    slip_window,
    zeros_measured,
)
from diag_service.diagnosis.friction.estimator import chi_square_gate, event_variance, telling_part
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    NAMES,
    NUISANCE_NAMES,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    JudgedEvent,
    Knowledge,
    Measurement,
    Prior,
    State,
    open_drag_ratio,
    prior_covariance,
    prior_mean,
)
from diag_service.diagnosis.friction.film import PressureDrive, VehicleLaws, integrate_films
from diag_service.diagnosis.friction.posterior import EventScatter, Posterior

MOMENT_COUNT = 24  # the torque of a run-up has steps; more moments see little but their interpolation


@dataclass(frozen=True, slots=True, kw_only=True)
class _Loads:
    """What the engine turns besides itself: weighted torque impulses [N m s], and the weights of the noise in them."""

    known_nms: FloatArray  # (k,) hub, input shafts or drag of the open clutches, with the sign of the balance
    shaft_nms: FloatArray  # (k,) inertia of the input shafts alone
    hub: FloatArray  # (k, n) noise of the hub speed's samples, in standard deviations
    shafts: tuple[FloatArray, ...]  # (k, n) of the input speeds' samples
    opened_nms: FloatArray | float = 0.0  # (k,) drag of the open clutches


def run_up_measurement(
    signals: AlignedSignals, window: SlipWindow, at: FloatArray, laws: VehicleLaws, *, are_clutches_closed: bool
) -> Measurement:
    """Linearise the balance of a run-up about ``at``, shape (PARAMETER_COUNT,); docs/model.md eqs. (32) and (33)."""
    side, bias = laws.input_side, laws.bias
    weights = sines(window, (MOMENT_COUNT,))
    offset_nm = at[State.TORQUE_OFFSET]
    reading_nm = signals.engine_torque.on_grid[weights.rows]
    torque_nm, motoring_nm = motoring_corrected_nm(reading_nm, offset_nm, bias)
    length_s = weights.value.sums()
    engine_nms = side.engine_inertia_kg_m2 * (weights.rate @ signals.engine_speed.on_grid[weights.rows])
    loads = _closed_loads(signals, weights, laws) if are_clutches_closed else _open_loads(signals, weights, at, laws)

    by_state = np.zeros((MOMENT_COUNT, len(State)))
    by_state[:, State.TORQUE_OFFSET] = length_s
    by_considered = np.zeros((MOMENT_COUNT, len(Considered)))
    by_considered[:, Considered.TORQUE_GAIN] = -(engine_nms + loads.known_nms)
    by_considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * engine_nms
    by_considered[:, Considered.SHAFT_INERTIA] = -bias.torque_gain * loads.shaft_nms
    by_considered[:, Considered.TORQUE_LATENCY] = weights.rate @ reading_nm
    by_considered[:, Considered.MOTORING_GAIN] = weights.value @ motoring_nm
    by_considered[:, Considered.OPEN_DRAG] = bias.torque_gain * loads.opened_nms
    noise, overlap = _noise_and_overlap(signals, weights, loads, reading_nm < offset_nm, laws)
    return Measurement(
        residual=weights.value @ torque_nm - length_s * offset_nm + bias.torque_gain * (engine_nms + loads.known_nms),
        jacobian=np.hstack((by_state, by_considered)),
        covariance=noise,
        overlap=overlap,
    )


def _hub(signals: AlignedSignals, weights: Weights, laws: VehicleLaws) -> tuple[FloatArray, FloatArray]:
    """Return the impulse of the hub and the noise in it."""
    side = laws.input_side
    weight = weights.rate * side.hub_inertia_kg_m2 + weights.value * -side.hub_damping_nms_rad
    (on_samples,) = signals.hub_speed.to_samples(weight.blocks, weight.grid_rows)
    return weight @ signals.hub_speed.on_grid[weights.rows], laws.noise.hub_speed_rad_s * on_samples


def _open_loads(signals: AlignedSignals, weights: Weights, at: FloatArray, laws: VehicleLaws) -> _Loads:
    """Return hub and drag of the open clutches."""
    known_nms, hub = _hub(signals, weights, laws)
    opened_nms = np.zeros_like(known_nms)
    drives = both_clutches(
        PressureDrive(
            piston_pa=np.zeros_like(signals.grid_s),
            slip_rad_s=slip_rad_s,
            oil_k=signals.oil_k,
            clutch_k=signals.oil_k,
            open_drag_ratio=open_drag_ratio(at),
        )
        for slip_rad_s in signals.slip_rad_s
    )
    for track in integrate_films(drives, laws.packs):
        known_nms = known_nms - weights.value @ track.viscous_nm[weights.rows]
        opened_nms += weights.value @ track.open_nm[weights.rows]
    return _Loads(known_nms=known_nms, shaft_nms=np.zeros_like(known_nms), hub=hub, shafts=(), opened_nms=opened_nms)


def _closed_loads(signals: AlignedSignals, weights: Weights, laws: VehicleLaws) -> _Loads:
    """Return hub and both input shafts, which turn with it."""
    side = laws.input_side
    known_nms, hub = _hub(signals, weights, laws)
    shaft_nms = np.zeros_like(known_nms)
    shafts = []
    for m, speed in enumerate(signals.input_speed):
        inertia = weights.rate * side.input_shaft_inertias_kg_m2[m]
        weight = inertia + weights.value * -side.input_shaft_dampings_nms_rad[m]
        speed_rad_s = speed.on_grid[weights.rows]
        known_nms = known_nms + weight @ speed_rad_s
        shaft_nms = shaft_nms + inertia @ speed_rad_s
        (on_samples,) = speed.to_samples(weight.blocks, weight.grid_rows)
        shafts.append(laws.noise.input_speed_rad_s * on_samples)
    return _Loads(known_nms=known_nms, shaft_nms=shaft_nms, hub=hub, shafts=tuple(shafts))


def _noise_and_overlap(
    signals: AlignedSignals, weights: Weights, loads: _Loads, is_motoring: BoolArray, laws: VehicleLaws
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the residual, shape (k, k), and what the derivatives share with it; eq. (31)."""
    bias, side, sensors = laws.bias, laws.input_side, laws.noise
    motoring_weights = weights.value * (is_motoring / bias.motoring_gain)
    (torque,) = signals.engine_torque.to_samples(weights.value.blocks, weights.value.grid_rows)
    (motoring,) = signals.engine_torque.to_samples(motoring_weights.blocks, motoring_weights.grid_rows)
    (engine,) = signals.engine_speed.to_samples(weights.rate.blocks, weights.rate.grid_rows)
    torque, motoring = sensors.engine_torque_nm * torque, sensors.engine_torque_nm * motoring
    engine = side.engine_inertia_kg_m2 * sensors.engine_speed_rad_s * engine
    turning = np.zeros((MOMENT_COUNT, MOMENT_COUNT))
    for shaft in loads.shafts:
        turning += shaft @ shaft.T
    speeds = engine @ engine.T + loads.hub @ loads.hub.T + turning
    gain = bias.torque_gain
    noise = torque @ torque.T + gain**2 * speeds
    shared = {
        Considered.TORQUE_GAIN: -gain * speeds,
        Considered.ENGINE_INERTIA: -(gain**2) * engine @ engine.T,
        Considered.SHAFT_INERTIA: -(gain**2) * turning,
        Considered.MOTORING_GAIN: motoring @ torque.T,
    }
    overlap = np.zeros(PARAMETER_COUNT)
    for parameter, covariance in shared.items():
        overlap[STATE_COUNT + parameter] = np.trace(np.linalg.solve(noise, covariance))
    return noise, overlap


COOL_K = 333.15  # of the oil: below it films carry much of the torque, and say less of the vehicle
LEAST_SHIFTS_PER_CLUTCH = 4  # fewer do not tell touch point and friction apart
MAX_EVENT_COUNT = 200  # bounds time and memory; three times what the latencies need
MAX_PASS_COUNT = 18  # of Gauss-Newton: what has not come to rest by then swings
ROUGH_PASS_COUNT = 3  # within them, or while steps are cut short, even a good shift does not fit
LONGEST_STEP = 2.0  # standard deviations of the prior: far off, the balance is not linear
FULL_STEP_COUNT = 5  # half steps after them end a swing between two ways of counting a sample at an edge
CONVERGED = 0.02  # of a standard deviation
NEARLY_CONVERGED = 0.3  # a slip window that begins a sample earlier or later from pass to pass can do that
MAX_MISFIT_SHARE = 1 / 3  # of the shifts
MAX_DEPARTURE = 5.0  # standard deviations of the type
MAX_MEAN_MISFIT = 2.0  # of the shifts used: beyond it this is not the vehicle type that the calibration describes
LOOSE_STD = {Considered.TORQUE_LATENCY: 0.015, Considered.PRESSURE_LATENCY: 0.010, Considered.MOTORING_GAIN: 0.05}
"""What a vehicle that never calibrated itself may differ by from its type, where that is more than the type states."""
LEAST_STD = 1e-6  # of what a type calls certain: a covariance must have an inverse


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfCalibration:
    """What the drives of one vehicle told about it."""

    calibration: Calibration  # moved to the values found, with their joint uncertainty
    state: Posterior  # friction as these drives left it
    mean: FloatArray  # (len(NAMES),) states, and displacements of the considered parameters from the start
    covariance: FloatArray  # (len(NAMES), len(NAMES))
    shift_counts: tuple[int, int]  # used, of clutch 1 and 2
    rejected_count: int  # shifts that could not be used or did not fit
    run_up_counts: tuple[int, int]  # used, with open and with closed clutches
    mean_misfit: float  # chi-square per degree of freedom of the shifts used

    def std(self, name: str) -> float:
        """Return the standard deviation of a parameter by its name in ``NAMES``."""
        row = NAMES.index(name)
        return float(np.sqrt(self.covariance[row, row]))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Linearised:
    """The balance of one event at the present point."""

    balance: Evidence
    zeros: Evidence
    misfit: float  # chi-square of the balance per degree of freedom
    clutch: int  # 0: a run-up
    number: int
    window: SlipWindow
    grid_s: FloatArray
    is_closed_run_up: bool = False
    is_cold: bool = False  # laws of the cold are wrong alike in all events

    @property
    def fits(self) -> bool:
        """Whether the model explains the balance."""
        return self.misfit <= chi_square_gate(self.balance.count)


def self_calibrate(
    shifts: Sequence[Event], run_ups: Sequence[Event], start: Calibration, version: str
) -> SelfCalibration | str:
    """Return what the shifts and run-ups of one vehicle say, or why they do not suffice.

    Parameters
    ----------
    shifts, run-ups
        In order of time; friction is taken to be the same in all of them.
    start : Calibration
        Of the vehicle type.
    version : str
        What the new calibration calls itself.
    """
    if start.joint is not None:
        return f"calibration {start.version} is that of one vehicle already: start from its type"
    shifts, run_ups = shifts[-MAX_EVENT_COUNT:], run_ups[-MAX_EVENT_COUNT:]
    prior = np.concatenate((prior_mean(start), np.zeros(len(Considered))))
    spread = _loosened(prior_covariance(start))
    weight = np.linalg.inv(spread)
    mean, type_laws = prior, VehicleLaws.of(start)
    laws = type_laws
    windows: dict[int, _Linearised] = {}  # chosen anew in every pass while empty
    used: list[_Linearised] = []
    fine_count = 0
    rest = np.inf
    for number in range(MAX_PASS_COUNT):
        linearised = [*_linearised_shifts(shifts, mean, laws, windows), *_linearised_run_ups(run_ups, mean, laws)]
        used = [event for event in linearised if not fine_count or event.fits]
        if problem := _shortage(linearised, used):
            return problem
        total = Evidence.sum([part for event in used for part in (event.balance, event.zeros)])
        gradient = total.vector - total.matrix @ mean  # docs/model.md eqs. (30) and (31)
        covariance = np.asarray(np.linalg.inv(weight + total.matrix), np.float64)
        step: FloatArray = covariance @ (weight @ (prior - mean) + gradient)
        share = _share(step, spread)
        mean = mean + step * (share if fine_count < FULL_STEP_COUNT else 0.5 * share)
        try:
            laws = type_laws.displaced(mean)
        except CalibrationError as exc:
            return f"no vehicle explains these shifts: {exc}"
        rest = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        if fine_count and rest < CONVERGED:
            break
        if fine_count or (share == 1.0 and number + 1 >= ROUGH_PASS_COUNT):
            fine_count += 1
            # From here on the same data pass after pass, or it would not converge.
            windows = windows or {event.number: event for event in used if event.clutch}
    if rest > NEARLY_CONVERGED:
        return (
            f"the self-calibration did not converge: still {rest:.1f} standard deviations a pass{advice_on_oil(shifts)}"
        )
    if problem := _departure(mean - prior, spread):
        return problem
    covariance = Prior.of(spread).stated(covariance, _scatter(Knowledge(mean=mean, covariance=covariance), used).ratio)
    return _concluded(_calibrated(start, laws), mean, covariance, used, len(shifts), version)


def advice_on_oil(shifts: Sequence[Event]) -> str:
    """Return the advice to drive in warmer oil, if most of the shifts were in cold one."""
    readings_k = [
        event.columns[Signal.SUMP_TEMPERATURE].value for event in shifts if Signal.SUMP_TEMPERATURE in event.columns
    ]
    oil_k = [float(oil_k.mean()) for oil_k in readings_k if len(oil_k)]
    middle_k = float(np.median(oil_k)) if oil_k else COOL_K
    if middle_k >= COOL_K:
        return ""
    return f"; half of the shifts were in oil below {degc_from_k(middle_k):.0f} degC: a drive with warm oil mends it"


def _share(step: FloatArray, spread: FloatArray) -> float:
    """Return how much of a step the linearisation bears, 0..1."""
    longest = float(np.max(np.abs(step[FRICTION_COUNT:]) / np.sqrt(np.diag(spread)[FRICTION_COUNT:])))
    return LONGEST_STEP / max(longest, LONGEST_STEP)


def _scatter(known: Knowledge, used: Sequence[_Linearised]) -> EventScatter:
    """Return by how much the friction of the shifts is apart."""
    scatter = EventScatter()
    for linearised in used:
        if linearised.clutch:
            event = JudgedEvent(
                clutch=linearised.clutch, end_ns=0, evidence=linearised.balance, least_scatter=float(linearised.is_cold)
            )
            scatter = scatter.with_event(known, event)
    return scatter


def _departure(moved: FloatArray, spread: FloatArray) -> str:
    """Return which parameter is farther from the vehicle type than can be; empty if none is."""
    departure = np.abs(moved[FRICTION_COUNT:]) / np.sqrt(np.diag(spread)[FRICTION_COUNT:])
    worst = int(np.argmax(departure))
    if departure[worst] <= MAX_DEPARTURE:
        return ""
    return (
        f"{NUISANCE_NAMES[worst]} would be {departure[worst]:.0f} standard deviations from its type: "
        "not a vehicle of this type"
    )


def _loosened(covariance: FloatArray) -> FloatArray:
    """Return the prior with the deviations of a vehicle that never calibrated itself."""
    loose = covariance.copy()
    for parameter, std in LOOSE_STD.items():
        row = STATE_COUNT + parameter
        loose[row, row] = max(loose[row, row], std**2)
    loose += np.diag(np.where(loose.diagonal() > 0.0, 0.0, LEAST_STD**2))
    return loose


def _linearised_shifts(
    events: Sequence[Event], at: FloatArray, laws: VehicleLaws, windows: Mapping[int, _Linearised]
) -> Iterator[_Linearised]:
    """Yield the balances of the shifts, in the windows that are given or else in those that their signals show."""
    packs = None
    for event in events:
        if windows and event.number not in windows:
            continue
        signals = usable_signals(event, laws)
        if isinstance(signals, Reason):
            continue
        drives = measured_drives(signals, at, packs, event.start_ns, laws.packs)
        if (before := windows.get(event.number)) is None:
            window_and_clutch = slip_window(signals, drives, laws.packs)
        else:
            window_and_clutch = on_other_grid(before.window, before.grid_s, signals.grid_s), before.clutch
        if window_and_clutch is None:
            continue
        window, clutch = window_and_clutch
        balance = Balance(signals, window, drives, laws, at)
        packs = PackTemperatures(clutch_k=balance.final_clutch_k, at_ns=event.end_ns)
        if (telling := telling_part(balance, clutch)) is not None:
            noise = noise_of(signals)
            evidence = Evidence.of(measurements_of(telling, noise), at, variance=event_variance(telling, noise))
            yield _Linearised(
                balance=evidence,
                zeros=zeros_measured(signals, laws.noise.pressure_pa),
                misfit=evidence.chi_square(at) / evidence.count,
                clutch=clutch,
                number=event.number,
                window=telling.window,
                grid_s=signals.grid_s,
                is_cold=min(balance.final_clutch_k) < WORKING_K,
            )


def _linearised_run_ups(events: Sequence[Event], at: FloatArray, laws: VehicleLaws) -> Iterator[_Linearised]:
    for event in events:
        signals = usable_signals(event, laws)
        if isinstance(signals, Reason):
            continue
        inside = np.flatnonzero(signals.grid_s >= 0.0)
        window = SlipWindow.between(int(inside[0]), len(signals.grid_s))
        measurement = run_up_measurement(signals, window, at, laws, are_clutches_closed=event.are_clutches_closed)
        balance = Evidence.of([measurement], at)
        yield _Linearised(
            balance=balance,
            zeros=Evidence.none(),
            misfit=balance.chi_square(at) / balance.count,
            clutch=0,
            number=event.number,
            window=window,
            grid_s=signals.grid_s,
            is_closed_run_up=event.are_clutches_closed,
        )


def _shortage(linearised: Sequence[_Linearised], used: Sequence[_Linearised]) -> str:
    """Return what is missing in the shifts that fit; empty if nothing is."""
    for clutch in (1, 2):
        count = sum(event.clutch == clutch for event in used)
        if count < LEAST_SHIFTS_PER_CLUTCH:
            return f"{count} usable shifts onto clutch {clutch}, needed are {LEAST_SHIFTS_PER_CLUTCH}"
    count, used_count = (sum(event.clutch > 0 for event in events) for events in (linearised, used))
    if count - used_count > MAX_MISFIT_SHARE * count:
        return f"{count - used_count} of {count} shifts do not fit: not a vehicle of this type"
    return ""


def _calibrated(start: Calibration, laws: VehicleLaws) -> Calibration:
    """Return a calibration with displaced laws."""
    clutches = both_clutches(
        replace(
            clutch,
            friction=replace(
                clutch.friction,
                stribeck_speed_rad_s=law.friction.stribeck_speed_rad_s,
                stribeck_exponent=law.friction.stribeck_exponent,
            ),
            geometry=replace(clutch.geometry, piston_area_m2=law.film.piston_area_m2),
            film=replace(
                clutch.film, contact_stiffness_pa=law.film.contact_stiffness_pa, mobility_ratio=law.mobility_ratio
            ),
        )
        for clutch, law in zip(start.clutches, laws.packs, strict=True)
    )
    oil = Viscosity(**laws.packs[0].oil._asdict())
    return replace(start, clutches=clutches, viscosity=oil, input_side=laws.input_side, bias=laws.bias)


def _concluded(
    point: Calibration,
    mean: FloatArray,
    covariance: FloatArray,
    used: Sequence[_Linearised],
    shift_count: int,
    version: str,
) -> SelfCalibration | str:
    """Return the result, unless its shifts fit too badly to believe it."""
    misfit = float(np.mean([event.misfit for event in used if event.clutch]))
    if misfit > MAX_MEAN_MISFIT:
        return f"chi-square {misfit:.1f} per degree of freedom: not a vehicle of this type"
    nuisances = covariance[FRICTION_COUNT:, FRICTION_COUNT:]
    std = np.sqrt(np.diag(nuisances))
    correlation = nuisances / np.outer(std, std)
    correlation = np.clip((correlation + correlation.T) / 2.0, -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    calibration = replace(
        point,
        version=version,
        joint=JointUncertainty(
            names=NUISANCE_NAMES, std=tuple(std.tolist()), correlation=tuple(tuple(row) for row in correlation.tolist())
        ),
    )
    at = np.concatenate((mean[:STATE_COUNT], np.zeros(len(Considered))))  # about the new calibration
    rows = [STATE_COUNT + Considered.FRICTION_TEMPERATURE, STATE_COUNT + Considered.OPEN_DRAG]
    at[rows] = mean[rows]  # no calibration file holds these two
    state = Posterior.of(Knowledge(mean=at, covariance=covariance), calibration)
    counts = both_clutches(sum(event.clutch == clutch for event in used) for clutch in (1, 2))
    closed_count = sum(event.is_closed_run_up for event in used)
    return SelfCalibration(
        calibration=calibration,
        state=replace(state, folded_counts=counts),
        mean=mean,
        covariance=covariance,
        shift_counts=counts,
        rejected_count=shift_count - sum(counts),
        run_up_counts=(len(used) - sum(counts) - closed_count, closed_count),
        mean_misfit=misfit,
    )
