"""Which of the last events are believed, and from where on a clutch is another one; events are simple on purpose."""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.evidence import (
    FRICTION_ROWS,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    JudgedEvent,
    Knowledge,
    Measurement,
    State,
    fuse,
    judge,
    prior_covariance,
    prior_mean,
    together,
)
from diag_service.diagnosis.friction.posterior import Posterior

STD = 0.001  # of friction seen in one event
MU = np.array([0.140, 0.120])


class Scaled:
    """Noise of another size than is stated."""

    def __init__(self, ratio: float) -> None:
        self._ratio, self._rng = ratio, np.random.default_rng(5)

    def normal(self, size: int) -> FloatArray:
        return self._ratio * self._rng.normal(size=size)


def base() -> Knowledge:
    calibration = nominal_calibration()
    mean = np.concatenate((prior_mean(calibration), np.zeros(PARAMETER_COUNT - len(State))))
    return Knowledge(mean=mean, covariance=prior_covariance(calibration))


def event(number: int, clutch: int, mu: FloatArray, rng: np.random.Generator, std: float = STD) -> JudgedEvent:
    """Return an event that saw friction ten times over and nothing else."""
    slope = np.zeros((20, PARAMETER_COUNT))
    slope[:, FRICTION_ROWS[clutch - 1]] = np.tile(np.eye(2), (10, 1))
    noise = np.eye(20) * (10.0 * std**2)
    at = base().mean
    seen = np.tile(mu, 10) + rng.normal(size=20) * np.sqrt(10.0) * std
    residual = seen - slope @ at
    measured = Measurement(residual=residual, jacobian=slope, covariance=noise)
    return JudgedEvent(clutch=clutch, end_ns=number, evidence=Evidence.of([measured], at))


def events(levels: Sequence[float], seed: int = 0, clutch: int = 1) -> list[JudgedEvent]:
    rng = np.random.default_rng(seed)
    return [event(number, clutch, level * MU, rng) for number, level in enumerate(levels, start=1)]


@pytest.mark.parametrize("seed", range(20))
def test_events_that_agree_are_all_believed(seed: int) -> None:
    judged = judge(base(), events([1.0] * 12, seed))
    assert all(judged.is_used)
    assert judged.first_changed is None
    error = (judged.fusion.knowledge.mean[:2] - MU) / judged.fusion.knowledge.std()[:2]
    assert np.max(np.abs(error)) < 4.5


@pytest.mark.parametrize("where", [0, 1, 5, 11])
@pytest.mark.parametrize("level", [0.9, 1.15])
def test_one_that_disagrees_is_left_out_wherever_it_comes(where: int, level: float) -> None:
    levels = [1.0] * 12
    levels[where] = level
    judged = judge(base(), events(levels))
    assert [row for row, used in enumerate(judged.is_used) if not used] == [where]


def test_two_bad_first_ones_are_found_out_by_those_after_them() -> None:
    found = [judge(base(), events([0.9, 0.9, *[1.0] * count])).is_used for count in (1, 4)]
    assert found[0][:2] == (True, True)  # two against one
    assert found[1] == (False, False, True, True, True, True)


@pytest.mark.parametrize("level", [0.94, 1.06, 0.7])
def test_three_that_agree_are_a_change(level: float) -> None:
    levels = [1.0] * 8 + [level] * 3
    assert judge(base(), events(levels[:9])).is_used[8:] == (False,)
    two = judge(base(), events(levels[:10]))
    assert two.is_used[8:] == (False, False)
    assert two.first_changed is None
    three = judge(base(), events(levels))
    assert three.first_changed == 8
    assert three.is_used[8:] == (True, True, True)
    assert three.fusion.knowledge.mean[:2] == pytest.approx(level * MU, abs=5.0 * STD)


@pytest.mark.parametrize("level", [0.98, 1.02])
def test_a_change_too_small_for_any_event_to_be_left_out_is_followed_as_well(level: float) -> None:
    quiet = cast("np.random.Generator", Scaled(0.0))
    seen = [event(number, 1, (level if number > 8 else 1.0) * MU, quiet) for number in range(1, 13)]
    for count in (9, 10):
        some = judge(base(), seen[:count])
        assert all(some.is_used[:8])  # newer ones stand out among events that do not scatter at all
        assert some.first_changed is None
    changed = judge(base(), seen[:11])
    assert changed.first_changed == 8
    assert changed.fusion.knowledge.mean[:2] == pytest.approx(level * MU, abs=4.0 * STD)


