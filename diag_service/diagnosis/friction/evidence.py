"""Parameters of a vehicle, the evidence of events, and the posterior that both give.

Evidence is chi-square as a quadratic function of the parameters: information matrix, vector and constant instead of
samples. Knowledge is a mean with its covariance: prior or posterior; docs/model.md, section "Estimator".

The last events are judged together: which of them do not belong, and whether the friction of a clutch has stepped. Each
event is compared with all others, later ones included, so good shifts expose a bad first one. Omitting an event costs
chi-square, and so does a step of friction: the cheapest selection is believed.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration
from clutch_model.errors import CalibrationError

FRICTION_PRIOR_STD = 0.05  # a third of any lining's friction: weak against a single shift


class State(IntEnum):
    """Index of each estimated parameter; friction is multiplied by the gain of the torque reading."""

    MU_C1 = 0
    MU_S1 = 1
    MU_C2 = 2
    MU_S2 = 3
    TORQUE_OFFSET = 4  # reading minus truth [Nm]
    TOUCH1 = 5  # touch pressure minus calibration [Pa]
    TOUCH2 = 6
    ZERO1 = 7  # pressure reading minus truth [Pa]
    ZERO2 = 8


class Considered(IntEnum):
    """Index of each parameter that is carried, but not estimated shift by shift; relative to the calibration."""

    TORQUE_GAIN = 0  # ratio
    ENGINE_INERTIA = 1  # ratio
    PISTON_AREA1 = 2  # ratio
    PISTON_AREA2 = 3
    VISCOSITY = 4  # ratio
    TORQUE_LATENCY = 5  # [s]
    PRESSURE_LATENCY = 6  # [s]
    MOTORING_GAIN = 7  # ratio
    STRIBECK_SPEED = 8  # ratio, both clutches
    CONTACT_STIFFNESS = 9  # ratio, both clutches
    SHAFT_INERTIA = 10  # ratio, both input shafts in neutral
    FILM_MOBILITY = 11  # natural logarithm of a ratio, both clutches
    STRIBECK_EXPONENT = 12  # natural logarithm of a ratio, both clutches
    FRICTION_TEMPERATURE = 13  # ratio per kelvin, both clutches
    OPEN_DRAG = 14  # natural logarithm of a ratio, both clutches


STATE_COUNT = len(State)
PARAMETER_COUNT = STATE_COUNT + len(Considered)
FRICTION_COUNT = 4
FRICTION_ROWS: Final = (slice(0, 2), slice(2, 4))  # (mu_C, mu_S) of clutch 1 and 2
REFERENCE_K = 363.15  # of a pack at work, for which friction is stated
NAMES = tuple(member.name.lower() for member in (*State, *Considered))
"""Names of all parameters, states first: the order of every joint vector."""
NUISANCE_NAMES = NAMES[FRICTION_COUNT:]
LEAST_JOINT_COUNT = 16  # names of the joint uncertainty in calibration files of the first versions


def open_drag_ratio(at: FloatArray) -> float:
    """Return the drag of an open pack over what is believed; ``at`` are all parameters, shape (len(NAMES),)."""
    return math.exp(at[STATE_COUNT + Considered.OPEN_DRAG])


def prior_mean(calibration: Calibration) -> FloatArray:
    """Return the states before any shift, shape (len(State),)."""
    bias = calibration.bias
    mean = np.zeros(STATE_COUNT)
    curves = [clutch.friction for clutch in calibration.clutches]
    mean[:FRICTION_COUNT] = [bias.torque_gain * value for curve in curves for value in (curve.mu_c, curve.mu_s)]
    mean[State.TORQUE_OFFSET] = bias.torque_offset_nm
    mean[State.TOUCH1], mean[State.TOUCH2] = bias.touch_offsets_pa
    mean[State.ZERO1], mean[State.ZERO2] = bias.pressure_zeros_pa
    return mean


def prior_covariance(calibration: Calibration) -> FloatArray:
    """Return the covariance of all parameters before any shift, shape (len(NAMES), len(NAMES)).

    Raises
    ------
    CalibrationError
        If the joint uncertainty of the calibration is not that of these parameters.
    """
    covariance = np.zeros((len(NAMES), len(NAMES)))
    covariance[:FRICTION_COUNT, :FRICTION_COUNT] = np.eye(FRICTION_COUNT) * FRICTION_PRIOR_STD**2
    covariance[FRICTION_COUNT:, FRICTION_COUNT:] = _nuisance_covariance(calibration)
    if calibration.torque.is_modelled:  # a wrong scale makes all of them wrong alike
        gain, mu = STATE_COUNT + Considered.TORQUE_GAIN, prior_mean(calibration)[:FRICTION_COUNT]
        covariance[:FRICTION_COUNT, gain] = covariance[gain, :FRICTION_COUNT] = mu * covariance[gain, gain]
        covariance[:FRICTION_COUNT, :FRICTION_COUNT] += np.outer(mu, mu) * covariance[gain, gain]
    return covariance


def _nuisance_covariance(calibration: Calibration) -> FloatArray:
    joint, covariance = calibration.joint, np.diag(np.square(type_std(calibration)))
    if joint is None:
        return covariance
    if joint.names != NUISANCE_NAMES[: len(joint.names)] or len(joint.names) < LEAST_JOINT_COUNT:
        raise CalibrationError(f"joint.names must be {', '.join(NUISANCE_NAMES)}")
    count, std = len(joint.names), np.array(joint.std)  # what earlier programs did not calibrate is as the type has it
    covariance[:count, :count] = std[:, None] * np.array(joint.correlation) * std
    if np.linalg.eigvalsh(np.array(joint.correlation))[0] < -1e-9:
        raise CalibrationError("joint.correlation is not positive")
    return covariance


def type_std(calibration: Calibration) -> list[float]:
    """Return by how much vehicles of the type differ in each of ``NUISANCE_NAMES``."""
    scatter = calibration.uncertainty
    return [
        scatter.torque_offset_nm,
        scatter.touch_pressure_pa,
        scatter.touch_pressure_pa,
        scatter.pressure_zero_pa,
        scatter.pressure_zero_pa,
        scatter.torque_gain_ratio,
        scatter.engine_inertia_ratio,
        scatter.piston_area_ratio,
        scatter.piston_area_ratio,
        scatter.viscosity_ratio,
        scatter.torque_latency_s,
        scatter.pressure_latency_s,
        scatter.motoring_gain_ratio,
        scatter.stribeck_speed_ratio,
        scatter.contact_stiffness_ratio,
        scatter.input_shaft_inertia_ratio,
        scatter.film_mobility_log,
        scatter.stribeck_exponent_log,
        scatter.friction_temperature_1_k,
        scatter.open_drag_log,
    ]


@cache
def skew_variance(skew_s: float) -> FloatArray:
    """Return what a skew of columns adds to the variance of all parameters, shape (PARAMETER_COUNT,).

    Columns are asked one after the other: torque and pressures may be younger than the engine's speed by up to that.
    """
    added = np.zeros(PARAMETER_COUNT)
    added[[STATE_COUNT + Considered.TORQUE_LATENCY, STATE_COUNT + Considered.PRESSURE_LATENCY]] = skew_s**2 / 6.0
    return added


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A linearised residual: ``residual = jacobian @ dx + noise`` for a displacement ``dx`` of the parameters.

    ``overlap`` is the expectation of ``jacobian.T @ inv(covariance) @ noise``: what the sensor noise that it shares
    with the residual adds to the gradient.
    """

    residual: FloatArray  # (m,)
    jacobian: FloatArray  # (m, PARAMETER_COUNT)
    covariance: FloatArray  # (m, m) of the noise
    overlap: FloatArray | None = None  # (PARAMETER_COUNT,); None: nothing is shared


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Chi-square of residuals, ``constant - 2 * vector @ x + x @ matrix @ x``; docs/model.md, (22) and (23)."""

    matrix: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT), of information
    vector: FloatArray  # (PARAMETER_COUNT,)
    constant: float
    count: int  # residuals

    @classmethod
    def none(cls) -> Self:
        """Return the evidence of no event."""
        empty = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
        return cls(matrix=empty, vector=np.zeros(PARAMETER_COUNT), constant=0.0, count=0)

    @classmethod
    def sum(cls, some: Sequence[Self], weights: Sequence[float] | None = None) -> Self:
        """Return the evidence of some events together, each residual with the weight of its event, by default 1."""
        if not some:
            return cls.none()
        weighted = list(zip(some, [1.0] * len(some) if weights is None else weights, strict=True))
        return cls(
            matrix=np.add.reduce([weight * evidence.matrix for evidence, weight in weighted]),
            vector=np.add.reduce([weight * evidence.vector for evidence, weight in weighted]),
            constant=sum([weight * evidence.constant for evidence, weight in weighted]),
            count=sum([evidence.count for evidence in some]),
        )

    def weighted(self, weight: float) -> Self:
        """Return the same, each residual with this weight."""
        if weight == 1.0:
            return self
        return replace(self, matrix=weight * self.matrix, vector=weight * self.vector, constant=weight * self.constant)

    @classmethod
    def of(
        cls,
        measurements: Iterable[Measurement],
        at: FloatArray,
        readings: "Evidence | None" = None,
        variance: FloatArray | None = None,
    ) -> Self:
        """Return the evidence of an event, marginal over the deviations of its own parameters.

        Parameters
        ----------
        measurements
            Linearised about ``at``, shape (PARAMETER_COUNT,).
        readings
            Further evidence of it.
        variance
            Of the event's own parameters about the vehicle's, shape (PARAMETER_COUNT,).
        """
        joint, count = np.zeros((PARAMETER_COUNT + 1, PARAMETER_COUNT + 1)), 0
        for measurement in measurements:
            sides = np.column_stack([measurement.jacobian, measurement.residual])
            joint += sides.T @ np.linalg.solve(measurement.covariance, sides)  # (22)
            if measurement.overlap is not None:
                joint[:-1, -1] -= measurement.overlap  # (31)
            count += len(measurement.residual)
        matrix, gradient = 0.5 * (joint + joint.T)[:-1, :-1], joint[:-1, -1]  # but for rounding it is symmetric
        vector = matrix @ at + gradient
        constant = float(joint[-1, -1] + (vector + gradient) @ at)
        if readings is not None:
            matrix += readings.matrix
            vector += readings.vector
            constant, count = constant + readings.constant, count + readings.count
        if variance is not None:  # (19b) by Woodbury's identity: matrix may be singular
            std = np.sqrt(variance)
            sides = std[:, None] * np.column_stack([matrix, vector])
            loss = sides.T @ np.linalg.solve(np.eye(len(std)) + sides[:, :-1] * std, sides)
            matrix, vector = matrix - 0.5 * (loss + loss.T)[:-1, :-1], vector - loss[:-1, -1]
            constant -= float(loss[-1, -1])
        return cls(matrix=matrix, vector=vector, constant=constant, count=count)

    @classmethod
    def of_readings(cls, rows: Sequence[int], reading: Sequence[float], variance: Sequence[float]) -> Self:
        """Return the evidence of independent readings of single parameters, in these rows, each with a variance."""
        matrix, vector = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT)), np.zeros(PARAMETER_COUNT)
        value = np.array(reading)
        matrix[rows, rows], vector[rows] = 1.0 / np.array(variance), value / variance
        constant = float((value**2 / variance).sum())
        return cls(matrix=matrix, vector=vector, constant=constant, count=len(rows))

    def chi_square(self, at: FloatArray) -> float:
        """Return chi-square of the residuals at some parameters."""
        return self.constant + float((self.matrix @ at - 2.0 * self.vector) @ at)


@dataclass(frozen=True, slots=True, kw_only=True)
class Knowledge:
    """Mean and covariance of all parameters, before events or after them."""

    mean: FloatArray  # (PARAMETER_COUNT,)
    covariance: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT)

    def less_sure(self, added: FloatArray) -> Self:
        """Return the same, each parameter less certain by a variance; ``added`` has shape (PARAMETER_COUNT,)."""
        return type(self)(mean=self.mean, covariance=self.covariance + np.diag(added))

    def std(self) -> FloatArray:
        """Return the standard deviations, shape (PARAMETER_COUNT,)."""
        return np.sqrt(self.covariance.diagonal())


OWN_LAWS: Final = {  # parameters of friction, and the standard deviation of linings of any type
    STATE_COUNT + Considered.STRIBECK_SPEED: 0.3,
    STATE_COUNT + Considered.FRICTION_TEMPERATURE: 0.002,
}
_STATIC: Final = [State.MU_S1, State.MU_S2]
_CURVE: Final = STATE_COUNT + np.array([Considered.STRIBECK_SPEED, Considered.STRIBECK_EXPONENT])
_CURVE_DOUBT: Final = np.array([0.2, 1.0])  # of mu_S, per square of these: the curve is linearised
_MOST_MOVED: Final = np.array([0.3, 0.15])  # beyond it friction has changed meanwhile: that is no curve
LEAST_TOLD: Final = 0.1  # of what the type tells of it: a few events are no witness


class Prior(NamedTuple):
    """The prior before the first event."""

    std: FloatArray  # (PARAMETER_COUNT,)
    information: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT), in these deviations

    @classmethod
    def of(cls, covariance: FloatArray) -> Self:
        std = np.sqrt(covariance.diagonal())
        std[std == 0.0] = 1.0
        return cls(std, np.linalg.pinv(covariance / np.outer(std, std), hermitian=True))

    def stated(self, whole: FloatArray, ratio: float) -> FloatArray:
        """Return a covariance of which what events tell is scaled by a ratio; docs/model.md, equation (38)."""
        scaled = whole / np.maximum(self.std, np.sqrt(whole.diagonal()))  # what drifts was no better known before
        return ratio * whole + (1.0 - ratio) * (scaled @ self.information @ scaled.T)

    def with_own_laws(self, known: Knowledge) -> Knowledge:
        """Return knowledge that holds a vehicle to its type only as far as it is like it; docs/model.md, (39).

        The prior's deviation of such a law is what events alone show of the vehicle, and at least the type's.
        """
        mean, covariance = known.mean, known.covariance.copy()
        for row, most_std in OWN_LAWS.items():
            prior, variance, away = float(self.std[row]) ** 2, float(covariance[row, row]), float(mean[row])
            if variance == 0.0 or prior < (1.0 + LEAST_TOLD) * variance:  # certain, or hardly told
                continue
            own = min((away / (1.0 - variance / prior)) ** 2, most_std**2)
            missing, column = 1.0 / prior - 1.0 / max(own, prior), covariance[:, row]
            gain = missing / (1.0 - missing * variance)
            if abs(away) * (1.0 + gain * variance) <= 2.0 * most_std:  # no lining is like more: that does not fit
                mean, covariance = mean + gain * away * column, covariance + gain * np.outer(column, column)
        doubt = np.linalg.norm(_CURVE_DOUBT * np.minimum(np.abs(mean[_CURVE]), _MOST_MOVED) ** 2)
        covariance[_STATIC, _STATIC] += (doubt * mean[_STATIC]) ** 2
        return Knowledge(mean=mean, covariance=covariance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fusion:
    """The posterior of a prior and evidence."""

    knowledge: Knowledge
    chi_square: float  # at the posterior mean: of the residuals, and of the distance from the prior
    distance: float  # chi-square of the posterior mean about the prior's
    information: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT) of the evidence

    @property
    def error_transition(self) -> FloatArray:
        """What is left of an error of the earlier mean, shape (PARAMETER_COUNT, PARAMETER_COUNT)."""
        return np.eye(len(self.information)) - self.knowledge.covariance @ self.information


def fuse(earlier: Knowledge, evidence: Evidence) -> Fusion:
    """Return the posterior of ``earlier`` and evidence, (24); a parameter without variance stays as it is."""
    if not evidence.count:  # then all parameters stay, to the last digit
        return Fusion(knowledge=earlier, chi_square=0.0, distance=0.0, information=evidence.matrix)
    std = np.sqrt(earlier.covariance.diagonal())
    scale = np.outer(std, std)
    correlation = np.divide(earlier.covariance, scale, out=np.zeros_like(scale), where=scale > 0.0)
    looser = np.eye(len(scale)) + correlation @ (evidence.matrix * scale)
    covariance = scale * np.linalg.solve(looser, correlation)
    covariance = 0.5 * (covariance + covariance.T)
    gradient = evidence.vector - evidence.matrix @ earlier.mean
    step = covariance @ gradient
    return Fusion(
        knowledge=Knowledge(mean=earlier.mean + step, covariance=covariance),
        chi_square=evidence.chi_square(earlier.mean) - float(gradient @ step),
        distance=float(step @ (gradient - evidence.matrix @ step)),
        information=evidence.matrix,
    )


OMISSION_COST: Final = 25.0  # chi-square over its expectation, the count of residuals; of 2 numbers 4e-6 exceed it
_LEAST_SAVING: Final = 1e-9  # of chi-square: less is rounding
_JITTER: Final = 1e-12  # of a variance: what was certain of two parameters together has an inverse too


class Selection(NamedTuple):
    """Some of the events, and what it costs to believe just these."""

    is_used: tuple[bool, ...]
    cost: float  # chi-square, and what leaving out costs


def is_cheap(cost: float, evidences: Sequence[Evidence]) -> bool:
    """Return whether a selection costs so little that none is sought from the other end, with no event at first."""
    return cost <= sum([evidence.count for evidence in evidences]) + OMISSION_COST


def selected(base: Knowledge, evidences: Sequence[Evidence]) -> Selection:
    """Return the cheapest selection of events with a prior; docs/model.md, (25)."""
    search = _search(base, evidences)
    selection = _improved(search, np.ones(len(evidences), dtype=bool))
    if is_cheap(selection.cost, evidences):
        return selection
    return min(selection, _improved(search, np.zeros(len(evidences), dtype=bool)), key=lambda choice: choice.cost)


class _Search(NamedTuple):
    """Events and what was known before them, in standard deviations of that."""

    precision: FloatArray  # (p, p) of what was known
    matrices: FloatArray  # (events, p, p) of information, without what was certain
    gradients: FloatArray  # (events, p)
    constants: FloatArray  # (events,) chi-square of what was known
    omissions: FloatArray  # (events,) what it costs to leave one out


def _search(base: Knowledge, evidences: Sequence[Evidence]) -> _Search:
    count, number, scale = len(base.mean), len(evidences), np.outer(std := base.std(), std)
    covariance = np.divide(base.covariance, scale, out=np.zeros_like(scale), where=scale > 0.0)
    np.fill_diagonal(covariance, 1.0 + _JITTER)  # also of what was certain
    matrices = np.array([evidence.matrix for evidence in evidences]).reshape(number, count, count)
    vectors = np.array([evidence.vector for evidence in evidences]).reshape(number, count)
    return _Search(
        precision=np.linalg.inv(covariance),
        matrices=matrices * scale,
        gradients=(vectors - matrices @ base.mean) * std,
        constants=np.array([evidence.constant for evidence in evidences])
        + (matrices @ base.mean - 2.0 * vectors) @ base.mean,
        omissions=np.array([evidence.count + OMISSION_COST for evidence in evidences], dtype=np.float64),
    )


def _improved(search: _Search, is_used: BoolArray) -> Selection:
    """Return the selection in which no single event taken in or left out saves anything.

    Takes in or leaves out what saves most, one event at a time, until nothing does.
    """
    cost = np.inf
    while True:
        information = search.precision + search.matrices[is_used].sum(axis=0)
        gradient = search.gradients[is_used].sum(axis=0)
        spent = float(search.constants[is_used].sum() + search.omissions[~is_used].sum())
        if np.isinf(cost):
            cost = spent - float(_saved(information, gradient))
        sign = np.where(is_used, -1.0, 1.0)
        saved = _saved(information + sign[:, None, None] * search.matrices, gradient + sign[:, None] * search.gradients)
        tried = np.nan_to_num(spent + sign * (search.constants - search.omissions) - saved, nan=np.inf)
        best = int(tried.argmin()) if len(tried) else None
        if best is None or not tried[best] < cost - _LEAST_SAVING:
            return Selection(is_used=tuple(is_used.tolist()), cost=cost)
        is_used[best], cost = not is_used[best], float(tried[best])


def _saved(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return ``gradient @ inv(information) @ gradient``: (..., p, p) and (..., p) to (...)."""
    step = np.linalg.solve(information, gradient[..., None])[..., 0]
    return np.asarray((gradient * step).sum(axis=-1))


