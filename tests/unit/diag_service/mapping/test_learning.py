"""What drives tell of a vehicle: the ratios of gears whose rows scatter, as on rough ground."""

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping.learning import LearnedVehicle, VehicleSurvey

RATIOS: FloatArray = np.array(
    [10.11, 7.42, 5.75, 4.46, 3.51, 2.89]
)  # engine over output, of a real six-speed side-by-side
ROW_S = 0.037
ROWS = 600  # of a gear
SLIPPING = 0.35  # of them


def series(t_s: FloatArray, value: FloatArray) -> Series:
    t_ns = np.rint(1e9 * t_s).astype(np.int64)
    return Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=value)


def rough_drive(scatter_ratio: float, seed: int) -> LearnedVehicle:
    """Return what a drive tells that holds each gear twice, slipping at first, and whose speeds scatter row by row."""
    rng, gears = np.random.default_rng(seed), np.repeat([*range(6), *range(6)], ROWS // 2)
    t_s = np.asarray(ROW_S * np.arange(len(gears)), np.float64)
    within = np.tile(np.linspace(0.0, 1.0, ROWS // 2), 12)
    output_rad_s = 600.0 / RATIOS[gears] * (0.6 + 0.4 * within)
    slip = 1.0 + np.where(within < SLIPPING, rng.uniform(0.05, 0.4, 12).repeat(ROWS // 2) * (1.0 - within), 0.0)
    own = rng.standard_t(4, len(gears)) / np.sqrt(2.0)
    rough = 1.0 + scatter_ratio * np.asarray(np.convolve(own, [0.8, 0.6], "same"), np.float64)
    is_odd = gears % 2 == 0
    survey = VehicleSurvey(Signal.OUTPUT_SPEED)
    values: dict[Signal, FloatArray] = {
        Signal.ENGINE_SPEED: RATIOS[gears] * output_rad_s * slip,
        Signal.OUTPUT_SPEED: output_rad_s * rough,
        Signal.TARGET_GEAR: gears + 1.0,
        Signal.CLUTCH1_PRESSURE: np.where(is_odd, 8e5, 0.0),
        Signal.CLUTCH2_PRESSURE: np.where(is_odd, 0.0, 8e5),
    }
    columns = {signal: series(t_s, value) for signal, value in values.items()}
    survey.add(ColumnBatch(columns=columns, watermark_ns=int(1e9 * t_s[-1]), breaks_before=False))
    return survey.learned()


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
