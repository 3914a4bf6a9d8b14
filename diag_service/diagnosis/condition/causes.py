"""Why a vehicle is as it is: what moved with what since the beginning, held against what each cause moves.

Two stretches of driving are kept: the first events, and the last, in which older ones fade. What each says of all
parameters of the vehicle follows from the evidence of its events; how its pressures follow their commands is measured
in each event. The difference of both stretches is one vector with its covariance; so is that of the last one and the
type, for what was there before the first event. A cause is a small Gaussian in that
space: what a strength of 1 changes, with how much that differs from car to car (`causes.toml`, fitted to simulated
fleets by ``python -m studies.causes --fit``). Bayes' rule does the rest, for each cause, for pairs of them, for none
and for something else. docs/verdict.md.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration
from clutch_results.records import Causes, LikelyCause, Moved
from clutchdiag_io.people import STDS
from diag_service.diagnosis.condition.condition import FILLED_COUNT, LOWER, MEASURED, SENSORS, Stretch, VehicleCourse
from diag_service.diagnosis.friction.evidence import FRICTION_COUNT, NAMES, PARAMETER_COUNT, State
from diag_service.diagnosis.friction.posterior import Posterior

SURE: Final = 0.9  # probability: below it a cause is not named without a doubt, as a repair costs
SOUND, ELSE = "sound", "something-else"
FEATURES: Final = (
    "level1", "slope1", "level2", "slope2", *NAMES[FRICTION_COUNT:],
    *(f"{name.rpartition('_')[0]}{clutch}" for clutch in (1, 2) for name in MEASURED), "scatter",
)  # fmt: skip
COUNT: Final = len(FEATURES)
_PLACE: Final = {name: place for place, name in enumerate(FEATURES)}
MIRRORED: Final = [_PLACE[name.translate({ord("1"): "2", ord("2"): "1"})] for name in FEATURES]
_FIRST_MEASURED, _SCATTER = _PLACE["pressure_lag1"], _PLACE["scatter"]


class Change(NamedTuple):
    """What moved between two stretches."""

    mean: FloatArray  # (COUNT,)
    covariance: FloatArray  # (COUNT, COUNT)
    shown: FloatArray  # (COUNT,) which part of a true change shows, 0 to 1


class Signature(NamedTuple):
    """What a cause moves."""

    cause: str
    clutch: int | None
    mean: FloatArray  # (COUNT,) by a strength of 1
    spread: FloatArray  # (COUNT,) standard deviation of that from car to car
    prior: float


class Hypotheses(NamedTuple):
    """What a change is held against, n of them: causes that are there together, with a mean strength."""

    causes: Sequence[tuple[tuple[str, int | None], ...]]
    means: FloatArray  # (n, COUNT) where all of a change shows
    roots: FloatArray  # (n, COUNT, 2) of its covariance, by the strengths
    spreads: FloatArray  # (n, COUNT) root of the rest of it, a diagonal
    log_priors: FloatArray
    is_new_fluid: BoolArray


STRENGTHS: Final = ((1.0, 0.35), (2.0, 0.6), (3.5, 1.0))  # mean and deviation of what is expected
PAIR_STRENGTH: Final = (2.0, 0.9)  # likewise of two causes that are there together
PAIR_SHARE: Final = 0.05  # of a second cause beside a first one
MOST_PAIRED: Final = 3  # of the likeliest causes each is tried with all others
MODEL_SHARE: Final = 0.25  # of a signature: laws that no simulated car has
STRETCHED: Final = 0.8  # deviations of changes against those that are stated: sound cars move by 0.6 of them
UNFILLED_COST: Final = 8.0  # of another fluid where nobody has noted a fill
NEW_STD: Final = np.array([0.02, 0.015])  # of level and slope among clutches of one type with new fluid
LEAST_SHOWN: Final = 0.2  # part of a change that shows: parameters of which events tell less are left out
TAILS: Final = 8.0  # degrees of freedom: what is far off is not next to impossible
LEAST_TOLD: Final = 0.005  # probability: what is less likely rounds to nothing
MOST_MOVED: Final = 6  # quantities in the picture
LEAST_RENEWED: Final = 1e-9  # ratio: renewed fluid is never ruled out, so that logarithms stay finite
SHOWN_STD: Final = 1.5  # deviations from which on something is said to have moved
_OF_FLUID: Final = frozenset({"aged-fluid", "water", "air"})
_AGED, _RENEWED = ("aged-fluid", None), ("renewed-fluid", None)
_FILLED: Final = frozenset({"wrong-fluid", "renewed-fluid"})  # there at once, with a fill
_ELSE_FLOORS: Final = (1.5, 3.0, 6.0, 16.0)  # by how many times what sound cars move something else moves


@cache
def described() -> Mapping[str, Any]:
    """Return the words of all causes, and what each moves."""
    folder = files("diag_service").joinpath("diagnosis/condition")
    words, numbers = (
        tomllib.loads(folder.joinpath(name).read_text(encoding="utf-8")) for name in ("causes.toml", "signatures.toml")
    )
    return {**words, **numbers}


def signatures(table: Mapping[str, Any]) -> list[Signature]:
    """Return the signatures of all causes, of either clutch and either sign."""
    all_signs = []
    for cause, words in table["cause"].items():
        mean, spread = np.zeros(COUNT), np.zeros(COUNT)
        way = -1.0 if "opposite_of" in words else 1.0
        for name, (size, its_spread) in table["moves"][words.get("opposite_of", cause)].items():
            mean[_PLACE[name]], spread[_PLACE[name]] = way * size, its_spread
        signs = (1.0, -1.0) if words["is_either_way"] else (1.0,)
        clutches = ((1, 0.5), (2, 0.5)) if words["is_of_one_clutch"] else ((None, 1.0),)
        for sign in signs:
            for clutch, share in clutches:
                order = MIRRORED if clutch == 2 else slice(None)
                prior = words["prior"] * share / len(signs)
                all_signs.append(Signature(cause, clutch, sign * mean[order], spread[order], prior))
    return all_signs


class CauseJudge:
    """Says why the vehicle of a calibration is as it is.

    Parameters
    ----------
    calibration
        Of the vehicle.
    table
        Words and signatures of causes; None: those that ship.
    """

    def __init__(self, calibration: Calibration, table: Mapping[str, Any] | None = None) -> None:
        self._table = described() if table is None else table
        fresh = Posterior.fresh(calibration).base
        self._type_mean = fresh.mean
        least = 1e-12 * np.diag(np.maximum(fresh.covariance.diagonal(), 1.0))
        self._precision = np.linalg.inv(fresh.covariance + least)
        self._type = _as_described(fresh.mean)
        self._floor = np.array([self._table["floor"].get(name, 1e-5) for name in FEATURES]) ** 2
        self.signatures = signatures(self._table)
        self._means = np.array([signature.mean for signature in self.signatures])
        self._spreads = np.array([np.hypot(one.spread, MODEL_SHARE * one.mean) for one in self.signatures])
        self._priors = np.array([signature.prior for signature in self.signatures])
        unknown, count = list(self._unknown()), len(self.signatures)
        known = [self._together([(n,) for n in range(count)], strength) for strength in STRENGTHS]
        none = np.zeros((len(unknown), COUNT, 2))
        self._singles = Hypotheses(
            causes=(
                *(((cause, None),) for cause, *_ in unknown),
                *(pairing for some in known for pairing in some.causes),
            ),
            means=np.concatenate((none[:, :, 0], *(some.means for some in known))),
            roots=np.concatenate((none, *(some.roots for some in known))),
            spreads=np.concatenate((np.array([spread for _, spread, _ in unknown]), *(some.spreads for some in known))),
            log_priors=np.log(
                np.concatenate(([prior for *_, prior in unknown], *([self._priors / len(STRENGTHS)] * len(STRENGTHS))))
            ),
            is_new_fluid=np.concatenate((none[:, 0, 0] > 0.0, *(some.is_new_fluid for some in known))),
        )

    def _unknown(self) -> Iterator[tuple[str, FloatArray, float]]:
        """Yield that nothing moved, and what something else may have moved: word, deviations, prior."""
        prior_else = self._table["prior_else"]
        yield SOUND, np.zeros(COUNT), 1.0 - self._priors.sum() - prior_else
        moved, stems = set[frozenset[int]](), [name.rstrip("12") for name in FEATURES]
        both = [frozenset(n for n, stem in enumerate(stems) if stem in names) for names in self._table["together"]]
        for places in both:
            moved |= {frozenset(n for n in places if FEATURES[n][-1] != clutch) for clutch in "012"}
        moved |= {places | other for places, other in combinations(both, 2)} | {frozenset([n]) for n in range(COUNT)}
        for places in sorted(moved, key=sorted):
            for times in _ELSE_FLOORS:
                spread = times * np.sqrt(self._floor) * [place in places for place in range(COUNT)]
                yield ELSE, spread, prior_else / len(moved) / len(_ELSE_FLOORS)

    def _together(self, some: Sequence[tuple[int, ...]], strength: tuple[float, float]) -> Hypotheses:
        """Return that signatures of one place or of two are there together, each of this strength."""
        places = np.array(some, dtype=int).reshape(len(some), -1)
        means, roots = self._means[places], np.zeros((len(some), COUNT, 2))
        roots[:, :, : places.shape[1]] = strength[1] * means.transpose(0, 2, 1)
        shared = PAIR_SHARE / self._priors.sum() if places.shape[1] > 1 else 1.0
        pairings = [tuple((self.signatures[n].cause, self.signatures[n].clutch) for n in places) for places in some]
        return Hypotheses(
            causes=pairings,
            means=strength[0] * means.sum(axis=1),
            roots=roots,
            spreads=strength[0] * np.sqrt((self._spreads[places] ** 2).sum(axis=1)),
            log_priors=np.log(shared * self._priors[places].prod(axis=1)),
            is_new_fluid=np.array([any(cause in _FILLED for cause, _ in pairing) for pairing in pairings], dtype=bool),
        )

    def change(self, begun: Stretch, now: Stretch) -> Change:
        """Return what moved between two stretches.

        Both start from what the type tells, and what no event tells stays so: the errors that both have cancel.
        """
        (first, first_std), (last, last_std) = self._known(begun), self._known(now)
        shared = first_std @ self._precision @ last_std
        covariance = first_std + last_std - shared - shared.T
        turn = np.eye(PARAMETER_COUNT)
        for mu_c in (State.MU_C1, State.MU_C2):
            turn[mu_c, mu_c] = 1.0 / first[mu_c]
            turn[mu_c + 1, mu_c], turn[mu_c + 1, mu_c + 1] = -1.0 / first[mu_c], 1.0 / first[mu_c + 1]
        mean, whole, shown = np.zeros(COUNT), np.zeros((COUNT, COUNT)), np.ones(COUNT)
        mean[:PARAMETER_COUNT] = turn @ (last - first)
        whole[:PARAMETER_COUNT, :PARAMETER_COUNT] = turn @ covariance @ turn.T
        shown[:PARAMETER_COUNT] -= np.clip(last_std.diagonal() * self._precision.diagonal(), 0.0, 1.0)
        hidden = np.flatnonzero(shown < LEAST_SHOWN)
        mean[hidden], shown[hidden], whole[hidden, :], whole[:, hidden] = 0.0, 0.0, 0.0, 0.0
        whole[hidden, hidden] = 1.0
        for clutch in (0, 1):
            for row in range(len(MEASURED)):
                place = _FIRST_MEASURED + len(MEASURED) * clutch + row
                (value_1, variance_1), (value_2, variance_2) = (
                    _mean(stretch.sums[clutch, row]) for stretch in (begun, now)
                )
                if math.isfinite(variance_1 + variance_2):
                    mean[place], whole[place, place] = value_2 - value_1, variance_1 + variance_2
                else:
                    whole[place, place], shown[place] = 1.0, 0.0
        mean[_SCATTER], whole[_SCATTER, _SCATTER], shown[_SCATTER] = _scattered(begun, now)
        return Change(mean, STRETCHED**2 * whole + np.diag(self._floor), shown)

    def _known(self, stretch: Stretch) -> tuple[FloatArray, FloatArray]:
        """Return what a stretch and the type tell of the parameters."""
        matrix = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
        matrix[LOWER] = stretch.lower
        covariance = np.linalg.inv(self._precision + matrix + np.tril(matrix, -1).T).astype(np.float64)
        return covariance @ (self._precision @ self._type_mean + stretch.vector), covariance

    def probabilities(
        self, course: VehicleCourse, log_renewed: float = 0.0
    ) -> tuple[dict[tuple[str, int | None], float], Change]:
        """Return how likely each cause is, alone or with another, and what moved.

        ``log_renewed`` is the logarithm of how much less likely renewed fluid is for what the first events were.
        """
        change, filled = self.change(course.begun, course.now), course.filled
        is_filled = filled is not None and filled.count >= FILLED_COUNT
        early = self.change(course.begun, filled) if filled is not None and is_filled else None
        logs = _logs(self._singles, change, early)
        count = len(self.signatures)
        best = logs[-len(STRENGTHS) * count :].reshape(len(STRENGTHS), count).max(axis=0)
        ranked = np.argsort(-best, kind="stable").tolist()
        pairs = self._together(
            [
                (first, other)
                for place, first in enumerate(ranked[:MOST_PAIRED])
                for other in ranked[place + 1 :]
                if self.signatures[first].cause != self.signatures[other].cause
            ],
            PAIR_STRENGTH,
        )
        every = (*self._singles.causes, *pairs.causes)
        logs = np.concatenate((logs, _logs(pairs, change, early)))
        logs += log_renewed * np.array([_RENEWED in causes for causes in every])
        shares = np.exp(logs - logs.max())
        shares /= shares.sum()
        by_cause: dict[tuple[str, int | None], float] = {(SOUND, None): 0.0, (ELSE, None): 0.0}
        for share, causes in zip(shares.tolist(), every, strict=True):
            for cause in causes:
                by_cause[cause] = by_cause.get(cause, 0.0) + share
        return by_cause, change

    def from_the_beginning(self, now: Stretch) -> tuple[dict[tuple[str, int | None], float], Change]:
        """Return how likely each cause was there before the first event, by how the vehicle is unlike its type.

        Sensors are not accused: a scale that is off from the beginning looks like another friction. Nor is what fits no
        cause: another type is no fault.
        """
        by_cause, change = self.probabilities(VehicleCourse(begun=self._type, now=now))
        earlier = {key: share for key, share in by_cause.items() if key[0] not in {*SENSORS, *_FILLED, SOUND, ELSE}}
        return earlier, change

    def judge(self, course: VehicleCourse) -> Causes:
        """Return the causes, the likeliest first: of what has changed and, so far as nothing has, of what was there."""
        by_cause, change = self.probabilities(course)
        if by_cause.get(_RENEWED, 0.0) >= LEAST_TOLD:  # only what was aged is renewed
            was_aged = self.from_the_beginning(course.begun)[0].get(_AGED, LEAST_RENEWED)
            ratio = min(max(was_aged / self._table["cause"][_AGED[0]]["prior"], LEAST_RENEWED), 1.0)
            by_cause, change = self.probabilities(course, math.log(ratio))
        unchanged, earlier = by_cause[SOUND, None], set[tuple[str, int | None]]()
        before, unlike = self.from_the_beginning(course.now) if unchanged >= LEAST_TOLD else ({}, change)
        for key, share in before.items():
            if unchanged * share > by_cause.get(key, 0.0):
                earlier.add(key)
            by_cause[key] = by_cause.get(key, 0.0) + unchanged * share
        by_cause[SOUND, None] = unchanged * max(1.0 - sum(before.values()), 0.0)
        likely = tuple(
            LikelyCause(
                cause=key[0],
                clutch=key[1],
                probability=min(share, 1.0),
                evidence=("There from the beginning. " if key in earlier else "")
                + self._evidence(*key, unlike if key in earlier else change),
            )
            for key, share in sorted(by_cause.items(), key=lambda item: -item[1])
            if share >= LEAST_TOLD
        )
        return Causes(
            event_count=course.event_count - round(course.begun.count),
            likely=likely,
            advice=self._advice(likely),
            test=self.test_between(likely),
            moved=self._moved(likely[0], unlike if (likely[0].cause, likely[0].clutch) in earlier else change),
        )

    def _expected(self, cause: str, clutch: int | None, change: Change) -> tuple[FloatArray, FloatArray]:
        """Return what a cause moves, in the strength that fits best, and the deviation of that from car to car."""
        std = np.sqrt(change.covariance.diagonal())
        signature = max(
            (signature for signature in self.signatures if (signature.cause, signature.clutch) == (cause, clutch)),
            key=lambda signature: float((signature.mean * change.mean / std**2).sum()),
            default=None,
        )
        if signature is None:
            return np.zeros(COUNT), np.zeros(COUNT)
        moves = signature.mean * change.shown
        strength = float((moves * change.mean / std**2).sum() / max((moves**2 / std**2).sum(), 1e-9))
        strength = min(max(strength, 0.5), 4.0)
        return strength * moves, strength * (signature.spread + MODEL_SHARE * np.abs(moves))

    def _moved(self, first: LikelyCause, change: Change) -> tuple[Moved, ...]:
        """Return what moved most, or should have by the likeliest cause, by their deviations."""
        std, (expected, _) = np.sqrt(change.covariance.diagonal()), self._expected(first.cause, first.clutch, change)
        sizes = np.where(change.shown > 0.0, np.maximum(np.abs(change.mean), np.abs(expected)) / std, 0.0)
        return tuple(
            Moved(
                quantity=words,
                unit=unit,
                change=factor * float(change.mean[place]),
                std=abs(factor) * float(std[place]),
                expected=factor * float(expected[place]),
            )
            for place in np.argsort(-sizes, kind="stable")[:MOST_MOVED].tolist()
            if sizes[place] > 0.0
            for words, unit, factor in [_named(place)]
        )

    def _evidence(self, cause: str, clutch: int | None, change: Change) -> str:
        """Return what speaks for a cause and what against it."""
        std, (expected, spread) = np.sqrt(change.covariance.diagonal()), self._expected(cause, clutch, change)
        away, moved = np.abs(change.mean - expected) / np.hypot(std, spread), np.abs(change.mean) / std
        awaited = np.abs(expected) / std
        is_shown = change.shown > 0.0
        pro = is_shown & (awaited > SHOWN_STD) & (moved > SHOWN_STD) & (expected * change.mean > 0.0)
        contra = is_shown & (away > 2.0) & ((awaited > SHOWN_STD) | (moved > 2.0 * SHOWN_STD))
        if cause == ELSE:
            pro, contra = contra, pro
        for_it = _listed(change, std, expected, np.where(pro, moved, 0.0), 3)
        against = _listed(change, std, expected, np.where(contra, away, 0.0), 2)
        if cause == SOUND and not against:
            for_it = "nothing moved by more than it does in sound cars"
        return f"For it: {for_it or 'nothing by itself'}. Against it: {against or 'nothing'}."

    def _advice(self, likely: Sequence[LikelyCause]) -> str:
        """Return what to do, and what it costs to be wrong."""
        first = likely[0]
        words = self._table["cause"].get(first.cause)
        if words is None:
            return str(self._table["advice"][first.cause])
        of = "" if first.clutch is None else f" of clutch {first.clutch}"
        if first.probability < SURE:
            return f"Not sure yet: it may be {words['name']}{of} ({100.0 * first.probability:.0f} %)."
        return f"{words['name'].capitalize()}{of}: {words['advice']} If that is wrong: {words['if_wrong']}"

    def test_between(self, likely: Sequence[LikelyCause]) -> str | None:
        """Return what would tell the likeliest two from each other, if driving does not."""
        names = [signature.cause for signature in likely if signature.cause != ELSE][:2]
        if likely[0].probability >= SURE or len(names) < 2:
            return None
        first, second = (self._table["cause"].get(name, {"name": "a sound car"})["name"] for name in names)
        for test in self._table["test"]:
            outcomes = [test["outcome"].get(name, test["else"]) for name in names]
            if outcomes[0] != outcomes[1]:
                return (
                    f"Cannot be told from driving; this would tell {first} from {second}: {test['name']} "
                    f"({outcomes[0]}, or {outcomes[1]})."
                )
        return None


def _as_described(mean: FloatArray) -> Stretch:
    """Return what a drive without end would say of friction, if the clutches were as their type with new fluid."""
    matrix = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
    for mu_c in (State.MU_C1, State.MU_C2):
        turn = np.array([[1.0, 0.0], [-1.0, 1.0]]) / mean[[mu_c, mu_c + 1]]  # to level and slope
        matrix[mu_c : mu_c + 2, mu_c : mu_c + 2] = turn.T @ np.diag(NEW_STD**-2.0) @ turn
    return Stretch(count=math.inf, lower=matrix[LOWER], vector=matrix @ mean)


def _logs(some: Hypotheses, change: Change, early: Change | None) -> FloatArray:
    """Return the logarithm of prior times likelihood of some hypotheses.

    ``early`` is what moved between the beginning and the first events after a fill: what is of the fluid is then gone,
    another fluid is there at once, and what is of the clutch may have been there before.
    """
    logs: FloatArray = some.log_priors + _likelihoods(some, change)
    if early is None:
        return logs - UNFILLED_COST * some.is_new_fluid
    since_fill, new = _likelihoods(some, early), float(_likelihoods(_NOTHING, early)[0])
    for place, causes in enumerate(some.causes):
        names = {cause for cause, _ in causes}
        if names & _FILLED:
            logs[place] += since_fill[place]
        elif names <= _OF_FLUID:
            logs[place] += new
        else:
            logs[place] += float(np.logaddexp(new, since_fill[place])) - math.log(2.0)
    return logs


_BORDER: Final = 1e12  # above any squared distance: a factor's last row is what is away, whitened
_NOTHING: Final = Hypotheses(
    causes=(((SOUND, None),),), means=np.zeros((1, COUNT)), roots=np.zeros((1, COUNT, 2)), spreads=np.zeros((1, COUNT)),
    log_priors=np.zeros(1), is_new_fluid=np.zeros(1, dtype=bool),
)  # fmt: skip


def _likelihoods(some: Hypotheses, change: Change) -> FloatArray:
    """Return the logarithm of how likely a change is by each hypothesis, but for what all have."""
    shown = np.flatnonzero(change.shown > 0.0)  # the rest is the same by all
    count, part_shown, mean, covariance = len(shown), change.shown[shown], change.mean[shown], change.covariance
    covariance = covariance[np.ix_(shown, shown)]
    spreads, is_known = some.spreads[:, shown] * part_shown, some.roots.any(axis=(1, 2))
    far, scales = np.empty(len(spreads)), np.empty(len(spreads))
    far[~is_known], scales[~is_known] = _scattered_far(spreads[~is_known], mean, covariance)
    roots = some.roots[np.ix_(is_known, shown)] * part_shown[:, None]
    stack = np.empty((len(roots), count + 1, count + 1))
    stack[:, count, count] = _BORDER
    stack[:, :count, :count] = covariance + roots @ roots.transpose(0, 2, 1)
    stack[:, range(count), range(count)] += spreads[is_known] ** 2
    stack[:, count, :count] = mean - some.means[np.ix_(is_known, shown)] * part_shown
    far[is_known], scales[is_known] = _factored(stack)
    logs: FloatArray = -0.5 * (TAILS + COUNT) * np.log1p(far / TAILS) - scales  # Student's law: no car is simulated
    return logs


def _factored(stack: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return squared distances, and half the logarithms of determinants, of bordered covariances: of lower halves."""
    factors = np.linalg.cholesky(stack)
    scales: FloatArray = np.log(factors.diagonal(axis1=1, axis2=2)[:, :-1]).sum(axis=1)
    return (factors[:, -1, :-1] ** 2).sum(axis=1), scales


