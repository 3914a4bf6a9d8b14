"""The posterior of one vehicle after its events: friction, sensors, masses and films, all jointly.

The last events are stored as evidence, not as samples, and judged together; older ones are part of the base.
docs/model.md, section "Estimator".

Driving shows the torque reading over pressure: friction times torque gain times piston area. The ratio of two such
numbers, or of one to its baseline, is free of the gain, and within one clutch of the area, too. The second half of this
module computes these values with their standard deviations.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, TorqueSource, both_clutches, with_clutch
from clutch_results.records import ClutchRatio, FrictionEstimate, FrictionTrend, ScaleFreeFriction, from_plain, to_plain
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    FRICTION_ROWS,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    Fusion,
    JudgedEvent,
    Knowledge,
    Prior,
    State,
    after_change,
    fuse,
    is_cheap,
    judge,
    prior_covariance,
    prior_mean,
    step_since,
    together,
    type_std,
)
from fleet_contract import JsonObject

BASELINE_SHIFT_COUNT = 15  # of the clutch: three times the shifts that settle a verdict
SHAPES = {"mean": (2,), "covariance": (2, 2), "cross": (PARAMETER_COUNT, 2)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Frozen ``(mu_c, mu_s)`` of one clutch, times the gain of the torque reading.

    ``cross`` is the covariance between the error of what is known today and that of the baseline. It begins as the
    baseline's own and fades as later shifts outweigh the earlier ones.
    """

    mean: FloatArray  # (2,)
    covariance: FloatArray  # (2, 2)
    cross: FloatArray  # (PARAMETER_COUNT, 2)
    end_ns: int  # bus time of the last shift in it
    shift_count: int  # shifts in it
    later_count: int = 0  # shifts that became part of the base since

    @classmethod
    def of(cls, clutch: int, known: Knowledge, *, end_ns: int, count: int) -> Self:
        rows = FRICTION_ROWS[clutch - 1]
        return cls(
            mean=known.mean[rows],
            covariance=known.covariance[rows, rows],
            cross=known.covariance[:, rows],
            end_ns=end_ns,
            shift_count=count,
        )

    def after(self, error_transition: FloatArray) -> Self:
        """Return the baseline after news that leave this of the earlier error."""
        return replace(self, cross=error_transition @ self.cross)  # (36)


MOST_APART: Final = 9.0  # chi-square of two numbers, 1 % by chance: what is beyond is left out, or a step
LEAST_BY_CHANCE: Final = 1.5  # expected chi-square, at most 2: the first event of a clutch tests only its prior
STATED_COUNT: Final = 5.0  # degrees of freedom that scatter as stated, before any event: those of three events
SCATTER_FORGETTING: Final = 0.99  # weight of an event after each later one: some hundred count


class EventScatter(NamedTuple):
    """Scatter of the friction of single events; docs/model.md, equation (38)."""

    apart: float = 0.0  # chi-square that events would save, older ones faded, had each a friction of its own
    by_chance: float = 0.0  # its expectation with the stated deviations

    @property
    def ratio(self) -> float:
        """Observed over stated variance of events."""
        return (STATED_COUNT + self.apart) / (STATED_COUNT + self.by_chance)

    def with_event(self, known: Knowledge, event: JudgedEvent, weight: float = 1.0) -> "EventScatter":
        """Return it after an event which is part of what is known, with some weight."""
        weighted, _, by_chance = step_since(known, event.evidence.weighted(weight), event.clutch)
        if by_chance < LEAST_BY_CHANCE:
            return self
        apart = max(weighted / weight, event.least_scatter * by_chance)
        return EventScatter(
            SCATTER_FORGETTING * self.apart + min(apart, MOST_APART), SCATTER_FORGETTING * self.by_chance + by_chance
        )


