"""What drives tell of a vehicle: the ratios of gears whose rows scatter, as on rough ground."""

from collections.abc import Mapping

import numpy as np
import pytest

from canlog.arrays import FloatArray, Int64Array, Series
from diag_service.api.learning import summary_lines
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping.learning import LearnedVehicle, VehicleSurvey

# Engine over output, of a real six-speed side-by-side.
RATIOS: FloatArray = np.array([10.11, 7.42, 5.75, 4.46, 3.51, 2.89])
ROW_S = 0.037
ROWS = 600  # of a gear
SLIPPING = 0.35  # of them


def series(t_s: FloatArray, value: FloatArray) -> Series:
    t_ns = np.rint(1e9 * t_s).astype(np.int64)
    return Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=value)


def in_gear(gears: Int64Array) -> dict[Signal, FloatArray]:
    """Return what tells which gear is engaged."""
    is_odd = gears % 2 == 1
    return {
        Signal.TARGET_GEAR: gears.astype(np.float64),
        Signal.CLUTCH1_PRESSURE: np.where(is_odd, 8e5, 0.0),
        Signal.CLUTCH2_PRESSURE: np.where(is_odd, 0.0, 8e5),
    }


def told(t_s: FloatArray, values: Mapping[Signal, FloatArray]) -> LearnedVehicle:
    """Return what signals at the same times tell."""
    survey = VehicleSurvey(Signal.OUTPUT_SPEED)
    columns = {signal: series(t_s, value) for signal, value in values.items()}
    survey.add(ColumnBatch(columns=columns, watermark_ns=int(1e9 * t_s[-1]), breaks_before=False))
    return survey.learned()


