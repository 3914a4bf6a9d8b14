"""The impulse balance of a free engine run-up: known inertias, no friction; docs/model.md "Self-calibration".

With both clutches open the torque turns engine and hub; with both closed the input shafts as well, whose inertia is
known from drawings. The difference tells the gain of the torque reading, and with it the scale of friction.
"""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches
from diag_service.diagnosis.alignment import AlignedSignals
from diag_service.diagnosis.friction.balance import motoring_corrected_nm
from diag_service.diagnosis.friction.evidence import Measurement
from diag_service.diagnosis.friction.film_track import PressureDrive, integrate_films
from diag_service.diagnosis.friction.parameters import PARAMETER_COUNT, STATE_COUNT, Considered, State, open_drag_ratio
from diag_service.diagnosis.friction.window import SlipWindow, Weights, sines

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
    signals: AlignedSignals, window: SlipWindow, at: FloatArray, calibration: Calibration, *, are_clutches_closed: bool
) -> Measurement:
    """Linearise the balance of a run-up about ``at``, shape (PARAMETER_COUNT,); docs/model.md eqs. (32) and (33)."""
    side, bias = calibration.input_side, calibration.bias
    weights = sines(window, (MOMENT_COUNT,))
    offset_nm = at[State.TORQUE_OFFSET]
    reading_nm = signals.engine_torque.on_grid[weights.rows]
    torque_nm, motoring_nm = motoring_corrected_nm(reading_nm, offset_nm, bias)
    length_s = weights.value.sums()
    engine_nms = side.engine_inertia_kg_m2 * (weights.rate @ signals.engine_speed.on_grid[weights.rows])
    loads = (
        _closed_loads(signals, weights, calibration)
        if are_clutches_closed
        else _open_loads(signals, weights, at, calibration)
    )

    by_state = np.zeros((MOMENT_COUNT, len(State)))
    by_state[:, State.TORQUE_OFFSET] = length_s
    by_considered = np.zeros((MOMENT_COUNT, len(Considered)))
    by_considered[:, Considered.TORQUE_GAIN] = -(engine_nms + loads.known_nms)
    by_considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * engine_nms
    by_considered[:, Considered.SHAFT_INERTIA] = -bias.torque_gain * loads.shaft_nms
    by_considered[:, Considered.TORQUE_LATENCY] = weights.rate @ reading_nm
    by_considered[:, Considered.MOTORING_GAIN] = weights.value @ motoring_nm
    by_considered[:, Considered.OPEN_DRAG] = bias.torque_gain * loads.opened_nms
    noise, overlap = _noise_and_overlap(signals, weights, loads, reading_nm < offset_nm, calibration)
    return Measurement(
        residual=weights.value @ torque_nm - length_s * offset_nm + bias.torque_gain * (engine_nms + loads.known_nms),
        slope=np.hstack((by_state, by_considered)),
        noise=noise,
        overlap=overlap,
    )


def _hub(signals: AlignedSignals, weights: Weights, calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return the impulse of the hub and the noise in it."""
    side = calibration.input_side
    weight = weights.rate * side.hub_inertia_kg_m2 + weights.value * -side.hub_damping_nms_rad
    (on_samples,) = weight.on_samples(signals.hub_speed)
    return weight @ signals.hub_speed.on_grid[weights.rows], calibration.noise.hub_speed_rad_s * on_samples


def _open_loads(signals: AlignedSignals, weights: Weights, at: FloatArray, calibration: Calibration) -> _Loads:
    """Return hub and drag of the open clutches."""
    known_nms, hub = _hub(signals, weights, calibration)
    opened_nms = np.zeros_like(known_nms)
    drives = both_clutches(
        PressureDrive(
            piston_pa=np.zeros_like(signals.grid_s),
            slip_rad_s=signals.slip_rad_s(clutch),
            oil_k=signals.oil_k,
            clutch_k=signals.oil_k,
            open_drag_ratio=open_drag_ratio(at),
        )
        for clutch in (1, 2)
    )
    for track in integrate_films(drives, calibration):
        known_nms = known_nms - weights.value @ track.viscous_nm[weights.rows]
        opened_nms += weights.value @ track.open_nm[weights.rows]
    return _Loads(known_nms=known_nms, shaft_nms=np.zeros_like(known_nms), hub=hub, shafts=(), opened_nms=opened_nms)


def _closed_loads(signals: AlignedSignals, weights: Weights, calibration: Calibration) -> _Loads:
    """Return hub and both input shafts, which turn with it."""
    side = calibration.input_side
    known_nms, hub = _hub(signals, weights, calibration)
    shaft_nms = np.zeros_like(known_nms)
    shafts = []
    for m, speed in enumerate(signals.input_speed):
        inertia = weights.rate * side.input_shaft_inertias_kg_m2[m]
        weight = inertia + weights.value * -side.input_shaft_dampings_nms_rad[m]
        speed_rad_s = speed.on_grid[weights.rows]
        known_nms = known_nms + weight @ speed_rad_s
        shaft_nms = shaft_nms + inertia @ speed_rad_s
        (on_samples,) = weight.on_samples(speed)
        shafts.append(calibration.noise.input_speed_rad_s * on_samples)
    return _Loads(known_nms=known_nms, shaft_nms=shaft_nms, hub=hub, shafts=tuple(shafts))


def _noise_and_overlap(
    signals: AlignedSignals, weights: Weights, loads: _Loads, is_motoring: BoolArray, calibration: Calibration
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the residual, shape (k, k), and what the derivatives share with it; eq. (31)."""
    bias, side, sensors = calibration.bias, calibration.input_side, calibration.noise
    motoring_weights = weights.value * (is_motoring / bias.motoring_gain)
    (torque,) = weights.value.on_samples(signals.engine_torque)
    (motoring,) = motoring_weights.on_samples(signals.engine_torque)
    (engine,) = weights.rate.on_samples(signals.engine_speed)
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