MOST_UNLIKE: Final = float(PARAMETER_COUNT)  # chi-square of all parameters about those of the type
RECENT_COUNT: Final = 16  # events judged together: some eight of each clutch
FRICTION_DRIFT_STD: Final = 2e-5  # of mu per event; a fluid loses 1e-6: with this, older events fade over thousands
OFFSET_DRIFT_NM: Final = 0.005  # per event: warm-up of the torque model
PRESSURE_DRIFT_PA: Final = 5.0  # per event: warm-up of the pressure sensors
VISCOSITY_DRIFT_RATIO: Final = 0.01  # per event: an oil that warms up follows a law of its own
OPEN_DRAG_DRIFT_LOG: Final = 0.05  # per event: likewise
STATE_FORMAT: Final = 4  # of what is stored
_LOWER: Final = np.tril_indices(PARAMETER_COUNT)
_DRIFT: Final = np.zeros(PARAMETER_COUNT)  # variance that each event adds
_DRIFT[: State.TORQUE_OFFSET] = FRICTION_DRIFT_STD**2
_DRIFT[State.TORQUE_OFFSET] = OFFSET_DRIFT_NM**2
_DRIFT[State.TOUCH1 : STATE_COUNT] = PRESSURE_DRIFT_PA**2
_DRIFT[STATE_COUNT + Considered.VISCOSITY] = VISCOSITY_DRIFT_RATIO**2
_DRIFT[STATE_COUNT + Considered.OPEN_DRAG] = OPEN_DRAG_DRIFT_LOG**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """The state of a vehicle's estimate; `fresh`, `with_event` and `from_json` make one."""

    base: Knowledge  # without the recent events
    recent: tuple[JudgedEvent, ...]  # the oldest first
    weights: tuple[float, ...]  # of the recent events, 0 to 1: 0 is left out
    fusion: Fusion  # of the base and the recent events that belong
    folded_counts: tuple[int, int] = (0, 0)  # events in the base that speak of the friction of clutch 1 and 2
    baselines: tuple[Baseline | None, Baseline | None] = (None, None)  # against the base
    packs: PackTemperatures | None = None
    prior: Prior
    scatter: EventScatter = field(default_factory=EventScatter)
    may_begin_again: bool = True  # no event is part of the base yet, and it has not begun again before
    torque: TorqueSource = TorqueSource.MEASURED
    torque_gain: float = 1.0  # of the calibration: the parameters say by how much it is wrong
    stribeck_speed_rad_s: tuple[float, float] = (1.0, 1.0)  # likewise

    @classmethod
    def fresh(cls, calibration: Calibration) -> Self:
        """Return the prior of a vehicle: its calibration."""
        displacement = np.zeros(PARAMETER_COUNT - STATE_COUNT)
        mean = np.concatenate((prior_mean(calibration), displacement))
        return cls.of(Knowledge(mean=mean, covariance=prior_covariance(calibration)), calibration)

    @classmethod
    def of(cls, base: Knowledge, calibration: Calibration) -> Self:
        """Return the state that begins with some knowledge."""
        return cls(
            base=base,
            recent=(),
            weights=(),
            fusion=fuse(base, Evidence.none()),
            prior=Prior.of(base.covariance),
            torque=calibration.torque,
            may_begin_again=calibration.joint is None,  # a vehicle is not unlike its own calibration: that does not fit
            torque_gain=calibration.bias.torque_gain,
            stribeck_speed_rad_s=both_clutches(clutch.friction.stribeck_speed_rad_s for clutch in calibration.clutches),
        )

    @property
    def known(self) -> Knowledge:
        """Mean and covariance of all parameters."""
        return self.fusion.knowledge

    @property
    def stated(self) -> Knowledge:
        """What is known, its covariance scaled by the scatter of events, its curve its own; docs/model.md, (38)."""
        known = self.fusion.knowledge
        if self.scatter.by_chance:
            known = Knowledge(mean=known.mean, covariance=self.prior.stated(known.covariance, self.scatter.ratio))
        return self.prior.with_own_laws(known)

    @property
    def is_used(self) -> tuple[bool, ...]:
        """Whether each of the recent events belongs."""
        return tuple([weight > 0.0 for weight in self.weights])

    @property
    def is_unlike_type(self) -> bool:
        """Whether the first events have led further from their type than vehicles are: docs/model.md, (25c)."""
        return self.may_begin_again and self.fusion.distance > MOST_UNLIKE

    def begun_again(self) -> "Posterior":
        """Return the state before the first event, which does not begin again a second time."""
        nothing = fuse(self.base, Evidence.none())
        return replace(self, recent=(), weights=(), fusion=nothing, scatter=EventScatter(), may_begin_again=False)

    def without(self, place: int) -> Knowledge:
        """Return the posterior without one of the recent events."""
        weights = [0.0 if other == place else weight for other, weight in enumerate(self.weights)]
        return fuse(self.base, together(self.recent, weights)).knowledge

    @property
    def shift_counts(self) -> tuple[int, int]:
        """Events that the friction of clutch 1 and 2 rests on."""
        used = [event.clutch for event, is_used in zip(self.recent, self.is_used, strict=True) if is_used]
        return self.folded_counts[0] + used.count(1), self.folded_counts[1] + used.count(2)

    @property
    def shift_count(self) -> int:
        """Events that the friction of either clutch rests on."""
        return sum(self.shift_counts)

    def with_event(self, event: JudgedEvent, earlier: "Posterior | None" = None) -> "Posterior":
        """Return the state after an event, judged together with all recent ones.

        ``earlier`` is what `with_oldest_folded` returns, where that is known.
        """
        recent = (*self.recent, event)
        judged = judge(self.base, recent)
        state = replace(self, recent=recent, weights=judged.weights, fusion=judged.fusion)
        if judged.first_changed is not None:
            state = _changed(state, judged.first_changed)
        elif len(recent) > RECENT_COUNT:
            if earlier is None or judged.is_used[0] != self.is_used[0]:
                earlier = _folded(state, 1)
            state = _together(replace(earlier, recent=recent[1:], weights=judged.weights[1:]))
            # Where all belong they do so beside an older base, too: it differs by the drift of one event.
            evidences = [recent.evidence for recent in state.recent]
            is_sure = all(judged.is_used) and is_cheap(state.fusion.chi_square, evidences)
            state = state if is_sure else _judged(state)
        if not any(state.weights[-1:]):
            return state
        return replace(state, scatter=self.scatter.with_event(state.fusion.knowledge, event, state.weights[-1]))

    def with_oldest_folded(self) -> "Posterior":
        """Return the same with room for one more event: of sixteen the oldest is in the base, if it belongs as yet."""
        return self if len(self.recent) < RECENT_COUNT else _together(_folded(self, 1))

    def agrees_with(self, earlier: "Posterior") -> bool:
        """Return whether of all but the newest event the same is believed as in ``earlier``, without that event."""
        if self.base is not earlier.base or len(self.weights) != len(earlier.weights) + 1:
            return False
        return all((now > 0.0) == (then > 0.0) for now, then in zip(self.weights, earlier.weights, strict=False))

    def with_new_fluid(self) -> "Posterior":
        """Return the state after a fluid fill: friction is unknown again, and its baseline with it; the rest stays."""
        folded = _folded(self, len(self.recent))
        base = after_change(after_change(folded.base, 1), 2)
        return _judged(replace(folded, base=base, folded_counts=(0, 0), baselines=(None, None)))

    def to_json(self) -> JsonObject:
        """Return the state as JSON-ready values; floats survive the round trip bit by bit."""
        plain = to_plain(replace(self, recent=()))
        plain |= {"apart": self.scatter.apart, "apart_by_chance": self.scatter.by_chance}
        stored = {name: plain[name] for name in _STORED}
        return {"format": STATE_FORMAT, "recent": [_stored(event) for event in self.recent]} | stored

    @classmethod
    def from_json(cls, table: Mapping[str, object], calibration: Calibration) -> "Posterior":
        """Rebuild a state saved by `to_json` under the same calibration.

        Raises
        ------
        ValueError
            If the table is not such a state.
        """
        if table.get("format") != STATE_FORMAT:
            raise ValueError(f"running state of format {table.get('format')!r}, expected {STATE_FORMAT}")
        blank = cls.fresh(calibration)
        try:
            stored = from_plain({name: table[name] for name in _STORED if name in table}, _Stored)
            recent = tuple(map(_restored, from_plain(table["recent"], list[_StoredEvent])))
        except (KeyError, TypeError, ValueError) as exc:
            raise ValueError(f"not a running state: {exc}") from exc
        if len(recent) > RECENT_COUNT:
            raise ValueError(f"not a running state: more than {RECENT_COUNT} recent events")
        if not all(0.0 <= value < math.inf for value in (stored.apart, stored.apart_by_chance)):
            raise ValueError("not a running state: bad scatter of events")
        shapes = {"mean": (PARAMETER_COUNT,), "covariance": (PARAMETER_COUNT, PARAMETER_COUNT)}
        for record, expected in (
            (stored.base, shapes),
            *((baseline, SHAPES) for baseline in stored.baselines if baseline is not None),
        ):
            for name, shape in expected.items():
                value = getattr(record, name)
                if value.shape != shape or not np.all(np.isfinite(value)):
                    raise ValueError(f"not a running state: bad {name} of a {type(record).__name__}")
        # An earlier version stored no weights: what belonged counted in full.
        kept = judge(stored.base, recent).is_used if stored.weights is None else stored.weights
        if len(kept) != len(recent) or not all(0.0 <= weight <= 1.0 for weight in kept):
            raise ValueError("not a running state: bad weights of recent events")
        told = {name: getattr(stored, name) for name in _STORED if not name.startswith("apart")}
        told |= {"weights": tuple(map(float, kept)), "scatter": EventScatter(stored.apart, stored.apart_by_chance)}
        return _together(replace(blank, recent=recent, **told))