SOUND_COST: Final = 5.0  # chi-square of two numbers, in units of the vehicle's own scatter: 8 % by chance
ODD_COST: Final = 20.0  # likewise: what differs so much counts nothing, in between less and less
_MEDIAN_BY_CHANCE: Final = 2.0 * math.log(2.0)  # of chi-square of two numbers
STEP_COST: Final = 55.0  # chi-square: more than leaving two events out, less than three
SMALL_STEP_COST: Final = 24.0  # of a step for which no event is left out: by chance two more numbers save it in 6e-6
LEAST_SCATTER: Final = 0.18  # ratio to the variance that events are granted: a smaller one counts as this
SCATTER_COUNT: Final = 8  # of events that show by how much they differ
PLAIN_STEP_RATIO: Final = 0.04  # of mu_C: a smaller change, against the scatter of a few events, is none
STEP_COUNT: Final = 3  # of the newest events of a clutch, which agree that it has changed
SHARED_PART: Final = 0.5  # of what a step costs: so much must be saved without the event that shows it most
STEP_COUNTS: Final = (3, 4, 5, 6)  # of events since a change that is too small for any of them to be left out
_PRIOR: Final = np.eye(2) / FRICTION_PRIOR_STD**2  # information on a step


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedEvent:
    """The evidence of one event of a clutch."""

    clutch: int  # 1 or 2, the one that slipped
    end_ns: int
    evidence: Evidence
    least_scatter: float = 0.0  # ratio to the stated variance: it shares errors with others, so they scatter less