@pytest.mark.parametrize(("levels", "first_changed"), [([1.2, 1.0, 1.0], None), ([1.2, 1.2, 1.2], 9)])
def test_one_bad_event_with_two_sound_ones_that_tell_little_is_no_change(
    levels: list[float], first_changed: int | None
) -> None:
    quiet = cast("np.random.Generator", Scaled(0.2))
    both = enumerate([1.0] * 9 + levels)
    seen = [event(number, 1, level * MU, quiet, std=0.01 if number < 10 else 0.02) for number, level in both]
    assert judge(base(), seen).first_changed == first_changed


def test_a_change_of_one_clutch_leaves_the_other_alone() -> None:
    rng = np.random.default_rng(3)
    both = [
        event(number, 1 + number % 2, MU * (0.9 if number > 6 and number % 2 else 1.0), rng) for number in range(12)
    ]
    judged = judge(base(), both)
    assert judged.first_changed == 7
    assert all(used for used, one in zip(judged.is_used, both, strict=True) if one.clutch == 1)
    assert judged.fusion.knowledge.mean[:4] == pytest.approx(np.concatenate((MU, 0.9 * MU)), abs=5.0 * STD)


@pytest.mark.parametrize("count", [2, 4])
def test_bad_ones_that_agree_do_not_hide_behind_each_other(count: int) -> None:
    """Two shifts, or two of each clutch, that one wrong area would explain; each alone is hardly missed."""
    known = base()
    known.covariance[:4, :4] = np.eye(4) * STD**2
    slope = np.zeros((20, PARAMETER_COUNT))
    slope[:, STATE_COUNT + Considered.PISTON_AREA1] = 1.0 / 0.01
    noise = np.eye(20)
    far = Measurement(residual=np.full(20, 12.0), jacobian=slope, covariance=noise)
    alike = [
        JudgedEvent(clutch=1 + number % 2, end_ns=number, evidence=Evidence.of([far], known.mean))
        for number in range(count)
    ]
    judged = judge(known, alike)
    assert judged.is_used == ((False,) * 2 if count == 2 else (True,) * 4)


@pytest.mark.parametrize("ratio", [0.5, 0.7, 1.0, 1.3])
def test_by_how_much_events_differ_is_learned_from_them_and_scales_what_they_tell(ratio: float) -> None:
    rng = cast("np.random.Generator", Scaled(ratio))
    state = Posterior.fresh(nominal_calibration())
    for number in range(120):
        state = state.with_event(event(number, 1 + number % 2, MU, rng))
    learned = state.scatter.ratio
    assert learned == pytest.approx(ratio**2, abs=0.1 + 0.15 * ratio**2)
    known, told = state.fusion.knowledge.std(), state.stated.std()
    friction, gain = slice(0, 2), STATE_COUNT + Considered.TORQUE_GAIN
    assert told[friction] == pytest.approx(np.sqrt(learned) * known[friction], rel=0.01)
    assert told[gain] == pytest.approx(known[gain], rel=1e-6)  # of which they tell nothing


def test_events_that_err_alike_narrow_what_is_stated_only_so_far() -> None:
    rng, ratios = cast("np.random.Generator", Scaled(0.3)), []
    events = [event(number, 1 + number % 2, MU, rng) for number in range(60)]
    for least in (0.0, 0.5, 1.0):
        state = Posterior.fresh(nominal_calibration())
        for one in events:
            state = state.with_event(replace(one, least_scatter=least))
        ratios.append(state.scatter.ratio)
    assert ratios[0] < 0.3
    assert ratios[1:] == pytest.approx([0.5, 1.0], abs=0.1)


@pytest.mark.parametrize(("scatter", "left_out"), [(0.3, [3]), (1.0, [])])
def test_one_that_is_odd_among_many_is_left_out(scatter: float, left_out: list[int]) -> None:
    rng = cast("np.random.Generator", Scaled(scatter))
    seen = [event(number, 1 + number % 2, (1.022 if number == 3 else 1.0) * MU, rng) for number in range(12)]
    assert all(judge(base(), seen[:8]).is_used)
    assert [row for row, used in enumerate(judge(base(), seen).is_used) if not used] == left_out


def test_one_that_comes_near_to_being_odd_counts_less() -> None:
    quiet = cast("np.random.Generator", Scaled(0.0))
    seen = [event(number, 1, (1.01 if number == 3 else 1.0) * MU, quiet) for number in range(12)]
    judged = judge(base(), seen)
    assert all(judged.is_used)
    assert judged.weights[3] < 0.5
    assert min(judged.weights[:3] + judged.weights[4:]) == 1.0
    moved, moved_in_full = (
        fuse(base(), together(seen, weights)).knowledge.mean[0] - MU[0] for weights in (judged.weights, (1.0,) * 12)
    )
    assert 0.0 < moved < 0.6 * moved_in_full
    assert judged.fusion.knowledge.mean[0] == pytest.approx(MU[0] + moved, rel=1e-9)