def rough_drive(scatter_ratio: float, seed: int) -> LearnedVehicle:
    """Return what a drive tells that holds each gear twice, slipping at first, and whose speeds scatter row by row."""
    rng, gears = np.random.default_rng(seed), np.repeat([*range(6), *range(6)], ROWS // 2)
    t_s = np.asarray(ROW_S * np.arange(len(gears)), np.float64)
    within = np.tile(np.linspace(0.0, 1.0, ROWS // 2), 12)
    output_rad_s = 600.0 / RATIOS[gears] * (0.6 + 0.4 * within)
    slip = 1.0 + np.where(within < SLIPPING, rng.uniform(0.05, 0.4, 12).repeat(ROWS // 2) * (1.0 - within), 0.0)
    own = rng.standard_t(4, len(gears)) / np.sqrt(2.0)
    rough = 1.0 + scatter_ratio * np.asarray(np.convolve(own, [0.8, 0.6], "same"), np.float64)
    engine_rad_s = RATIOS[gears] * output_rad_s * slip
    speeds = {Signal.ENGINE_SPEED: engine_rad_s, Signal.OUTPUT_SPEED: output_rad_s * rough}
    return told(t_s, speeds | in_gear(gears + 1))


@pytest.mark.parametrize("scatter_ratio", [0.002, 0.016, 0.03])
def test_the_ratio_of_each_gear_is_found_and_its_deviation_holds(scatter_ratio: float) -> None:
    drives = [rough_drive(scatter_ratio, seed) for seed in range(12)]
    for drive in drives:
        assert list(drive.gears) == [1, 2, 3, 4, 5, 6]
        assert [one.clutch for one in drive.gears.values()] == [1, 2, 1, 2, 1, 2]
    off = [(one.ratio.ratio - RATIOS[gear - 1]) / one.ratio.std for each in drives for gear, one in each.gears.items()]
    assert np.mean(np.abs(off) < 2.0) >= 0.9
    widest = max(one.ratio.std / one.ratio.ratio for each in drives for one in each.gears.values())
    assert widest < max(0.01, 1.5 * scatter_ratio)


def test_rows_of_a_clutch_that_still_takes_over_move_no_ratio() -> None:
    t_s = np.asarray(ROW_S * np.arange(3 * ROWS), np.float64)
    gears = np.repeat([3, 2] * (ROWS // 40), 60)
    taking_over = np.where(np.arange(len(gears)) % 60 < 6, 1.04, 1.0)  # for two tenths of two seconds
    noise = np.random.default_rng(3).normal(1.0, 0.015, len(gears))
    engine_rad_s = 100.0 * RATIOS[gears - 1] * taking_over * noise
    speeds = {Signal.ENGINE_SPEED: engine_rad_s, Signal.OUTPUT_SPEED: np.full(len(gears), 100.0)}
    for gear, one in told(t_s, speeds | in_gear(gears)).gears.items():
        assert one.ratio.ratio == pytest.approx(RATIOS[gear - 1], rel=2e-3)


def test_an_engine_speed_that_is_read_later_moves_no_ratio_of_a_gear_that_only_gains_speed() -> None:
    late_s, period_s, swing = 0.1, 400 * ROW_S, 0.12
    t_s = np.asarray(ROW_S * np.arange(3 * ROWS), np.float64)
    turn = 2.0 * np.pi * t_s / period_s
    gears = np.where(turn % (2.0 * np.pi) < 0.5 * np.pi, 1, 2)
    output_rad_s, growth_1_s = 40.0 * np.exp(swing * np.sin(turn)), swing * np.cos(turn) * 2.0 * np.pi / period_s
    engine_rad_s = RATIOS[gears - 1] * output_rad_s * np.exp(-late_s * growth_1_s)
    off = np.zeros(2)
    for seed in range(12):
        scattering = output_rad_s * np.random.default_rng(seed).normal(1.0, 0.015, len(t_s))
        scattering[50:52] = 1e300, np.nan  # damaged: they cost no more than what is near them
        speeds = {Signal.ENGINE_SPEED: engine_rad_s, Signal.OUTPUT_SPEED: scattering}
        found = told(t_s, speeds | in_gear(gears)).gears
        off += [found[gear].ratio.ratio / RATIOS[gear - 1] - 1.0 for gear in (1, 2)]
    assert np.abs(off / 12.0).max() < 1e-3


def one_gear(other_rows: int = 0, *, slip: float = 0.0) -> LearnedVehicle:
    """Return what a run on a dynamometer tells: the third gear, held by clutch 1, while torque and pressure rise."""
    t_s = np.asarray(ROW_S * np.arange(400), np.float64)
    output_rad_s, torque_nm = np.linspace(40.0, 100.0, 400), np.linspace(40.0, 80.0, 400)
    gears = np.where(np.arange(400) < other_rows, 2.0, 3.0)
    open_clutch = np.where(gears == 2.0, np.linspace(1.2, 9.0, 400), 1.0)  # the other gear is never held
    values = {
        Signal.ENGINE_SPEED: RATIOS[2] * output_rad_s * np.linspace(1.0 + slip, 1.0, 400) * open_clutch,
        Signal.OUTPUT_SPEED: output_rad_s,
        Signal.ENGINE_TORQUE: torque_nm,
        Signal.TARGET_GEAR: gears,
        Signal.CLUTCH1_PRESSURE: np.full(400, 8e5),
        Signal.CLUTCH2_PRESSURE: np.zeros(400),
    }
    return told(t_s, values)


def test_a_run_in_one_gear_is_told_with_the_torque_that_its_clutch_carried() -> None:
    assert one_gear().held_run == (
        "driven in gear 3 alone, as on a dynamometer: clutch 1 was held, and it carries at least "
        "77.99 Nm at 8 bar; no shift tells its friction"
    )


def test_a_run_with_slip_or_in_two_gears_proves_no_capacity() -> None:
    assert one_gear(slip=0.6).held_run == ""
    assert one_gear(other_rows=60).held_run == ""


def test_a_driven_gear_without_a_ratio_is_called_driven() -> None:
    learned = one_gear(other_rows=60)
    assert ([*learned.gears], learned.unclosed) == ([3], {2: 60})
    assert any(line.startswith("gear 2: driven for 60 samples") for line in summary_lines(learned))