class Judgement(NamedTuple):
    """The cheapest selection of some events, and its posterior."""

    fusion: Fusion
    weights: tuple[float, ...]  # of the events, 0 to 1: 0 is left out
    cost: float  # chi-square, and what leaving out costs
    first_changed: int | None = None  # from that event on its clutch has another friction

    @property
    def is_used(self) -> tuple[bool, ...]:
        """Whether each event belongs."""
        return tuple([weight > 0.0 for weight in self.weights])

    def weighted(self, base: Knowledge, events: Sequence[JudgedEvent], weights: Sequence[float]) -> Self:
        """Return the same judgement with other weights of the events."""
        return self._replace(fusion=fuse(base, together(events, weights)), weights=tuple(map(float, weights)))


def judge(base: Knowledge, events: Sequence[JudgedEvent]) -> Judgement:
    """Return the judgement on events, the oldest first, with a prior."""
    best = selected(base, [event.evidence for event in events])
    weights = tuple(map(float, best.is_used))
    judged = Judgement(fusion=fuse(base, together(events, weights)), weights=weights, cost=best.cost)
    for first, cost in (*_where_changed(events, best.is_used), *_where_stepped(events, best, judged.fusion.knowledge)):
        judged = min(judged, _with_change(base, events, first, cost), key=lambda choice: choice.cost)
    return judged if judged.first_changed is not None else _weighted(base, events, judged)


