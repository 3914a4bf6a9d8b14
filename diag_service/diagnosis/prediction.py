"""Blind prediction: what friction found in some shifts says of the course of engine speed in others.

While the on-coming clutch slips, the engine obeys (docs/model.md, (P3))

    d(omega)/dt = a x - d - s_on b_on (p_on - p_touch) - s_off b_off (p_off - p_touch)

with x what tells the engine's torque up to a scale, pressures above the touch point, and s the sign of each clutch's
slip; a clutch that sticks carries what keeps it so, up to its capacity. Inertia and geometry are inside a and b: no
drawing is needed, and no engine torque. Pressures are read ``delay_s`` apart from speeds, which is found, too.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product, starmap
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import kernel
from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT, plus_minus
from diag_service.diagnosis.columns import GearRatios
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.slip_phase import SlipPhase, Standing, slip_phase

STEP_S: Final = 0.002  # of the integration
STEP_RATIO: Final = 0.02  # of a difference quotient
LEAST_EVENTS: Final = 4  # to find parameters from
LEAST_OF_CLUTCH: Final = 2  # to hold one against the other
MOST_STD: Final = 0.2  # of a shift's friction over the others: beyond it even a worn-out clutch would not show
MOST_EVENTS: Final = 100  # that are held against each other
SLIP_RAD_S: Final = 100.0  # that slopes are counted in
PERCENT: Final = 100.0
LAW_STD, LAW_STD_SLOPE = 0.04, 0.1  # what the law leaves out in emulated cars: of a shift, of a slope over that slip
PARAMETERS: Final = ("drive", "drag", "gain_1", "gain_2", "touch_pa", "delay_s")
ROUNDS: Final = 8  # of finding parameters and what is left unexplained in turn
GAIN_RATIOS: Final = (0.0, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2)
FREEDOM: Final = 4.0  # of Student's t
MOST_LEVERAGE: Final = 0.8  # of a sample on its own fit: beyond it what is left over is too small to be scaled up
WIDENING_PRIOR: Final = 1.0  # errors of the stated width that count beside those of the shifts left out
LEAST_CERTAIN: Final = 2.0  # deviations of a gain above zero: with less, not even its sign is held
TOUCH_STD_PA, DELAY_STD_S = 1.5e4, 0.015


@dataclass(frozen=True, slots=True, kw_only=True)
class Scales:
    """What parameters are counted in, so that each is about 1: means of the shifts they are found from."""

    drive: float
    pressure_pa: float
    rate_rad_s2: float
    touch_pa: float  # where the touch point is looked for
    touch_std_pa: float


class PredictionScatter(NamedTuple):
    """What no parameter explains: scales of Student's t, whose tails are heavy as those of skewed columns are."""

    speed_rad_s: float  # of a sample
    gain_ratio: float  # by how much the friction of a shift differs

    def scales_rad_s(self, mean: FloatArray) -> FloatArray:
        """Return the scale of every sample of a predicted change."""
        return np.hypot(self.speed_rad_s, self.gain_ratio * mean)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Parameters found from some shifts, in their scales, with what is left unexplained.

    ``scatter`` is what one shift has of its own, beside the parameters.
    """

    scales: Scales
    parameters: FloatArray
    covariance: FloatArray
    scatter: PredictionScatter
    reach: FloatArray  # (2, 3): least and most of what the shifts were like, `SlipPhase.course`
    shift_widening: float = 1.0  # by which errors of shifts that are left out are wider than stated
    drive_widening: float | None = None  # likewise of whole drives; None where there is one only

    def outside(self, phase: SlipPhase) -> float:
        """Return how far a shift is outside the trained range, over that range."""
        least, most = self.reach
        beyond = np.maximum(phase.course - most, least - phase.course) / np.maximum(most - least, 1e-9)
        return max(0.0, float(beyond.max()))

    def why_unknown(self, phase: SlipPhase, *, is_of_another: bool = False) -> str:
        """Return why nothing is said of a shift, of another drive or of one that was learnt from; empty if it is."""
        place = 1 + phase.clutch
        gain, std = self.parameters[place], np.sqrt(self.covariance[place, place])
        if is_of_another and self.drive_widening is None:
            return "learnt from one drive alone: how far another is from it nobody knows"
        if gain < LEAST_CERTAIN * std:
            return f"the gain of clutch {phase.clutch} is not held, perhaps not even its sign"
        if self.outside(phase) > 1.0:
            return "its pressure, slip or torque is too far outside what was learnt"
        return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A distribution of the change of engine speed at every sample of a slip phase after its first: Student's t."""

    mean_rad_s: FloatArray
    scale_rad_s: FloatArray
    freedom: float


