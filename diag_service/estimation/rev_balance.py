"""The impulse balance of an engine rev in neutral: known inertias, no friction; docs/model.md "Self-calibration".

With both clutches open the torque turns engine and hub; with both closed the input shafts as well, whose inertia is
known from drawings. The difference tells the gain of the torque reading, and with it the scale of friction.
"""

import numpy as np

from clutch_model.calibration import Calibration
from diag_service.estimation.balance import motoring_corrected_nm, sines
from diag_service.estimation.belief import Measurement
from diag_service.estimation.film_track import PressureDrive, follow_film
from diag_service.estimation.parameters import Considered, State
from diag_service.estimation.signals import ShiftSignals
from diag_service.estimation.window import SlipWindow
from diag_service.records import FloatArray

MOMENT_COUNT = 24


def rev_measurement(
    signals: ShiftSignals, window: SlipWindow, at: FloatArray, calibration: Calibration, *, are_clutches_closed: bool
) -> Measurement:
    """Linearise the balance of a rev about the state ``at``, shape (len(State),)."""
    side, bias, sensors = calibration.input_side, calibration.bias, calibration.noise
    weights = sines(signals.grid_s, window, MOMENT_COUNT)
    value, rate = weights.value, weights.rate
    offset_nm = at[State.TORQUE_OFFSET]
    reading_nm = signals.engine_torque.on_grid
    torque_nm, motoring_nm = motoring_corrected_nm(reading_nm, offset_nm, bias)
    hub_rad_s = signals.hub_speed.on_grid
    length_s = value.sum(axis=1)

    hub_weight = side.hub_inertia_kg_m2 * rate - side.hub_damping_nms_rad * value
    known_nms = hub_weight @ hub_rad_s
    shaft_nms = np.zeros(len(known_nms))
    shaft_weights = []
    for m in range(2):
        if are_clutches_closed:
            inertia_weight = side.input_shaft_inertias_kg_m2[m] * rate
            shaft_weight = inertia_weight - side.input_shaft_dampings_nms_rad[m] * value
            shaft_weights.append(shaft_weight)
            speed_rad_s = signals.input_speed[m].on_grid
            known_nms = known_nms + shaft_weight @ speed_rad_s
            shaft_nms = shaft_nms + inertia_weight @ speed_rad_s
        else:
            drive = PressureDrive(
                piston_pa=np.zeros_like(hub_rad_s),
                slip_rad_s=signals.slip_rad_s(m + 1),
                oil_k=signals.oil_k,
                clutch_k=signals.oil_k,
            )
            known_nms = known_nms - value @ follow_film(m + 1, drive, calibration).viscous_nm
    engine_nms = side.engine_inertia_kg_m2 * rate @ signals.engine_speed.on_grid

    by_state = np.zeros((len(length_s), len(State)))
    by_state[:, State.TORQUE_OFFSET] = length_s
    by_considered = np.zeros((len(length_s), len(Considered)))
    by_considered[:, Considered.TORQUE_GAIN] = -(engine_nms + known_nms)
    by_considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * engine_nms
    by_considered[:, Considered.SHAFT_INERTIA] = -bias.torque_gain * shaft_nms
    by_considered[:, Considered.TORQUE_LATENCY] = rate @ reading_nm
    by_considered[:, Considered.MOTORING_GAIN] = value @ motoring_nm
    gain = bias.torque_gain
    torque = sensors.engine_torque_nm * signals.engine_torque.interpolation.to_samples(value)
    motoring = (reading_nm < offset_nm) / bias.motoring_gain
    motoring = sensors.engine_torque_nm * signals.engine_torque.interpolation.to_samples(value * motoring)
    engine = sensors.engine_speed_rad_s * signals.engine_speed.interpolation.to_samples(rate)
    engine = side.engine_inertia_kg_m2 * engine
    hub = sensors.hub_speed_rad_s * signals.hub_speed.interpolation.to_samples(hub_weight)
    shafts = [
        sensors.input_speed_rad_s * speed.interpolation.to_samples(weight)
        for speed, weight in zip(signals.input_speed, shaft_weights, strict=False)
    ]
    turning = np.zeros((len(value), len(value)))
    for one in shafts:
        turning += one @ one.T
    speeds = engine @ engine.T + hub @ hub.T + turning
    noise = torque @ torque.T + gain**2 * speeds

    def overlap_of(shared: FloatArray) -> float:
        return float(np.trace(np.linalg.solve(noise, shared)))

    overlap = np.zeros(len(Considered))
    overlap[Considered.TORQUE_GAIN] = overlap_of(-gain * speeds)
    overlap[Considered.ENGINE_INERTIA] = overlap_of(-(gain**2) * engine @ engine.T)
    overlap[Considered.SHAFT_INERTIA] = overlap_of(-(gain**2) * turning)
    overlap[Considered.MOTORING_GAIN] = overlap_of(motoring @ torque.T)
    return Measurement(
        residual=value @ torque_nm - length_s * offset_nm + gain * (engine_nms + known_nms),
        by_state=by_state,
        by_considered=by_considered,
        noise=noise,
        overlap=overlap,
    )