def _weighted(base: Knowledge, events: Sequence[JudgedEvent], judged: Judgement) -> Judgement:
    """Return the judgement in which events that differ from the others count less, and far odder ones nothing.

    What is stated holds for vehicles of all kinds; the median event shows what it is worth in this one; (25a), (25b).
    """
    is_used = list(judged.is_used)
    while is_used.count(True) > SCATTER_COUNT:
        rows, known = np.flatnonzero(is_used).tolist(), judged.fusion.knowledge
        apart = np.array([step_since(known, events[row].evidence, events[row].clutch)[0] for row in rows])
        apart /= min(max(float(np.median(apart)) / _MEDIAN_BY_CHANCE, LEAST_SCATTER), 1.0)
        if apart.max() < ODD_COST:  # (25a)
            weights = np.zeros(len(events))  # (25b)
            weights[rows] = np.minimum((ODD_COST - apart) / (ODD_COST - SOUND_COST), 1.0)
            return judged.weighted(base, events, weights.tolist())
        is_used[rows[apart.argmax()]] = False
        judged = judged.weighted(base, events, is_used)
    return judged


def _where_stepped(events: Sequence[JudgedEvent], best: Selection, known: Knowledge) -> Iterator[tuple[int, float]]:
    """Yield from where on the newest one's clutch may have another friction than is ``known``, and what that costs."""
    rows = [row for row, event in enumerate(events) if event.clutch == events[-1].clutch and best.is_used[row]]
    for count in STEP_COUNTS:
        if len(rows) >= count:
            first, cost = rows[-count], SMALL_STEP_COST
            saved, ratio, _ = step_since(known, together(events[first:], best.is_used[first:]), events[-1].clutch)
            if LEAST_SCATTER * cost < saved < cost and abs(ratio) > PLAIN_STEP_RATIO:
                cost *= _scatter(events, best, known, saved)
            if saved > cost and _shared(events, best, known, rows[-count:]) > SHARED_PART * cost:
                yield first, cost