def fitted(phases: Sequence[SlipPhase], touch_pa: float | None = None, logs: Sequence[str] = ()) -> Model:
    """Return the model that some slip phases show, by least squares with weak priors.

    Its widths are those of a jackknife over shifts and, where there are several, over drives.

    Parameters
    ----------
    logs
        Of which drive each of them is; empty: all of one.
    touch_pa
        Touch point, if it is known to 15 kPa; None: it is looked for between nothing and the lowest mean pressure.

    Raises
    ------
    ValueError
        If there are fewer than four of them.
    """
    if len(phases) < LEAST_EVENTS:
        raise ValueError(f"{len(phases)} slip phases are too few, {LEAST_EVENTS} are needed")
    from scipy.optimize import least_squares  # noqa: PLC0415 - a large library, for this alone

    scales = _scales(phases, touch_pa)
    measured = np.concatenate([phase.change_rad_s for phase in phases])
    ends = np.cumsum([len(phase.change_rad_s) for phase in phases]) - 1
    scatter = PredictionScatter(0.1 * float(np.abs(measured).max()), 0.0)
    point, means = np.array([0.5, 0.0, 1.0, 1.0, 0.0, 0.0]), measured
    for _ in range(ROUNDS):
        size = scatter.scales_rad_s(means)
        weights = np.sqrt((FREEDOM + 1.0) / (FREEDOM + ((means - measured) / size) ** 2)) / size

        def residuals(parameters: FloatArray, weights: FloatArray = weights) -> FloatArray:
            off = np.concatenate([simulated(parameters, scales, phase) for phase in phases]) - measured
            return np.concatenate([off * weights, _priors(parameters)])

        solution = least_squares(residuals, point, diff_step=[1e-3] * len(PARAMETERS))
        point = solution.x
        means = np.concatenate([simulated(point, scales, phase) for phase in phases])
        slopes = np.asarray(solution.jac, np.float64)
        covariance = np.asarray(np.linalg.inv(slopes.T @ slopes), np.float64)
        leverage = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)[: len(measured)]
        scatter = _likeliest(means, (means - measured) / np.sqrt(1.0 - np.minimum(leverage, MOST_LEVERAGE)), ends)
    courses = np.array([phase.course for phase in phases])
    model = Model(
        scales=scales, parameters=point, covariance=covariance, scatter=scatter,
        reach=np.stack([courses.min(axis=0), courses.max(axis=0)]),
    )  # fmt: skip
    slopes, looks = _jacobian(_priors, point), [_look(model, phase) for phase in phases]
    information = slopes.T @ slopes + sum(look.design.T @ look.design for look in looks)
    model = replace(model, covariance=np.asarray(np.linalg.inv(information), np.float64))
    drives = [[look for look, of in zip(looks, logs, strict=True) if of == log] for log in dict.fromkeys(logs)]
    return replace(
        model,
        shift_widening=_widening(model, [[look] for look in looks]),
        drive_widening=_widening(model, drives) if len(drives) > 1 else None,
    )


def _widening(model: Model, blocks: Sequence[Sequence["_Look"]]) -> float:
    """Return by how much the errors of shifts whose block is left out are wider than the model says: a likeliest scale.

    Leaving a block out is linearised: its residuals grow by its leverage, the parameters' covariance by what it told.
    Of each shift the last sample counts.
    """
    errors = list[float]()
    for block in blocks:
        size = np.concatenate([look.size_rad_s * look.outlying for look in block])
        design, left = (
            np.concatenate([look.design for look in block]),
            np.concatenate([look.left_rad_s for look in block]),
        )
        reached, ends = model.covariance @ design.T, np.cumsum([len(look.left_rad_s) for look in block]) - 1
        growth = np.linalg.inv(np.eye(len(left)) - design @ reached)
        covariance, last = model.covariance + reached @ growth @ reached.T, design[ends] * size[ends, None]
        variance = np.einsum("ij,jk,ik->i", last, covariance, last) + [look.size_rad_s[-1] ** 2 for look in block]
        errors += ((growth @ (left / size) * size)[ends] / np.sqrt(variance)).tolist()
    squares, square = np.square(errors), 1.0
    for _ in range(10 * ROUNDS):
        outlying = (FREEDOM + 1.0) * squares / (FREEDOM + squares / square)
        square = (WIDENING_PRIOR + float(outlying.sum())) / (WIDENING_PRIOR + len(squares))
    return float(np.sqrt(square))


