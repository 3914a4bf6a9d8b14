"""How the samples of an event err, and with that what its balance says: the one place where bus and table differ.

The signals of a bus are sampled each for itself, and often: every sample has an error of its own. The columns of a
table have few rows; a curve leads through them, and what that leaves open is wrong in one way from row to row.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import TorqueSource
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.balance import Balance, Blocks, Sensitivity
from diag_service.diagnosis.friction.drives import PRESSURE_DEGREE, SLIP_DEGREE, polynomials
from diag_service.diagnosis.friction.evidence import PARAMETER_COUNT, STATE_COUNT, Considered, Measurement
from diag_service.diagnosis.records import LEAST_SLIP_ROWS

MODELLED_DOUBT_NM: Final = np.array([10.0, 5.0, 2.0, 1.0, 0.7])  # of a torque's mean in a piece, its slope, its bends
OPEN_DOUBT_RATIO = 0.5  # of what an open pack drags: how that goes with the slip is another in every pack
DOUBT_TIME_S = 0.1  # for which what is not known is wrong one way
DOUBT_STEP = 2  # points of the grid: no test function turns in less than ten times that
SCALE_RATIO: Final = 0.03  # of gain and inertia where rows are so far apart: what curves leave out, an engine shows
SCALE_ROW_S: Final = 0.06


class NoiseModel(Protocol):
    """How the samples of an event err."""

    scale_ratio: float  # by which gain and inertia seem to differ in one event
    is_alike: bool  # errors that all events have alike, so that they agree better than they are

    least_count: int  # of samples in the slip: fewer say nothing of friction

    def bands(self, balance: Balance) -> tuple[slice, ...]:
        """Return which residuals share errors: they are one measurement."""

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        """Return the covariance of the residual of each measurement."""

    def overlaps(self, sensitivity: Sensitivity, covariances: Sequence[FloatArray]) -> list[FloatArray]:
        """Return what the derivatives of each measurement share with its residual, docs/model.md eq. (31)."""


class BusNoise:
    """Every sample errs by itself; two pieces share half a sample at most."""

    scale_ratio, is_alike, least_count = 0.0, False, 0

    def bands(self, balance: Balance) -> tuple[slice, ...]:
        return balance.weights.value.bands

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        balance, spread = sensitivity.balance, sensitivity.spread
        calibration, weights = balance.calibration, balance.weights
        sensors, gain = calibration.noise, calibration.bias.torque_gain
        engine_std = sensors.engine_speed_rad_s * gain * calibration.input_side.engine_inertia_kg_m2
        noises = [
            sensors.engine_torque_nm**2 * torque @ torque.T + engine_std**2 * engine @ engine.T
            for torque, engine in zip(spread.torque_value, spread.engine_rate, strict=True)
        ]
        _add_clutch_noise(sensitivity, noises)
        add_doubt(sensitivity, noises)
        first, second = sensitivity.answers
        by_hub_nms = first.by_slip_nms + second.by_slip_nms
        hub_speed = balance.signals.hub_speed
        around = hub_speed.around_samples(by_hub_nms, weights.value.places, weights.value.grid_rows)
        for place, hub in enumerate(spread.hub):
            by_hub = gain * hub - spread.hub_value[place] * around[place]
            noises[place] += sensors.hub_speed_rad_s**2 * by_hub @ by_hub.T
        return noises

    def overlaps(self, sensitivity: Sensitivity, covariances: Sequence[FloatArray]) -> list[FloatArray]:
        slopes = sensitivity.engine_slopes
        by_speed = [slope @ rate.T for slope, rate in zip(slopes, sensitivity.spread.engine_rate, strict=True)]
        precisions = [np.asarray(np.linalg.inv(noise)) for noise in covariances]
        return list(_overlaps(sensitivity, precisions, by_speed))


class RowNoise:
    """Signals are columns of a table: what the curves leave open is wrong in one way, also from piece to piece."""

    is_alike, least_count = True, LEAST_SLIP_ROWS

    def __init__(self, signals: AlignedSignals) -> None:
        self._signals = signals
        is_curve = signals.engine_speed.curve is not None
        self.scale_ratio = 0.0 if is_curve else SCALE_RATIO * (signals.row_s / SCALE_ROW_S) ** 2
        self._has_one_speed = signals.hub_speed.value is signals.engine_speed.value  # one noise is in both

    def bands(self, balance: Balance) -> tuple[slice, ...]:
        return (slice(0, balance.weights.value.bands[-1].stop),)

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        balance, signals = sensitivity.balance, self._signals
        sensors, side = balance.calibration.noise, balance.calibration.input_side
        gain = balance.calibration.bias.torque_gain
        value, rate = balance.weights.value.joined(), balance.weights.rate.joined()
        first, second = sensitivity.answers
        hub = rate * (gain * side.hub_inertia_kg_m2) + value * -(
            gain * side.hub_damping_nms_rad + first.by_slip_nms + second.by_slip_nms
        )
        engine = rate * (gain * side.engine_inertia_kg_m2)
        parts = [(signals.engine_torque, value, sensors.engine_torque_nm)]
        if self._has_one_speed:
            parts.append((signals.engine_speed, engine + hub, sensors.engine_speed_rad_s))
        else:
            parts.append((signals.engine_speed, engine, sensors.engine_speed_rad_s))
            parts.append((signals.hub_speed, hub, sensors.hub_speed_rad_s))
        for m, answers in enumerate(sensitivity.answers):
            parts.append((signals.input_speed[m], value * answers.by_slip_nms, sensors.input_speed_rad_s))
            parts.append((signals.pressure[m], value * answers.by_pressure_m3, sensors.pressure_pa))
        bands = balance.weights.value.bands
        joint = np.zeros((bands[-1].stop, bands[-1].stop))
        add_doubt(sensitivity, [joint[band, band] for band in bands])
        for signal, functions, std in parts:
            weights = signal.to_samples(functions.blocks, value.grid_rows)
            joint += std**2 * signal.shared(weights, weights, value.grid_rows)[0]
        return [joint]

    def overlaps(self, sensitivity: Sensitivity, covariances: Sequence[FloatArray]) -> list[FloatArray]:
        balance, rates = sensitivity.balance, sensitivity.spread.engine_rate
        value, (joint,) = balance.weights.value, (np.asarray(np.linalg.inv(noise)) for noise in covariances)
        if self._has_one_speed:
            inertia_kg_m2 = balance.calibration.input_side.engine_inertia_kg_m2
            rates = tuple(rate + hub / inertia_kg_m2 for rate, hub in zip(rates, sensitivity.spread.hub, strict=True))
        slopes = sensitivity.engine_slopes
        by_speed = self._signals.engine_speed.shared(slopes, rates, value.grid_rows, is_followed=True)
        precisions = [joint[band, band] for band in value.bands]
        by_friction = self._friction_shares(sensitivity)
        return [np.sum(list(_overlaps(sensitivity, precisions, by_speed, by_friction)), axis=0)]

    def _friction_shares(self, sensitivity: Sensitivity) -> list[list[FloatArray]]:
        """Return what the derivatives by friction share with the pressures: those of rows are noise in both."""
        value, found = sensitivity.balance.weights.value, list[list[FloatArray]]()
        for m, pressure in enumerate(self._signals.pressure):
            by_pressure_m3, film = sensitivity.answers[m].by_pressure_m3, sensitivity.balance.laws[m].film
            torque = pressure.to_samples((value * by_pressure_m3).blocks, value.grid_rows)
            ratio = film.piston_area_m2 / film.lining_area_m2 * (by_pressure_m3 != 0.0)
            for lever_m3 in ratio * sensitivity.torques.lever_m3[m]:
                slopes = (value * lever_m3).fitted_on_samples(PRESSURE_DEGREE, pressure)
                found.append(pressure.shared(slopes, torque, value.grid_rows, is_followed=True))
        return found


def noise_of(signals: AlignedSignals) -> NoiseModel:
    """Return how the samples of an event err: the one place that asks where they are from."""
    return RowNoise(signals) if signals.row_s else BusNoise()


def measurements_of(balance: Balance, noise: NoiseModel, near: Sequence[Measurement] = ()) -> tuple[Measurement, ...]:
    """Return what a balance says, linearised; with the derivatives found near by if there are some."""
    residual, bands = balance.residual_nms(), noise.bands(balance)
    if [len(one.residual) for one in near] == [band.stop - band.start for band in bands]:
        return tuple(replace(one, residual=residual[band]) for one, band in zip(near, bands, strict=True))
    sensitivity = Sensitivity(balance)
    covariances = noise.covariances(sensitivity)
    jacobian = sensitivity.jacobian(np.sqrt(np.concatenate([np.diag(one) for one in covariances])))
    return tuple(
        Measurement(residual=residual[band], jacobian=jacobian[band], covariance=covariance, overlap=overlap)
        for band, covariance, overlap in zip(bands, covariances, noise.overlaps(sensitivity, covariances), strict=True)
    )


def _overlaps(
    sensitivity: Sensitivity,
    precisions: Sequence[FloatArray],
    by_speed: Sequence[FloatArray],
    by_friction: Sequence[Sequence[FloatArray]] = (),
) -> Iterable[FloatArray]:
    """Yield what the derivatives of each piece by inertia and gains share with its residual."""
    calibration = sensitivity.balance.calibration
    sensors, gain = calibration.noise, calibration.bias.torque_gain
    speed_std = sensors.engine_speed_rad_s * calibration.input_side.engine_inertia_kg_m2
    motoring = _motoring_shares(sensitivity)
    for place, precision in enumerate(precisions):
        overlap = np.zeros(PARAMETER_COUNT)
        considered = overlap[STATE_COUNT:]
        speed = speed_std**2 * float(np.vdot(precision, by_speed[place].T))  # the trace of the product
        considered[Considered.TORQUE_GAIN] = -gain * sensitivity.turned_ratio * speed
        considered[Considered.ENGINE_INERTIA] = -(gain**2) * speed
        if motoring is not None:
            shared = float(np.vdot(precision, motoring[place].T))
            considered[Considered.MOTORING_GAIN] = sensors.engine_torque_nm**2 * shared
        for row, shares in enumerate(by_friction):
            overlap[row] = -(sensors.pressure_pa**2) * float(np.vdot(precision, shares[place].T))
        yield overlap


def _motoring_shares(sensitivity: Sensitivity) -> list[FloatArray] | None:
    """Return what the derivative by the gain of negative torque shares with the torque; None without such."""
    balance = sensitivity.balance
    if not sensitivity.is_motoring.any():
        return None
    value = balance.weights.value * (sensitivity.is_motoring / balance.calibration.bias.motoring_gain)
    torque = balance.signals.engine_torque
    slopes = value.fitted_on_samples(SLIP_DEGREE, torque)
    return torque.shared(slopes, sensitivity.spread.torque_value, value.grid_rows)


def _add_clutch_noise(sensitivity: Sensitivity, noises: list[FloatArray]) -> None:
    """Add the noise of input speeds and pressures, that of samples with the same weights as one."""
    balance, spread = sensitivity.balance, sensitivity.spread
    signals, sensors = balance.signals, balance.calibration.noise
    value, of_blocks = balance.weights.value, dict[int, tuple[Blocks, list[Blocks]]]()
    for m, answers in enumerate(sensitivity.answers):
        for std, by, signal, blocks in (
            (sensors.input_speed_rad_s, answers.by_slip_nms, signals.input_speed[m], spread.input_value[m]),
            (sensors.pressure_pa, answers.by_pressure_m3, signals.pressure[m], spread.pressure_value[m]),
        ):
            if by.any():
                squares = tuple(
                    (std * means) ** 2 for means in signal.around_samples(by, value.places, value.grid_rows)
                )
                of_blocks.setdefault(id(blocks), (blocks, []))[1].append(squares)
    for blocks, variances in of_blocks.values():
        for place, weight in enumerate(blocks):
            scaled = weight * np.sqrt(sum(squares[place] for squares in variances))
            noises[place] += scaled @ scaled.T


def add_doubt(sensitivity: Sensitivity, noises: list[FloatArray]) -> None:
    """Add what no law of friction, film and drag holds, wrong one way for a while, and what a modelled torque hides."""
    balance = sensitivity.balance
    value, gain = balance.weights.value, balance.calibration.bias.torque_gain
    doubt_nm = np.hypot(*(answers.doubt_nm for answers in sensitivity.answers))
    doubt_nm *= gain * math.sqrt(DOUBT_TIME_S * DOUBT_STEP / GRID_S)
    opened_nms = OPEN_DOUBT_RATIO * gain * np.stack([own.opened for own in sensitivity.nominal], axis=1)
    for place, (rows_of_piece, band, block) in enumerate(zip(value.places, value.bands, value.blocks, strict=True)):
        doubt = block[:, ::DOUBT_STEP] * doubt_nm[rows_of_piece][::DOUBT_STEP]
        noises[place] += doubt @ doubt.T + opened_nms[band] @ opened_nms[band].T
    if balance.calibration.torque is TorqueSource.MEASURED:
        return
    for place, block in enumerate(value.blocks):  # a smooth course of its own in every piece
        rows = block.shape[1]
        course = (block @ polynomials(rows, len(MODELLED_DOUBT_NM) - 1)) * (math.sqrt(rows) * MODELLED_DOUBT_NM)
        noises[place] += course @ course.T