def _together(state: Posterior) -> Posterior:
    """Return the state with what its base and those events say that are used."""
    return replace(state, fusion=fuse(state.base, together(state.recent, state.weights)))


def _judged(state: Posterior) -> Posterior:
    judged = judge(state.base, state.recent)
    return replace(state, weights=judged.weights, fusion=judged.fusion)


def _changed(state: Posterior, first: int) -> Posterior:
    """Return the state after the friction of a clutch changed with the recent event in this place."""
    clutch = state.recent[first].clutch
    state = _folded(state, first)
    counts = with_clutch(state.folded_counts, clutch, 0)
    return _judged(replace(state, base=after_change(state.base, clutch), folded_counts=counts))


def _folded(state: Posterior, count: int) -> Posterior:
    """Return the state with the oldest recent events in the base, as far as they belong; its fusion stays as it was."""
    base, counts, baselines = state.base, state.folded_counts, state.baselines
    for event, weight in zip(state.recent[:count], state.weights, strict=False):
        if not weight:
            continue
        news = fuse(base, event.evidence.weighted(weight))
        base = news.knowledge.less_sure(_DRIFT)
        baselines = both_clutches(baseline and baseline.after(news.error_transition) for baseline in baselines)
        counts = with_clutch(counts, event.clutch, counts[event.clutch - 1] + 1)
        shift_count, baseline = counts[event.clutch - 1], baselines[event.clutch - 1]
        if baseline is not None:
            baseline = replace(baseline, later_count=baseline.later_count + 1)
        elif shift_count >= BASELINE_SHIFT_COUNT:
            baseline = Baseline.of(event.clutch, base, end_ns=event.end_ns, count=shift_count)
        baselines = with_clutch(baselines, event.clutch, baseline)
    return replace(
        state,
        base=base,
        recent=state.recent[count:],
        weights=state.weights[count:],
        folded_counts=counts,
        baselines=baselines,
        may_begin_again=state.may_begin_again and not count,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stored:
    """The members of a state that are stored as they are."""

    base: Knowledge
    folded_counts: tuple[int, int]
    baselines: tuple[Baseline | None, Baseline | None]
    packs: PackTemperatures | None
    weights: tuple[float, ...] | None = None  # None: of an earlier version, which did not store them
    apart: float = 0.0
    apart_by_chance: float = 0.0
    may_begin_again: bool = False  # of an earlier version, which did not begin again


_STORED: Final = tuple(_Stored.__dataclass_fields__)


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredEvent:
    """An event in a store: of the information matrix, which is symmetric, one half."""

    clutch: int
    end_ns: int
    lower: FloatArray
    vector: FloatArray
    constant: float
    count: int


def _stored(event: JudgedEvent) -> JsonObject:
    evidence = event.evidence
    return {
        "clutch": event.clutch,
        "end_ns": event.end_ns,
        "lower": evidence.matrix[_LOWER].tolist(),
        "vector": evidence.vector.tolist(),
        "constant": evidence.constant,
        "count": evidence.count,
    }


def _restored(stored: _StoredEvent) -> JudgedEvent:
    if (
        stored.lower.shape != (len(_LOWER[0]),)
        or stored.vector.shape != (PARAMETER_COUNT,)
        or stored.clutch not in {1, 2}
    ):
        raise ValueError("an event of another kind")
    numbers = np.concatenate((stored.lower, stored.vector, [stored.constant]))
    if not np.all(np.isfinite(numbers)):
        raise ValueError("an event that is not finite")
    matrix = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
    matrix[_LOWER] = stored.lower
    return JudgedEvent(
        clutch=stored.clutch,
        end_ns=stored.end_ns,
        evidence=Evidence(
            matrix=matrix + np.tril(matrix, -1).T, vector=stored.vector, constant=stored.constant, count=stored.count
        ),
    )


MODEL_STD_RATIO = 0.004  # by which a real clutch differs from the law alike in all events: they do not average it out
MODELLED_STD_RATIO = 0.05  # likewise of a modelled torque: what goes with it does so along a curve, not a line
_GAIN = STATE_COUNT + Considered.TORQUE_GAIN
_WIDTH = STATE_COUNT + Considered.STRIBECK_SPEED
_DIFFERENCE: Final = np.array([1.0, -1.0])  # of mu_c and mu_s
_AREAS = (STATE_COUNT + Considered.PISTON_AREA1, STATE_COUNT + Considered.PISTON_AREA2)
_FRICTION_AND_GAIN = np.ix_([*range(FRICTION_COUNT), _GAIN], [*range(FRICTION_COUNT), _GAIN])  # of a covariance


class _Pair(NamedTuple):
    """Both friction coefficients of a clutch, times a factor, with their covariance."""

    mu: FloatArray  # (2,) mu_c, mu_s
    covariance: FloatArray  # (2, 2)

    @classmethod
    def of(cls, known: Knowledge, clutch: int, place: int, factor: float, slope: float) -> Self:
        """Return them, times a factor that has some slope over the parameter in this place; (34)."""
        rows = [2 * clutch - 2, 2 * clutch - 1, place]
        own = known.mean[rows[:2]]
        by = np.column_stack((factor * np.eye(2), slope * own))  # of what is returned, by both and the parameter
        mu, model = factor * own, np.diag((MODEL_STD_RATIO * factor * own) ** 2)
        return cls(mu, by @ known.covariance[np.ix_(rows, rows)] @ by.T + model)

    def with_common(self, ratio: float) -> Self:
        """Return them less certain, both alike."""
        return type(self)(self.mu, self.covariance + np.outer(ratio * self.mu, ratio * self.mu))


def friction(state: Posterior, clutch: int) -> FrictionEstimate:
    """Return the friction of clutch 1 or 2 as now estimated."""
    return both_frictions(state, clutch, state.stated)[0]


def both_frictions(state: Posterior, clutch: int, known: Knowledge) -> tuple[FrictionEstimate, ScaleFreeFriction]:
    """Return the friction of clutch 1 or 2, and what `scale_free` says of it.

    ``known`` is what is stated of a vehicle, or what one event says with what is known of all but its friction.
    """
    area = _AREAS[clutch - 1]
    free = _Pair.of(known, clutch, area, 1.0 + float(known.mean[area]), 1.0)
    if state.torque is not TorqueSource.MEASURED:
        free = free.with_common(MODELLED_STD_RATIO)
    gain = state.torque_gain + float(known.mean[_GAIN])
    pair = _Pair.of(known, clutch, _GAIN, 1.0 / gain, -1.0 / gain**2)
    width = state.stribeck_speed_rad_s[clutch - 1] * (1.0 + float(known.mean[_WIDTH]))
    (mu_c, mu_s), (free_c, free_s) = pair.mu.tolist(), free.mu.tolist()
    std_c, std_s = np.sqrt(pair.covariance.diagonal()).tolist()
    free_std_c, free_std_s = np.sqrt(free.covariance.diagonal()).tolist()
    difference = NormalDist(mu_c - mu_s, math.sqrt(float(_DIFFERENCE @ pair.covariance @ _DIFFERENCE)))
    scaled = FrictionEstimate(
        mu_c=mu_c,
        mu_s=mu_s,
        std_mu_c=std_c,
        std_mu_s=std_s,
        correlation=float(pair.covariance[0, 1]) / (std_c * std_s),
        random_std_mu_c=mu_c * free_std_c / free_c,
        random_std_mu_s=mu_s * free_std_s / free_s,
        slope_s_rad=difference.mean / width,
        std_slope_s_rad=difference.stdev / width,
        probability_negative_slope=difference.cdf(0.0),
    )
    return scaled, ScaleFreeFriction(
        mu_c=free_c,
        mu_s=free_s,
        std_mu_c=free_std_c,
        std_mu_s=free_std_s,
        correlation=float(free.covariance[0, 1]) / (free_std_c * free_std_s),
    )


def scale_free(state: Posterior, clutch: int) -> ScaleFreeFriction:
    """Return the friction of clutch 1 or 2 times the true gain of the torque reading and the true piston area.

    The area counts as a ratio to what the calibration says.
    """
    return both_frictions(state, clutch, state.stated)[1]


def common_margin(state: Posterior, known: Knowledge, new_margins: tuple[float, float]) -> NormalDist:
    """Return which part of ``mu_C - mu_S`` of new fluid is left if both clutches, which slip in one oil, lost the same.

    ``known`` is what is stated, ``new_margins`` are those of new fluid. The better known clutch weighs more, by its
    variance; what both share is in the deviation.
    """
    gain = state.torque_gain + float(known.mean[_GAIN])
    c_1, s_1, c_2, s_2 = known.mean[:FRICTION_COUNT].tolist()
    by_1, by_2 = 1.0 / (gain * new_margins[0]), 1.0 / (gain * new_margins[1])
    left_1, left_2 = by_1 * (c_1 - s_1), by_2 * (c_2 - s_2)
    slope = np.array([[by_1, -by_1, 0.0, 0.0, -left_1 / gain], [0.0, 0.0, by_2, -by_2, -left_2 / gain]])
    (first, both), (_, second) = (slope @ known.covariance[_FRICTION_AND_GAIN] @ slope.T).tolist()
    first += (MODEL_STD_RATIO * by_1 * math.hypot(c_1, s_1)) ** 2
    second += (MODEL_STD_RATIO * by_2 * math.hypot(c_2, s_2)) ** 2
    weight_1, weight_2 = second / (first + second), first / (first + second)
    variance = weight_1**2 * first + 2.0 * weight_1 * weight_2 * both + weight_2**2 * second
    return NormalDist(weight_1 * left_1 + weight_2 * left_2, math.sqrt(variance))


def common_scale_std_ratio(state: Posterior, clutch: int) -> float:
    """Return the relative deviation of gain times piston area: what all friction of clutch 1 or 2 shares, for good."""
    known, places = state.fusion.knowledge, [_GAIN, _AREAS[clutch - 1]]
    by = 1.0 / (np.array([state.torque_gain, 1.0]) + known.mean[places])
    return math.sqrt(float(by @ known.covariance[np.ix_(places, places)] @ by))


def trend(state: Posterior, clutch: int) -> FrictionTrend | None:
    """Return what became of the friction of clutch 1 or 2 since its baseline, or None before there is one.

    The deviation is that of the difference: errors which both have are not in it.
    """
    if (baseline := state.baselines[clutch - 1]) is None:
        return None
    later_count = baseline.later_count + state.shift_counts[clutch - 1] - state.folded_counts[clutch - 1]
    if later_count <= 0:
        return None
    known, rows = state.fusion.knowledge, FRICTION_ROWS[clutch - 1]
    gain = state.torque_gain + float(known.mean[_GAIN])
    now, then = known.mean[rows], baseline.mean
    doubt = 0.0 if state.torque is TorqueSource.MEASURED else MODELLED_STD_RATIO
    both = (state.fusion.error_transition @ baseline.cross)[rows].diagonal()
    of_now, of_then = known.covariance[rows, rows].diagonal(), baseline.covariance.diagonal()
    std = np.sqrt(np.maximum(of_now + of_then - 2.0 * both, 0.0))  # (36)
    by_now, by_then = 1.0 / then, now / then**2
    std_ratio = np.sqrt(np.maximum(by_now**2 * of_now + by_then**2 * of_then - 2.0 * by_now * by_then * both, 0.0))
    change_c, change_s = ((now - then) / gain).tolist()
    ratio_c, ratio_s = (now / then - 1.0).tolist()  # (35)
    std_c, std_s = (std / gain).tolist()
    std_ratio_c, std_ratio_s = np.hypot(std_ratio, doubt).tolist()
    return FrictionTrend(
        change_mu_c=change_c,
        change_mu_s=change_s,
        std_change_mu_c=std_c,
        std_change_mu_s=std_s,
        change_mu_c_ratio=ratio_c,
        change_mu_s_ratio=ratio_s,
        std_change_mu_c_ratio=std_ratio_c,
        std_change_mu_s_ratio=std_ratio_s,
        baseline_end_bus_ns=baseline.end_ns,
        baseline_shift_count=baseline.shift_count,
        later_shift_count=later_count,
    )


def clutch_ratio(known: Knowledge) -> ClutchRatio:
    """Return the friction of clutch 1 over that of clutch 2, of what is stated; docs/model.md, (37)."""
    mean, covariance = known.mean.tolist(), known.covariance[:FRICTION_COUNT, :FRICTION_COUNT].tolist()
    ratios = []
    for first, second in ((State.MU_C1, State.MU_C2), (State.MU_S1, State.MU_S2)):
        ratio, above, below = mean[first] / mean[second], covariance[first][first], covariance[second][second]
        shared = (above - 2.0 * ratio * covariance[first][second] + ratio**2 * below) / mean[second] ** 2
        ratios.append((ratio, math.sqrt(max(shared, 0.0) + 2.0 * (MODEL_STD_RATIO * ratio) ** 2)))
    (ratio_c, std_c), (ratio_s, std_s) = ratios
    return ClutchRatio(mu_c_ratio=ratio_c, mu_s_ratio=ratio_s, std_mu_c_ratio=std_c, std_mu_s_ratio=std_s)


_LEARNT: Final = np.array((
    State.TORQUE_OFFSET, State.TOUCH1, State.TOUCH2, State.ZERO1, State.ZERO2, STATE_COUNT + Considered.VISCOSITY,
    STATE_COUNT + Considered.TORQUE_LATENCY, STATE_COUNT + Considered.PRESSURE_LATENCY,
))  # fmt: skip
"""What ordinary shifts tell; gain of torque and piston areas they do not."""
_AMONG_NUISANCES: Final = (_LEARNT - FRICTION_COUNT).tolist()
_KNOWN_STDS: Final = (0.8, 2.4e3, 2.4e3, 500.0, 500.0, 0.03, 8e-4, 1.4e-3)  # a type that is known like this is known


def calibration_ratio(state: Posterior, calibration: Calibration) -> float:
    """Return by how much the deviations of sensors, oil and latencies have shrunk from those of the type, 0 to 1."""
    variances, stds = state.fusion.knowledge.covariance[_LEARNT, _LEARNT].tolist(), type_std(calibration)
    rows = zip(variances, [stds[row] for row in _AMONG_NUISANCES], _KNOWN_STDS, strict=True)
    left = [math.sqrt(now) / std if std > known else 0.0 for now, std, known in rows]
    return sum([1.0 - min(ratio, 1.0) for ratio in left]) / len(left)