def predicted(model: Model, phase: SlipPhase, *, is_of_another: bool = False) -> Prediction:
    """Return what a model says of a slip phase, given its pressures and its first speeds.

    Of another drive than those it was fitted to, and outside what was trained, intervals are wider.
    """
    mean, slopes = simulated(model.parameters, model.scales, phase), _slopes(model, phase)
    variance = np.einsum("ij,jk,ik->i", slopes, model.covariance, slopes)
    variance += model.scatter.scales_rad_s(mean) ** 2
    wider = max(model.shift_widening, (model.drive_widening or 0.0) if is_of_another else 0.0)
    wider *= 1.0 + model.outside(phase)
    return Prediction(mean_rad_s=mean, scale_rad_s=wider * np.sqrt(variance), freedom=FREEDOM)


def _jacobian(function: Callable[[FloatArray], FloatArray], parameters: FloatArray) -> FloatArray:
    """Return the derivatives of a function by all parameters, by central differences, (n, 6)."""
    steps = STEP_RATIO * np.eye(len(PARAMETERS))
    differences = [function(parameters + step) - function(parameters - step) for step in steps]
    return np.transpose(differences) / (2.0 * STEP_RATIO)


def _slopes(model: Model, phase: SlipPhase) -> FloatArray:
    """Return the Jacobian of the predicted change, (n - 1, 6)."""
    return _jacobian(lambda parameters: simulated(parameters, model.scales, phase), model.parameters)


def simulated(
    parameters: FloatArray, scales: Scales, phase: SlipPhase, friction_ratio: FloatArray | None = None
) -> FloatArray:
    """Return the change of engine speed at every sample of a slip phase after its first, (n - 1,) [rad/s].

    ``friction_ratio`` is that of the on-coming clutch over its own mean at every sample; without it 1.
    """
    drive, drag, gain_1, gain_2, touch, delay = parameters
    t_s = np.arange(0.0, float(phase.t_s[-1]) + STEP_S, STEP_S)
    read_s = t_s + delay * DELAY_STD_S
    touch_pa = scales.touch_pa + touch * scales.touch_std_pa
    above = [
        np.maximum(np.interp(read_s, *read.T) - touch_pa, 0.0) / scales.pressure_pa
        for read in (phase.on_pa, phase.off_pa)
    ]
    if friction_ratio is not None:
        above[0] *= np.interp(t_s, phase.t_s, friction_ratio)
    gains = (gain_1, gain_2) if phase.clutch == 1 else (gain_2, gain_1)
    engine = drive * np.interp(t_s, *phase.drive.T) / scales.drive - drag
    change = np.empty(len(t_s))
    _integrate(
        scales.rate_rad_s2 * phase.sign * (engine - phase.sign * gains[0] * above[0]),
        scales.rate_rad_s2 * np.abs(gains[1]) * above[1],
        STEP_S,
        change,
    )
    return np.interp(phase.t_s[1:], t_s, phase.sign * change)


@kernel
def _integrate(rate: FloatArray, hold: FloatArray, step_s: float, change: FloatArray) -> None:
    """Integrate the rate at which the engine goes from the old gear to the new one, below zero, beside what holds it.

    While the off-going clutch sticks it holds the engine up to ``hold``; when the engine has left, it pulls by that.
    """
    now = 0.0
    for row in range(len(rate)):
        change[row] = now
        pulled = rate[row] + hold[row]
        now += step_s * (min(pulled, 0.0) if now >= 0.0 else pulled)


