"""The torque balance of an event, its derivatives by all parameters and the covariance of its noise.

Over each piece ``a..b`` of a slip window, with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed. Every term is linear in the samples, so the covariance of its noise is exact; the
contact torques T_C,m are linear in the friction coefficients. Sensitivities come from *planned* drives without sensor
noise, which would pull friction down by several percent; the residual comes from the measured ones (`Balance`).

Samples err in one of two ways, which is the one place where bus and table differ. The signals of a bus are sampled each
for itself, and often: every sample has an error of its own. The columns of a table have few rows; a curve leads through
them, and what that leaves open is wrong in one way from row to row.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, Protocol, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import SensorBias, TorqueSource
from clutch_model.pack import contact_levers_m3, slower_film
from clutch_results.records import LEAST_SLIP_ROWS
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.drives import (
    PRESSURE_DEGREE,
    SLIP_DEGREE,
    Blocks,
    RowRange,
    SlipWindow,
    Spread,
    Weights,
    planned_drives,
    polynomials,
    sines,
    spans_of,
)
from diag_service.diagnosis.friction.evidence import (
    FRICTION_ROWS,
    PARAMETER_COUNT,
    REFERENCE_K,
    STATE_COUNT,
    Considered,
    Measurement,
    State,
)
from diag_service.diagnosis.friction.film import (
    COARSE,
    SIGN_WIDTH_RAD_S,
    FilmCause,
    FilmTrack,
    PackLaw,
    PackLaws,
    PressureDrive,
    VehicleLaws,
    directions,
    film_tangents,
    heat_w,
    integrate_films,
)

MAX_MOMENT_COUNT = 24  # beyond it the quadrature, not the noise, limits
SAMPLES_PER_MOMENT = 2  # of the engine torque: a sine that turns faster than every second sample shows is told by none
WORKING_K: Final = 353.15  # of a pack, 80 degC: colder, films follow laws that differ from car to car


class ClutchMoments(NamedTuple):
    """Weighted torques of one clutch: ``viscous + by_friction @ (mu_c, mu_s)``."""

    viscous: FloatArray  # (k,)
    opened: FloatArray  # (k,) the part of it that an open pack drags
    by_friction: FloatArray  # (k, 2)
    by_warm_friction: FloatArray  # (k, 2) the same times the pack's warmth, see `Torques.of`


class Torques(NamedTuple):
    """What both clutches carry on the rows of a window, eqs. (5), (6) and (8); (2 clutches, 2: by mu_c, mu_s, ...)."""

    lever_m3: FloatArray  # (2, 2, n) contact torque over its pressure
    contact_nm: FloatArray  # (2, 2, n)
    parts_nm: FloatArray  # (2, 6, n): contact, the same times its warmth over the reference, sheared film, open drag

    @classmethod
    def of(
        cls,
        drives: tuple[PressureDrive, PressureDrive],
        tracks: tuple[FilmTrack, FilmTrack],
        warmed: tuple[FilmTrack, FilmTrack],
        laws: PackLaws,
        rows: slice,
    ) -> Self:
        """Return the torques that films and slips of both clutches make on some rows of the grid.

        How warm the packs are is taken from tracks of their own: a command shows how a clutch is filled less well than
        how it heats up.
        """
        count = rows.stop - rows.start
        lever_m3, parts_nm = np.empty((2, 2, count)), np.empty((2, 6, count))
        for m, (drive, track, law) in enumerate(zip(drives, tracks, laws, strict=True)):
            slip_rad_s = drive.slip_rad_s[rows]
            direction = np.clip(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)
            lever_m3[m] = contact_levers_m3(slip_rad_s, direction, law.friction, law.film.contact_factor_m3)
            parts_nm[m, :2] = lever_m3[m] * track.contact_pa[rows]
            parts_nm[m, 2:4] = parts_nm[m, :2] * (warmed[m].clutch_k[rows] - REFERENCE_K)
            parts_nm[m, 4], parts_nm[m, 5] = track.viscous_nm[rows], track.open_nm[rows]
        return cls(lever_m3=lever_m3, contact_nm=parts_nm[:, :2], parts_nm=parts_nm)


class Balance:
    """The weighted balance of one event at some parameters.

    Parameters
    ----------
    signals, window
        The event and its slip window.
    measured
        What drives the film of clutch 1 and 2, pressures corrected by the offsets of these parameters.
    laws
        Of the vehicle at these parameters.
    at : (PARAMETER_COUNT,) array
        The parameters.
    tracks
        The films that these drives and laws make, where they are known.

    Attributes
    ----------
    mu : (2, 2) array
        ``(mu_c, mu_s)`` of clutch 1 and 2 among the parameters.
    final_clutch_k
        Temperature of each pack at the end of the cut [K].
    film_steps
        By which logarithm the film of each pack may yield more slowly, for it is cold in the slip.
    known_nms : (k,) array
        Impulses of the hub and of the films' shear [N m s], with the sign of the balance.
    """

    def __init__(
        self,
        signals: AlignedSignals,
        window: SlipWindow,
        measured: tuple[PressureDrive, PressureDrive],
        laws: VehicleLaws,
        at: FloatArray,
        tracks: tuple[FilmTrack, FilmTrack] | None = None,
    ) -> None:
        self.signals = signals
        self.measured = measured
        self.laws = laws
        self.window = window
        self.at = at
        self.mu = at[: State.MU_S2 + 1].reshape(2, 2)
        torque_s = signals.engine_torque.times_s
        edges = np.searchsorted(torque_s, spans_of(window.pieces, signals.grid_s))
        sample_counts = (edges[:, 1] - edges[:, 0]).tolist()
        self.sample_count = sum(
            [count for count, piece in zip(sample_counts, window.pieces, strict=True) if not piece.is_rest]
        )
        counts = [max(3, min(MAX_MOMENT_COUNT, count // SAMPLES_PER_MOMENT)) for count in sample_counts]
        self.weights = sines(window, counts)
        self.tracks = integrate_films(measured, laws.packs) if tracks is None else tracks
        self.film_steps = [FILM_MOBILITY_LOG * cold for cold in coldness(self.tracks, window.slip_rows)]
        self.final_clutch_k = self.tracks[0].final_clutch_k, self.tracks[1].final_clutch_k
        self.torques = Torques.of(measured, self.tracks, self.tracks, laws.packs, self.weights.rows)
        self._moments = weigh(self.weights, self.torques)
        side, hub_rad_s = laws.input_side, signals.hub_speed.on_grid[self.weights.rows]
        self.known_nms = np.asarray(
            side.hub_inertia_kg_m2 * (self.weights.rate @ hub_rad_s)
            - side.hub_damping_nms_rad * (self.weights.value @ hub_rad_s)
            - sum([moments.viscous for moments in self._moments])
        )

    def within(self, pieces: tuple[RowRange, ...]) -> "Balance":
        """Return the balance on some pieces of its window: its films stay."""
        return Balance(self.signals, SlipWindow.of(pieces), self.measured, self.laws, self.at, self.tracks)

    def residual_nms(self) -> FloatArray:
        """Return by how much the impulses do not balance [N m s], shape (k,)."""
        side, bias, weights = self.laws.input_side, self.laws.bias, self.weights
        offset_nm = self.at[State.TORQUE_OFFSET]
        torque_nm, _ = motoring_corrected_nm(self.signals.engine_torque.on_grid[weights.rows], offset_nm, bias)
        by_kelvin = self.at[STATE_COUNT + Considered.FRICTION_TEMPERATURE]
        contact_nms = sum(
            [
                (moments.by_friction + by_kelvin * moments.by_warm_friction) @ mu
                for moments, mu in zip(self._moments, self.mu, strict=True)
            ]
        )
        engine_nms = side.engine_inertia_kg_m2 * (weights.rate @ self.signals.engine_speed.on_grid[weights.rows])
        driving_nms = weights.value @ (torque_nm - offset_nm)
        return np.asarray(driving_nms + bias.torque_gain * (engine_nms + self.known_nms) - contact_nms)

    def slip_energy_j(self, clutch: int, mu: FloatArray) -> float:
        """Return the heat made in a clutch over the whole cut [J], for its ``(mu_c, mu_s)``."""
        return GRID_S * heat_w(self.measured[clutch - 1], self.tracks[clutch - 1], mu, self.laws.packs[clutch - 1])


def weigh(weights: Weights, torques: Torques) -> tuple[ClutchMoments, ClutchMoments]:
    """Return the weighted torques of both clutches, on the rows of the weights."""
    sums = weights.value @ torques.parts_nm.reshape(12, -1).T
    first, second = [
        ClutchMoments(
            viscous=sums_nms[:, 4],
            opened=sums_nms[:, 5],
            by_friction=sums_nms[:, :2],
            by_warm_friction=sums_nms[:, 2:4],
        )
        for sums_nms in (sums[:, :6], sums[:, 6:])
    ]
    return first, second


def motoring_corrected_nm(reading_nm: FloatArray, offset_nm: float, bias: SensorBias) -> tuple[FloatArray, FloatArray]:
    """Return torque readings with the gain of negative torque taken out, and their negative part; both (n,)."""
    negative_nm = np.minimum(reading_nm - offset_nm, 0.0)
    corrected_nm = negative_nm / bias.motoring_gain
    return reading_nm - negative_nm + corrected_nm, corrected_nm


COLD_SPAN_K: Final = 60.0  # so far below `WORKING_K` the doubts of a cold film hold in full
FILM_MOBILITY_LOG: Final = 1.0  # natural logarithm: there a film may yield more slowly by this; more than one deviation
LEAST_SECANT: Final = 0.2  # natural logarithm: for a smaller step the tangent of a film is near enough
COLD_DOUBT_RATIO: Final = 0.25  # standard deviation over the torque that the slower film changes while it closes
MIN_EXCESS = 0.05  # of slip over Stribeck speed: keeps powers with an exponent below 1 finite at zero slip
DOUBT_RATIO = 0.01  # standard deviation over a clutch's torque: laws of friction and film hold no better at each moment
IDLE_RATIO = 0.1  # of the noise: a clutch whose impulses are smaller has no derivatives by film and Stribeck curve

COMMON_CAUSES = {  # what both clutches share
    Considered.VISCOSITY: FilmCause.VISCOSITY,
    Considered.PRESSURE_LATENCY: FilmCause.PRESSURE_LATENCY,
    Considered.CONTACT_STIFFNESS: FilmCause.CONTACT_STIFFNESS,
    Considered.FILM_MOBILITY: FilmCause.FILM_MOBILITY,
}


class ContactAnswers(NamedTuple):
    """How the contact torque of a clutch answers to what it depends on, each (n,) on the rows of a window."""

    by_slip_nms: FloatArray  # of its friction, eq. (8)
    by_pressure_m3: FloatArray
    by_stribeck_speed_nm: FloatArray  # natural logarithm of it
    by_stribeck_exponent_nm: FloatArray  # likewise
    doubt_nm: FloatArray  # standard deviation of what no law of friction and film holds


def contact_answers(
    slip_rad_s: FloatArray,
    contact_nm: FloatArray,
    contact_pa: FloatArray,
    film_doubt_nm: FloatArray,
    mu: FloatArray,
    law: PackLaw,
) -> ContactAnswers:
    """Return how the contact of a clutch answers; ``contact_nm`` is (2, n), by mu_c and by mu_s, all others (n,)."""
    curve, area_ratio = law.friction, law.film.piston_area_m2 / law.film.lining_area_m2
    excess = np.maximum(np.abs(slip_rad_s) / curve.stribeck_speed_rad_s, MIN_EXCESS)
    by_speed_nm = contact_nm[1] * (mu[1] - mu[0]) * curve.stribeck_exponent * excess**curve.stribeck_exponent
    return ContactAnswers(
        by_slip_nms=-by_speed_nm / (excess * curve.stribeck_speed_rad_s) * directions(slip_rad_s),
        by_pressure_m3=area_ratio * mu[0] * contact_nm.sum(axis=0) / np.maximum(contact_pa, 1.0),
        by_stribeck_speed_nm=by_speed_nm,
        by_stribeck_exponent_nm=-by_speed_nm * np.log(excess),
        doubt_nm=np.hypot(film_doubt_nm, DOUBT_RATIO * (mu @ contact_nm)),
    )


def coldness(tracks: tuple[FilmTrack, FilmTrack], rows: slice) -> tuple[float, ...]:
    """Return how cold each pack is on some rows: 0 at work, 1 where its oil is 60 K colder."""
    means_k = [float(track.clutch_k[rows].sum() / (rows.stop - rows.start)) for track in tracks]
    return tuple([max(0.0, (WORKING_K - mean_k) / COLD_SPAN_K) for mean_k in means_k])


def slower_films(balance: Balance, drives: tuple[PressureDrive, PressureDrive]) -> tuple[FilmTrack, FilmTrack]:
    """Return the films as they are where they yield as slowly as they may in the cold."""
    first, second = (
        law._replace(film=slower_film(law.film, math.exp(step)))
        for law, step in zip(balance.laws.packs, balance.film_steps, strict=True)
    )
    return integrate_films(drives, (first, second), balance.window.rows.stop, COARSE)


class Sensitivity:
    """How a balance answers to all that it depends on.

    Attributes
    ----------
    spread, engine_slopes
        The weights of samples in the balance, and of the engine speed's in the derivative by inertia.
    torques, nominal
        What both clutches carry on planned drives, and the weighted sums of it.
    answers
        How the contact of clutch 1 and 2 answers.
    turned_ratio
        Inertia of all that the engine's torque turns over that of the engine.
    """

    def __init__(self, balance: Balance) -> None:
        self.balance, laws, rows = balance, balance.laws.packs, balance.weights.rows
        # The gain of the torque moves the balance as inertia does: all else that would tell both apart, the drag of
        # open packs and the noise of the hub's speed, is known too badly to be a scale.
        side = balance.laws.input_side
        self.turned_ratio = 1.0 + side.hub_inertia_kg_m2 / side.engine_inertia_kg_m2
        self._planned = planned_drives(balance.signals, balance.measured, balance.window)
        self.spread = Spread.of(balance.signals, balance.weights, side)
        self._torque_nm = balance.weights.fitted(balance.signals.engine_torque.on_grid[rows], SLIP_DEGREE)
        self.is_motoring = self._torque_nm < balance.at[State.TORQUE_OFFSET]
        self.engine_slopes = balance.weights.rate.fitted_on_samples(SLIP_DEGREE, balance.signals.engine_speed)
        tracks = integrate_films(self._planned, laws, balance.window.rows.stop, COARSE)
        self.torques = Torques.of(self._planned, tracks, balance.tracks, laws, rows)
        is_cold = max(balance.film_steps) >= LEAST_SECANT
        self._lost_nm = self._by_slower_films(tracks) if is_cold else [None, None]
        self.answers = []
        for m, law in enumerate(laws):
            doubt_nm = balance.tracks[m].doubt_nm[rows]
            if (lost_nm := self._lost_nm[m]) is not None:
                doubt_nm = np.hypot(doubt_nm, COLD_DOUBT_RATIO * balance.film_steps[m] * lost_nm)
            contact_nm, contact_pa = self.torques.contact_nm[m], tracks[m].contact_pa[rows]
            slip_rad_s = self._planned[m].slip_rad_s[rows]
            self.answers.append(contact_answers(slip_rad_s, contact_nm, contact_pa, doubt_nm, balance.mu[m], law))
        self.nominal = weigh(balance.weights, self.torques)

    def _by_slower_films(self, tracks: tuple[FilmTrack, FilmTrack]) -> list[FloatArray | None]:
        """Return by how much each clutch carries less [N m] where films yield as slowly as cold ones may.

        Per unit of the logarithm of the mobility; (n,) of each clutch, None where its oil is warm. A film that closes
        before the window, as believed, has no tangent there, and one that closes three times as slowly has not closed.
        """
        balance, rows, losses_nm = self.balance, self.balance.weights.rows, list[FloatArray | None]()
        for m, (was, now) in enumerate(zip(tracks, slower_films(balance, self._planned), strict=True)):
            step, lost_pa = balance.film_steps[m], was.contact_pa[rows] - now.contact_pa[rows]
            lost_nm = balance.mu[m] @ self.torques.lever_m3[m] * lost_pa + was.viscous_nm[rows] - now.viscous_nm[rows]
            losses_nm.append(lost_nm / step if step >= LEAST_SECANT else None)
        return losses_nm

    def jacobian(self, std_nms: FloatArray) -> FloatArray:
        """Return the derivatives of the modelled impulses by all parameters, shape (k, PARAMETER_COUNT).

        A residual is ``jacobian @ displacement + noise``; ``std_nms`` of shape (k,) is the deviation of that noise.
        """
        balance, at = self.balance, self.balance.at
        weights, bias = balance.weights, balance.laws.bias
        torque_nm, motoring_nm = motoring_corrected_nm(self._torque_nm, at[State.TORQUE_OFFSET], bias)
        speed_rad_s = weights.fitted(balance.signals.engine_speed.on_grid[weights.rows], SLIP_DEGREE)
        engine_nms = balance.laws.input_side.engine_inertia_kg_m2 * (weights.rate @ speed_rad_s)
        slope = np.zeros((weights.value.bands[-1].stop, PARAMETER_COUNT))
        considered = slope[:, STATE_COUNT:]
        slope[:, State.TORQUE_OFFSET] = weights.value.sums()
        considered[:, Considered.TORQUE_GAIN] = -self.turned_ratio * engine_nms
        considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * engine_nms
        considered[:, Considered.MOTORING_GAIN] = weights.value @ motoring_nm
        considered[:, Considered.TORQUE_LATENCY] = weights.rate @ torque_nm  # smooth: noise would hold it where it is
        for m, mu in enumerate(balance.mu):
            plain = self.nominal[m]
            slope[:, FRICTION_ROWS[m]] = plain.by_friction
            considered[:, Considered.FRICTION_TEMPERATURE] += plain.by_warm_friction @ mu
            considered[:, Considered.OPEN_DRAG] += bias.torque_gain * plain.opened
            if (np.abs(plain.viscous + plain.by_friction @ mu) / std_nms).max() > IDLE_RATIO:
                self._add_film(slope, m, mu)
                answers = self.answers[m]
                considered[:, Considered.STRIBECK_SPEED] += weights.value @ answers.by_stribeck_speed_nm
                considered[:, Considered.STRIBECK_EXPONENT] += weights.value @ answers.by_stribeck_exponent_nm
        return slope

    def _add_film(self, slope: FloatArray, m: int, mu: FloatArray) -> None:
        """Add what the film of clutch ``m + 1`` answers to everything that moves or forms it."""
        balance, drive = self.balance, self._planned[m]
        rows, considered = balance.weights.rows, slope[:, STATE_COUNT:]
        clutch_k, lever_m3 = balance.tracks[m].clutch_k, mu @ self.torques.lever_m3[m]
        answers = balance.weights.value @ film_tangents(balance.laws.packs[m], drive, clutch_k, rows, lever_m3)
        slope[:, State.TOUCH1 + m] = -answers[:, FilmCause.PRESSURE]
        slope[:, State.ZERO1 + m] = -answers[:, FilmCause.PRESSURE]
        considered[:, Considered.PISTON_AREA1 + m] = answers[:, FilmCause.PISTON_AREA]
        for parameter, cause in COMMON_CAUSES.items():
            considered[:, parameter] += answers[:, cause]
        if (lost_nm := self._lost_nm[m]) is not None:
            secant = balance.weights.value @ lost_nm
            considered[:, Considered.FILM_MOBILITY] += secant - answers[:, FilmCause.FILM_MOBILITY]


MODELLED_DOUBT_NM: Final = np.array([10.0, 5.0, 2.0, 1.0, 0.7])  # of a modelled torque in a piece, by polynomial degree
OPEN_DOUBT_RATIO = 0.5  # standard deviation over the drag of an open pack, whose law of slip differs from pack to pack
DOUBT_TIME_S = 0.1  # correlation time of what the laws leave out
DOUBT_STEP = 2  # points of the grid from one step of that noise to the next: test functions turn ten times as slowly
SCALE_RATIO: Final = 0.03  # deviation of gain and inertia in one event of a table whose rows are `SCALE_ROW_S` apart
SCALE_ROW_S: Final = 0.06


class NoiseModel(Protocol):
    """How the samples of an event err."""

    scale_ratio: float  # deviation of gain and inertia in one event
    is_alike: bool  # whether all events, and all pieces of one, share errors: they scatter less than they err

    least_count: int  # of samples in the slip: fewer say nothing of friction

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        """Return the covariance of the residual of each measurement."""

    def overlaps(self, sensitivity: Sensitivity, covariances: Sequence[FloatArray]) -> list[FloatArray]:
        """Return what the derivatives of each measurement share with its residual, docs/model.md eq. (31)."""


class BusNoise:
    """Every sample errs by itself; two pieces share half a sample at most."""

    scale_ratio, is_alike, least_count = 0.0, False, 0

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        balance, spread = sensitivity.balance, sensitivity.spread
        laws, weights = balance.laws, balance.weights
        sensors, gain = laws.noise, laws.bias.torque_gain
        engine_std = sensors.engine_speed_rad_s * gain * laws.input_side.engine_inertia_kg_m2
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

    def covariances(self, sensitivity: Sensitivity) -> list[FloatArray]:
        balance, signals = sensitivity.balance, self._signals
        sensors, side = balance.laws.noise, balance.laws.input_side
        gain = balance.laws.bias.torque_gain
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
            inertia_kg_m2 = balance.laws.input_side.engine_inertia_kg_m2
            rates = tuple(rate + hub / inertia_kg_m2 for rate, hub in zip(rates, sensitivity.spread.hub, strict=True))
        slopes = sensitivity.engine_slopes
        by_speed = self._signals.engine_speed.shared(slopes, rates, value.grid_rows, is_followed=True)
        precisions = [joint[band, band] for band in value.bands]
        by_friction = self._friction_shares(sensitivity)
        return [np.sum(list(_overlaps(sensitivity, precisions, by_speed, by_friction)), axis=0)]

    def _friction_shares(self, sensitivity: Sensitivity) -> list[list[FloatArray]]:
        """Return what the derivatives by friction share with the pressures: those of rows are noise in both."""
        value, shares = sensitivity.balance.weights.value, list[list[FloatArray]]()
        for m, pressure in enumerate(self._signals.pressure):
            by_pressure_m3, film = sensitivity.answers[m].by_pressure_m3, sensitivity.balance.laws.packs[m].film
            torque = pressure.to_samples((value * by_pressure_m3).blocks, value.grid_rows)
            ratio = film.piston_area_m2 / film.lining_area_m2 * (by_pressure_m3 != 0.0)
            for lever_m3 in ratio * sensitivity.torques.lever_m3[m]:
                slopes = (value * lever_m3).fitted_on_samples(PRESSURE_DEGREE, pressure)
                shares.append(pressure.shared(slopes, torque, value.grid_rows, is_followed=True))
        return shares


def noise_of(signals: AlignedSignals) -> NoiseModel:
    """Return how the samples of an event err: the one place that asks where they are from."""
    return RowNoise(signals) if signals.row_s else BusNoise()


def measurements_of(balance: Balance, noise: NoiseModel, near: Sequence[Measurement] = ()) -> tuple[Measurement, ...]:
    """Return what a balance says, linearised; with the derivatives found near by if there are some."""
    residual = balance.residual_nms()
    bands = (slice(0, len(residual)),) if noise.is_alike else balance.weights.value.bands
    if [len(measurement.residual) for measurement in near] == [band.stop - band.start for band in bands]:
        return tuple(
            replace(measurement, residual=residual[band]) for measurement, band in zip(near, bands, strict=True)
        )
    sensitivity = Sensitivity(balance)
    covariances = noise.covariances(sensitivity)
    jacobian = sensitivity.jacobian(np.sqrt(np.concatenate([np.diag(covariance) for covariance in covariances])))
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
    laws = sensitivity.balance.laws
    sensors, gain = laws.noise, laws.bias.torque_gain
    speed_std = sensors.engine_speed_rad_s * laws.input_side.engine_inertia_kg_m2
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
    value = balance.weights.value * (sensitivity.is_motoring / balance.laws.bias.motoring_gain)
    torque = balance.signals.engine_torque
    slopes = value.fitted_on_samples(SLIP_DEGREE, torque)
    return torque.shared(slopes, sensitivity.spread.torque_value, value.grid_rows)


def _add_clutch_noise(sensitivity: Sensitivity, noises: list[FloatArray]) -> None:
    """Add the noise of input speeds and pressures, that of samples with the same weights as one."""
    balance, spread = sensitivity.balance, sensitivity.spread
    signals, sensors = balance.signals, balance.laws.noise
    value, of_blocks = balance.weights.value, dict[int, tuple[Blocks, list[list[FloatArray]]]]()
    for m, answers in enumerate(sensitivity.answers):
        for std, by, signal, blocks in (
            (sensors.input_speed_rad_s, answers.by_slip_nms, signals.input_speed[m], spread.input_value[m]),
            (sensors.pressure_pa, answers.by_pressure_m3, signals.pressure[m], spread.pressure_value[m]),
        ):
            if by.any():
                squares = [(std * means) ** 2 for means in signal.around_samples(by, value.places, value.grid_rows)]
                of_blocks.setdefault(id(blocks), (blocks, []))[1].append(squares)
    for blocks, variances in of_blocks.values():
        for place, weight in enumerate(blocks):
            scaled = weight * np.sqrt(sum([squares[place] for squares in variances]))
            noises[place] += scaled @ scaled.T


def add_doubt(sensitivity: Sensitivity, noises: list[FloatArray]) -> None:
    """Add what no law of friction, film and drag holds, wrong one way for a while, and what a modelled torque hides."""
    balance = sensitivity.balance
    value, gain = balance.weights.value, balance.laws.bias.torque_gain
    doubt_nm = np.hypot(*[answers.doubt_nm for answers in sensitivity.answers])
    doubt_nm *= gain * math.sqrt(DOUBT_TIME_S * DOUBT_STEP / GRID_S)
    opened_nms = OPEN_DOUBT_RATIO * gain * np.stack([moments.opened for moments in sensitivity.nominal], axis=1)
    for place, (rows_of_piece, band, block) in enumerate(zip(value.places, value.bands, value.blocks, strict=True)):
        doubt = block[:, ::DOUBT_STEP] * doubt_nm[rows_of_piece][::DOUBT_STEP]
        noises[place] += doubt @ doubt.T + opened_nms[band] @ opened_nms[band].T
    if balance.laws.torque is TorqueSource.MEASURED:
        return
    for place, block in enumerate(value.blocks):  # a smooth course of its own in every piece
        rows = block.shape[1]
        course = (block @ polynomials(rows, len(MODELLED_DOUBT_NM) - 1)) * (math.sqrt(rows) * MODELLED_DOUBT_NM)
        noises[place] += course @ course.T
