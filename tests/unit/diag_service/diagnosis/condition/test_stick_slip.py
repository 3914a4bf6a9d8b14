"""Launches that judder: what counts, what is remembered, and what that says of the slope."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason, EventKind, Shudder
from clutch_results.records import Condition, ShiftEstimate, StickSlip
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.condition import ConditionMemory, judge
from diag_service.diagnosis.condition.shift_indices import measure
from diag_service.diagnosis.condition.verdict import LAUNCH_WINDOW, Launches, RunningScatter
from diag_service.diagnosis.events import Event
from tests.support.builders import shift_estimate
from tests.unit.diag_service.diagnosis.condition.test_condition import believed

CALIBRATION = nominal_calibration()
STEP_NS = 10_000_000
T_S = np.arange(0.0, 3.5, 0.01)
SWING_HZ = 12.0
NOISE_RAD_S = 0.3
LOADED_PA, EMPTY_PA = 6e5, 0.0


def launch(swing_rad_s: float, *, pressure_pa: FloatArray | float = LOADED_PA, sign: float = 1.0) -> Event:
    """Return a launch whose clutch sticks after 2 s and then swings open for half a second."""
    closing_rad_s = np.clip(60.0 * (1.0 - T_S / 2.0), 0.0, None)
    swing = swing_rad_s * np.abs(np.sin(2.0 * np.pi * SWING_HZ * T_S)) * ((T_S > 2.1) & (T_S < 2.6))
    noise = np.random.default_rng(1).normal(0.0, NOISE_RAD_S, len(T_S))
    columns = {
        Signal.HUB_SPEED: series(200.0 + sign * (closing_rad_s + swing) + noise),
        Signal.INPUT1_SPEED: series(200.0),
        Signal.CLUTCH1_PRESSURE: series(pressure_pa),
    }
    return Event(
        kind=EventKind.LAUNCH, number=1, from_gear=1, to_gear=1, start_ns=0, end_ns=3_000_000_000,
        end_reason=EndReason.COMPLETE, columns=columns, bad_frame_count=0,
    )  # fmt: skip


def series(value: FloatArray | float) -> Series:
    rows = np.arange(len(T_S), dtype=np.int64)
    return Series(t_ns=rows * STEP_NS, sequence=rows, value=np.broadcast_to(np.asarray(value, float), T_S.shape).copy())


def launched(*reslips_rad_s: float | None) -> ConditionMemory:
    memory = ConditionMemory()
    for reslip_rad_s in reslips_rad_s:
        memory = memory.with_launch(told(reslip_rad_s))
    return memory


def told(reslip_rad_s: float | None) -> ShiftEstimate:
    indices = replace(measure(launch(0.0), CALIBRATION), reslip_rad_s=reslip_rad_s)
    return replace(shift_estimate(), clutch=1, kind=EventKind.LAUNCH, end_reason=EndReason.COMPLETE, indices=indices)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("swing_rad_s", [6.0, 12.0])
def test_slip_that_comes_back_is_measured(swing_rad_s: float, sign: float) -> None:
    found = measure(launch(swing_rad_s, sign=sign), CALIBRATION).reslip_rad_s
    assert found == pytest.approx(swing_rad_s, abs=0.1 * swing_rad_s + 2.0 * NOISE_RAD_S)


def test_noise_and_a_clutch_that_was_let_go_are_none() -> None:
    still = measure(launch(0.0), CALIBRATION).reslip_rad_s
    assert still is not None
    assert still < 4.0 * NOISE_RAD_S
    opened = launch(12.0, pressure_pa=np.where(T_S < 2.05, LOADED_PA, EMPTY_PA))
    assert measure(opened, CALIBRATION).reslip_rad_s == pytest.approx(still, abs=NOISE_RAD_S)


def test_judder_adds_to_what_friction_says_of_the_slope() -> None:
    unsure = believed(0.1290, 0.1305, std=0.001)  # slope negative with probability 0.85
    assert judge(launched(0.2, 8.0), unsure, 1, CALIBRATION)[1].condition is Condition.WATCH
    _, verdict = judge(launched(0.2, 8.0, 9.0), unsure, 1, CALIBRATION)
    assert verdict.condition is Condition.CHANGE_FLUID
    assert "2 of 3 launches juddered" in verdict.reason
    assert verdict.stick_slip == StickSlip(launch_count=3, judder_count=2)


def test_judder_alone_is_no_verdict_but_it_holds_back_a_good_one() -> None:
    new = believed(0.14, 0.119)
    assert judge(launched(0.2, 8.0), new, 1, CALIBRATION)[1].condition is Condition.GOOD
    _, verdict = judge(launched(*[12.0] * LAUNCH_WINDOW), new, 1, CALIBRATION)
    assert verdict.condition is Condition.NO_VERDICT
    assert verdict.advice is not None
    assert "it slips again after it has stuck" in verdict.advice


@pytest.mark.parametrize(("count", "odds"), [(1, 1.0), (2, 10.0), (3, 20.0), (9, 20.0)])
def test_judder_is_a_witness_of_bounded_weight(count: int, odds: float) -> None:
    negative = Launches(juddered=(True,) * count + (False,) * 5).probability_negative(0.5)
    assert negative / (1.0 - negative) == pytest.approx(odds)


def test_twenty_launches_are_remembered_and_noise_is_no_judder() -> None:
    memory = launched(*[8.0] * 5, *[5.1] * 15, *[5.3] * 3).launches[0]
    assert memory.reported == StickSlip(launch_count=20, judder_count=5)


@pytest.mark.parametrize(("seen", "windows", "swung"), [(2, 10, 0), (3, 10, 1), (3, 100, 0), (4, 100, 1)])
def test_a_stretch_swings_by_windows_and_by_their_share(seen: int, windows: int, swung: int) -> None:
    shudder = Shudder(window_count=windows, seen_count=seen, frequency_hz=None, amplitude_rad_s=0.0)
    assert Launches().with_swings(shudder).reported == StickSlip(launch_count=1, judder_count=swung)


@pytest.mark.parametrize(("name", "sound"), [("variance_mu_c", ()), ("variance_mu_s", ()), ("shift_count", (0, 1))])
def test_a_scatter_that_no_shifts_have_is_damaged(name: str, sound: tuple[int, ...]) -> None:
    scatter = RunningScatter(variance_mu_c=1e-6, variance_mu_s=1e-6, shift_count=0)
    assert tuple(value for value in (-1, 0, 1) if replace(scatter, **{name: value}).is_possible) == sound