def _scales(phases: Sequence[SlipPhase], touch_pa: float | None) -> Scales:
    rates = [abs(phase.change_rad_s[-1]) / phase.t_s[-1] for phase in phases]
    pressures = [phase.mean_pa for phase in phases]
    drives = np.abs(np.concatenate([phase.drive[:, 1] for phase in phases]))
    return Scales(
        drive=float(np.median(drives)) or 1.0,
        pressure_pa=float(np.median(pressures)),
        rate_rad_s2=float(np.median(rates)),
        touch_pa=0.5 * min(pressures) if touch_pa is None else touch_pa,
        touch_std_pa=0.3 * min(pressures) if touch_pa is None else TOUCH_STD_PA,
    )


def _priors(parameters: FloatArray) -> FloatArray:
    """Return how far parameters are from what physics lets expect, in standard deviations."""
    drive, drag, gain_1, gain_2, touch, delay = parameters
    alike = (gain_1 - gain_2) / (0.1 * (abs(gain_1) + abs(gain_2)) + 1e-6)
    return np.array([drive / 3.0, drag / 0.3, (gain_1 + gain_2) / 8.0, alike, touch, delay])


def _likeliest(means: FloatArray, left: FloatArray, ends: Int64Array) -> PredictionScatter:
    """Return the scatter that makes what is left of some shifts the likeliest.

    All samples count together as much as the last ones of the shifts: what a whole shift has of its own shows there.
    """
    best, likeliest = np.inf, PredictionScatter(1.0, 0.0)
    for scatter in starmap(PredictionScatter, product(np.geomspace(0.5, 40.0, 30).tolist(), GAIN_RATIOS)):
        size = scatter.scales_rad_s(means)
        costs = 2.0 * np.log(size) + (FREEDOM + 1.0) * np.log1p((left / size) ** 2 / FREEDOM)
        cost = float(costs.mean() + costs[ends].mean())
        if cost < best:
            best, likeliest = cost, scatter
    return likeliest


# --- friction up to a scale -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Relative:
    """A number that needs no scale, with its standard deviation."""

    value: float
    std: float

    def __mul__(self, factor: float) -> "Relative":
        return Relative(factor * self.value, factor * self.std)


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeFriction:
    """What power upshifts tell of the friction of a clutch whose level nobody knows.

    ``shifts`` has the friction of each, by the number of its event, over what the others of the clutch let expect. The
    other two are changes over the clutch's mean.
    """

    clutch: int
    shifts: Mapping[int, Relative]
    slope_s_rad: Relative  # against slip
    trend: Relative  # from the first of these shifts to the last

    @property
    def silence(self) -> str:
        """That the shifts tell nothing, if each is known too badly; else empty."""
        best = min(ratio.std for ratio in self.shifts.values())
        return f"tells nothing: friction of a shift is known to ± {2.0 * PERCENT * best:.0f} % at best" * (
            best > MOST_STD
        )

    def __str__(self) -> str:
        """Return the same as one line for people."""
        ratios = ", ".join(
            f"event {number} {plus_minus(ratio.value, ratio.std, '{:.2f}')}" for number, ratio in self.shifts.items()
        )
        slope, trend = self.slope_s_rad * (PERCENT * PER_1000_RPM), self.trend * PERCENT
        return (
            f"clutch {self.clutch}{self.silence and f' {self.silence}'}, "
            f"friction of each power upshift over its others: {ratios}; "
            f"{plus_minus(slope.value, slope.std, '{:+.1f}')} % {SLOPE_UNIT} of slip; "
            f"{plus_minus(trend.value, trend.std, '{:+.1f}')} % from the first to the last ({PLUS_MINUS})"
        )


class RelativeSurvey:
    """Takes up the events of a drive whose signals tell no level of friction; keeps its last power upshifts."""

    def __init__(self) -> None:
        self._standing, self._phases = Standing(MOST_EVENTS), deque[SlipPhase](maxlen=MOST_EVENTS)

    def add(self, event: Event, gears: GearRatios | None) -> None:
        self._standing.add(event)
        phase = slip_phase(event, gears)
        if isinstance(phase, SlipPhase) and phase.is_powered and phase.sign > 0.0 and len(phase.drive) > 1:
            self._phases.append(phase)  # without fuel or torque the law tells nothing

    def frictions(self) -> tuple[RelativeFriction, ...]:
        """Return what they tell of each clutch; nothing if they are too few."""
        if len(self._phases) < LEAST_EVENTS:
            return ()
        return tuple(relative_friction(self._phases, self._standing.touch_pa))