def _shared(events: Sequence[JudgedEvent], best: Selection, known: Knowledge, rows: Sequence[int]) -> float:
    """Return what chi-square would lose by a step that some events show, without the one that shows it most."""
    without = [[used and place != row for place, used in enumerate(best.is_used)][rows[0] :] for row in rows]
    return min([step_since(known, together(events[rows[0] :], used), events[-1].clutch)[0] for used in without])


def _scatter(events: Sequence[JudgedEvent], best: Selection, known: Knowledge, saved: float) -> float:
    """Return by which part of the variance that they are granted the used events differ, but for a step."""
    used = [event for event, is_used in zip(events, best.is_used, strict=True) if is_used]
    if len(used) < SCATTER_COUNT:
        return 1.0
    apart = sum(step_since(known, event.evidence, event.clutch)[0] for event in used)
    return min(max((apart - saved) / (2 * len(used) - 2), LEAST_SCATTER), 1.0)


def step_since(known: Knowledge, since: Evidence, clutch: int) -> tuple[float, float, float]:
    """Return what chi-square would lose if the friction of a clutch had changed right before some of the events.

    The least over that step and all parameters, by Schur's complement of the parameters: chi-square is quadratic. The
    second number is the part of mu_C by which it would have changed, the third what is lost by chance: at most 2.
    """
    rows = FRICTION_ROWS[clutch - 1]
    by_step = since.matrix[rows]
    first, second = (since.vector[rows] - by_step @ known.mean).tolist()
    (a, b), (c, d) = (by_step[:, rows] - by_step @ known.covariance @ by_step.T + _PRIOR).tolist()
    determinant = a * d - b * c
    saved = (d * first**2 - (b + c) * first * second + a * second**2) / determinant
    by_chance = 2.0 - (a + d) / determinant / FRICTION_PRIOR_STD**2
    return saved, (d * first - b * second) / determinant / float(known.mean[rows.start]), by_chance