def _scattered_far(spreads: FloatArray, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same of hypotheses that only widen some places, by the formula of Woodbury: there are many."""
    std = np.sqrt(covariance.diagonal())
    away, whole = mean / std, covariance / np.outer(std, std)
    inverse, alone = np.linalg.inv(whole), (spreads / std) ** 2
    most = int((alone > 0.0).sum(axis=1).max(initial=0))
    places = np.argsort(alone <= 0.0, axis=1, kind="stable")[:, :most]
    alone = np.take_along_axis(alone, places, axis=1)
    is_moved = alone > 0.0
    alone[~is_moved] = 1.0
    stack = np.empty((len(alone), most + 1, most + 1))
    stack[:, most, most] = _BORDER
    is_pair = is_moved[:, :, None] & is_moved[:, None, :]
    stack[:, :most, :most] = np.where(is_pair, inverse[places[:, :, None], places[:, None, :]], 0.0)
    stack[:, range(most), range(most)] += 1.0 / alone
    stack[:, most, :most] = np.where(is_moved, (inverse @ away)[places], 0.0)
    nearer, scales = _factored(stack)
    scales += 0.5 * np.log(alone).sum(axis=1) + 0.5 * np.linalg.slogdet(whole)[1] + np.log(std).sum()
    return away @ inverse @ away - nearer, scales


def _mean(sums: FloatArray) -> tuple[float, float]:
    """Return mean and variance of the mean; the latter is infinite where too few events tell."""
    weight, total, square = sums.tolist()
    if weight < LEAST_WEIGHT:
        return 0.0, math.inf
    mean = total / weight
    return mean, max(square / weight - mean * mean, 0.0) / weight * weight / (weight - 1.0)


def _scattered(begun: Stretch, now: Stretch) -> tuple[float, float, float]:
    """Return by how much single events scatter more, as a logarithm, with its variance, and whether that is told."""
    logs, variance = 0.0, 0.0
    for stretch, sign in ((begun, -1.0), (now, 1.0)):
        spread, count = 0.0, 0.0
        for clutch in (0, 1):
            weight, total, square = stretch.sums[clutch, -1].tolist()
            if weight >= LEAST_WEIGHT:
                spread, count = spread + square - total * total / weight, count + weight - 1.0
        if count < LEAST_WEIGHT:
            return 0.0, 1.0, 0.0
        logs += sign * 0.5 * math.log(max(spread / count, 1e-8))
        variance += 0.5 / count
    return logs, variance, 1.0


def _listed(change: Change, std: FloatArray, expected: FloatArray, weight: FloatArray, most: int) -> str:
    """Return in words what moved most, of what has a weight."""
    parts = []
    for place in np.argsort(-weight)[:most].tolist():
        if weight[place] > 0.0:
            words, unit, factor = _named(place)
            moved, off, due = (factor * float(vector[place]) for vector in (change.mean, STDS * std, expected))
            text = f"{_rounded(moved, 2):+g} ± {_rounded(abs(off), 1):g} {unit} (expected {_rounded(due, 2):+g})"
            parts.append(f"{words} {text}")
    return "; ".join(parts)


def _named(place: int) -> tuple[str, str, float]:
    """Return the words for a feature, with a unit and what makes it of ours."""
    words, unit, factor = _WORDS[FEATURES[place].rstrip("12")]
    return words + (f" of clutch {FEATURES[place][-1]}" if FEATURES[place][-1] in "12" else ""), unit, factor


def _rounded(value: float, digits: int) -> float:
    """Return a number with as many digits that tell something: 220, not 2.2e+02."""
    return float(f"{value:.{digits}g}")


LEAST_WEIGHT: Final = 4.0  # events that tell how a pressure follows
_WORDS: Final = {  # in words, with a unit and what makes it of ours
    "level": ("friction", "%", 100.0),
    "slope": ("mu_S over mu_C", "%", 100.0),
    "torque_offset": ("torque zero", "Nm", 1.0),
    "touch": ("touch point", "bar", 1e-5),
    "zero": ("pressure zero", "bar", 1e-5),
    "torque_gain": ("torque scale", "%", 100.0),
    "engine_inertia": ("engine inertia", "%", 100.0),
    "piston_area": ("piston area", "%", 100.0),
    "viscosity": ("viscosity", "%", 100.0),
    "torque_latency": ("torque latency", "ms", 1e3),
    "pressure_latency": ("pressure latency", "ms", 1e3),
    "motoring_gain": ("coasting torque", "%", 100.0),
    "stribeck_speed": ("width of the friction curve", "%", 100.0),
    "contact_stiffness": ("lining stiffness", "%", 100.0),
    "shaft_inertia": ("shaft inertia", "%", 100.0),
    "film_mobility": ("speed of the film", "%", 100.0),
    "stribeck_exponent": ("form of the friction curve", "%", 100.0),
    "friction_temperature": ("friction over temperature", "%/K", 100.0),
    "open_drag": ("drag of open clutches", "%", 100.0),
    "pressure_lag": ("lag of the pressure", "ms", 1e3),
    "pressure_reach": ("pressure per command", "%", 100.0),
    "pressure_short": ("highest pressure below its command", "bar", 1e-5),
    "fill_time": ("filling time", "ms", 1e3),
    "believed_touch": ("touch point that the control uses", "bar", 1e-5),
    "scatter": ("scatter of single events", "%", 100.0),
}
