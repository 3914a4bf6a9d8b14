"""What drives tell of a vehicle: nothing else than they show, with deviations that fit, in bounded memory."""

import numpy as np
import numpy.typing as npt
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping import learning
from diag_service.mapping.learning import LearnedVehicle, VehicleSurvey
from diag_service.mapping.vehicle_file import described, description_toml

RATIOS = (10.0, 7.0, 5.0, 3.8)
ROW_S = 0.037
TOUCH_PA = 1.4e5


def series(t_s: FloatArray, value: npt.NDArray[np.floating]) -> Series:
    return Series(
        t_ns=np.round(t_s * 1e9).astype(np.int64), sequence=np.full(len(t_s), -1), value=value.astype(np.float64)
    )


def drive(
    gears: FloatArray, *, skew_s: float = 0.0, noise: float = 0.3, is_swapped: bool = False, slows: bool = False
) -> ColumnBatch:
    """Return a car that speeds up in each gear in turn, 200 rows each, after it stood in the first one.

    Where it ``slows``, it does so in the second half of each gear.
    """
    rng = np.random.default_rng(1)
    gear = np.concatenate((np.full(100, gears[0]), np.repeat(gears, 200)))
    t_s: FloatArray = np.arange(len(gear), dtype=np.float64) * ROW_S
    row = np.arange(len(gear)) - 100
    faster = 0.3 * (100 - np.abs(row % 200 - 100)) if slows else 0.3 * row
    output = np.where(row < 0, 0.0, 40.0 + faster)
    ratio = np.array(RATIOS)[gear.astype(int) - 1]
    later = np.interp(t_s + skew_s, t_s, output)
    engine = np.where(output > 0.0, later * ratio, 120.0) + rng.normal(0.0, noise, len(gear))
    is_odd = (gear % 2 == 1) ^ is_swapped
    closed = np.where(output > 0.0, 6e5, TOUCH_PA) + rng.normal(0.0, 1e3, len(gear))
    columns = {
        Signal.ENGINE_SPEED: series(t_s, engine),
        Signal.OUTPUT_SPEED: series(t_s, output),
        Signal.TARGET_GEAR: series(t_s, gear),
        Signal.CLUTCH1_PRESSURE: series(t_s, np.where(is_odd, closed, 0.0)),
        Signal.CLUTCH2_PRESSURE: series(t_s, np.where(is_odd, 0.0, closed)),
    }
    return ColumnBatch(columns=columns, watermark_ns=int(t_s[-1] * 1e9))


def learned(*batches: ColumnBatch) -> LearnedVehicle:
    survey = VehicleSurvey(Signal.OUTPUT_SPEED)
    for batch in batches:
        survey.add(batch)
    return survey.learned()


def without(batch: ColumnBatch, *signals: Signal) -> ColumnBatch:
    columns = {signal: one for signal, one in batch.columns.items() if signal not in signals}
    return ColumnBatch(columns=columns, watermark_ns=batch.watermark_ns)


EVERY_GEAR = np.array([1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("skew_s", [0.0, 0.03])
def test_ratios_and_clutches_are_found_whatever_columns_are_apart(skew_s: float) -> None:
    found = learned(drive(EVERY_GEAR, skew_s=skew_s))
    assert found.ratios is not None
    assert found.ratios.ratios == pytest.approx(RATIOS, rel=5e-3)
    assert [found.gears[gear].clutch for gear in (1, 2, 3, 4)] == [1, 2, 1, 2]
    for gear, ratio in enumerate(RATIOS, 1):
        one = found.gears[gear].ratio
        assert abs(one.ratio - ratio) < 3.0 * one.std


def test_a_deviation_is_what_stretches_differ_by_not_their_samples() -> None:
    found = learned(drive(np.tile(EVERY_GEAR, 6), skew_s=0.03, slows=True))
    for gear, ratio in enumerate(RATIOS, 1):
        one = found.gears[gear].ratio
        assert abs(one.ratio - ratio) < 2.0 * one.std < 4e-4 * ratio


def test_a_held_touch_point_is_told_and_the_other_one_is_assumed() -> None:
    found = learned(drive(EVERY_GEAR))
    assert found.touch_pa.keys() == {1}
    assert found.touch_pa[1].value == pytest.approx(TOUCH_PA, rel=0.01)
    other = found.touch_point(2)
    assert other is not None
    assert (other.origin, other.std) == ("assumed, as of clutch 1", learning.TYPE_STD_PA)
    calibration = described(found, nominal_calibration(), "car")
    assert [one.touch_pressure_pa for one in calibration.clutches] == pytest.approx([TOUCH_PA] * 2, rel=0.01)


def test_without_pressures_and_commands_nothing_is_said_of_clutches() -> None:
    found = learned(without(drive(EVERY_GEAR), Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE))
    assert {one.clutch for one in found.gears.values()} == {None}
    assert (found.touch_pa, found.lag_s, found.gain_rad_s2_pa) == ({}, {}, {})
    assert described(found, nominal_calibration(), "car").clutches == nominal_calibration().clutches
    assert "# from the log" not in description_toml(found, nominal_calibration(), "car", ()).partition("[gears]")[0]


def test_a_lag_is_found_behind_a_command() -> None:
    batch = drive(EVERY_GEAR)
    t_s = np.arange(0.0, 30.0, 0.01)
    asked = 4e5 + 1e5 * np.sin(3.0 * t_s)
    behind = 4e5 + 1e5 * np.sin(3.0 * (t_s - 0.04))
    asked[t_s < 5.0], behind[t_s < 7.0] = 3e5, 1e5  # a pack that is being filled is behind by its oil
    columns = {
        **batch.columns,
        Signal.CLUTCH1_PRESSURE: series(t_s, behind),
        Signal.CLUTCH1_PRESSURE_COMMAND: series(t_s, asked),
    }
    many = [ColumnBatch(columns=columns, watermark_ns=batch.watermark_ns)] * 5
    assert learned(*many).lag_s[1].value == pytest.approx(0.04, abs=0.003)
    assert learned(*many).lag_s[1].std == pytest.approx(0.0065)  # by the age of what is sent every 10 ms