def _with_change(base: Knowledge, events: Sequence[JudgedEvent], first: int, step_cost: float) -> Judgement:
    """Return the judgement if the friction of an event's clutch stepped right before it."""
    older, newer = events[:first], events[first:]
    until = selected(base, [event.evidence for event in older])
    before = fuse(base, together(older, until.is_used)).knowledge
    known = after_change(before, newer[0].clutch)
    since = selected(known, [event.evidence for event in newer])
    return Judgement(
        fusion=fuse(known, together(newer, since.is_used)),
        weights=tuple(map(float, (*until.is_used, *since.is_used))),
        cost=until.cost + since.cost + step_cost,
        first_changed=first,
    )


def together(events: Sequence[JudgedEvent], weights: Sequence[float]) -> Evidence:
    """Return the evidence of some events, each residual with the weight of its event; those without weight are none."""
    used = [(one.evidence, weight) for one, weight in zip(events, weights, strict=False) if weight]
    return Evidence.sum([evidence for evidence, _ in used], [weight for _, weight in used])


def after_change(known: Knowledge, clutch: int) -> Knowledge:
    """Return knowledge after a step of unknown size in the friction of a clutch."""
    added = np.zeros(PARAMETER_COUNT)
    added[FRICTION_ROWS[clutch - 1]] = FRICTION_PRIOR_STD**2
    return known.less_sure(added)


def _where_changed(events: Sequence[JudgedEvent], is_used: Sequence[bool]) -> Iterator[tuple[int, float]]:
    """Yield events before which their clutch may have changed: its newest are all left out, or all before them are."""
    for clutch in (1, 2):
        rows = [row for row, event in enumerate(events) if event.clutch == clutch]
        used = [is_used[row] for row in rows]
        if not any(used[-STEP_COUNT:]) and len(rows) >= STEP_COUNT:
            yield rows[max((place + 1 for place, is_in in enumerate(used) if is_in), default=0)], STEP_COST
        if not any(used[:STEP_COUNT]) and all(used[-STEP_COUNT:]) and len(rows) >= 2 * STEP_COUNT:
            yield rows[used.index(True)], STEP_COST