def relative_friction(phases: Sequence[SlipPhase], touch_pa: float | None = None) -> Iterator[RelativeFriction]:
    """Yield what slip phases of power upshifts tell of each clutch up to a scale; of one with a single shift nothing.

    Each number is found beside all parameters of the model: its deviation holds what these leave open.

    Raises
    ------
    ValueError
        If there are fewer than four of them.
    """
    model = fitted(phases, touch_pa)
    looks = [_look(model, phase) for phase in phases]
    for clutch in (1, 2):
        of_clutch = [phase for phase in phases if phase.clutch == clutch]
        if len(of_clutch) < LEAST_OF_CLUTCH:
            continue
        middle = float(np.mean(np.concatenate([phase.slip_rad_s for phase in of_clutch])))
        slopes = {phase.number: (phase.slip_rad_s - middle) / SLIP_RAD_S for phase in of_clutch}
        shares = np.linspace(-0.5, 0.5, len(of_clutch))
        yield RelativeFriction(
            clutch=clutch,
            shifts={
                phase.number: _beside(model, looks, {phase.number: np.ones(len(phase.t_s))}, start=1.0)
                for phase in of_clutch
            },
            slope_s_rad=_beside(model, looks, slopes, LAW_STD_SLOPE) * (1.0 / SLIP_RAD_S),
            trend=_beside(
                model,
                looks,
                {phase.number: np.full(len(phase.t_s), at) for phase, at in zip(of_clutch, shares, strict=True)},
            ),
        )


class _Look(NamedTuple):
    phase: SlipPhase
    slopes: FloatArray
    left_rad_s: FloatArray  # of what was measured, by the model
    size_rad_s: FloatArray
    outlying: FloatArray  # by how much each sample counts less, as the tails of Student's t have it

    @property
    def design(self) -> FloatArray:
        """The slopes, as each sample counts."""
        return self.slopes / (self.size_rad_s * self.outlying)[:, None]


def _look(model: Model, phase: SlipPhase) -> _Look:
    mean = simulated(model.parameters, model.scales, phase)
    left, size = phase.change_rad_s - mean, model.scatter.scales_rad_s(mean)
    return _Look(phase, _slopes(model, phase), left, size, np.sqrt((FREEDOM + (left / size) ** 2) / (FREEDOM + 1.0)))


def _beside(
    model: Model,
    looks: Sequence[_Look],
    courses: Mapping[int, FloatArray],
    law_std: float = LAW_STD,
    start: float = 0.0,
) -> Relative:
    """Return how much of a course friction follows beside the parameters, by least squares; a course for each event."""
    step, count = STEP_RATIO, len(PARAMETERS)
    slopes = _jacobian(_priors, model.parameters)
    information, pull = np.eye(count + 1), np.zeros(count + 1)  # a course of 100 % is its own weak prior
    information[:-1, :-1], pull[:-1] = slopes.T @ slopes, -slopes.T @ _priors(model.parameters)
    for phase, sensitivities, left, _, outlying in looks:
        design, spread = np.column_stack([sensitivities, np.zeros(len(left))]), np.maximum(outlying, 1.0)
        mean, scatter = phase.change_rad_s - left, model.scatter
        covariance = np.diag(np.full(len(mean), scatter.speed_rad_s**2)) + scatter.gain_ratio**2 * np.outer(mean, mean)
        covariance *= FREEDOM / (FREEDOM - 2.0)
        if (course := courses.get(phase.number)) is not None:
            ratios = (1.0 + sign * step * course for sign in (1.0, -1.0))
            both = [simulated(model.parameters, model.scales, phase, ratio) for ratio in ratios]
            design[:, -1] = (both[0] - both[1]) / (2.0 * step)
            if len(courses) == 1:  # a shift that is asked of itself counts whole
                spread = np.ones(len(left))
        certainty = np.linalg.inv(covariance * np.outer(spread, spread))
        information += design.T @ certainty @ design
        pull += design.T @ certainty @ left
    inverse = np.linalg.inv(information)
    return Relative(start + float(inverse[-1] @ pull), float(np.hypot(np.sqrt(inverse[-1, -1]), law_std)))
