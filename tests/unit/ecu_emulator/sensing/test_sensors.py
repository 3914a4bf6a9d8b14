import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.faults import NOMINAL_SENSORS, Sensor, Sensors
from ecu_emulator.sensing import (
    BRAKE_PA_PER_M_S2,
    MEASURABLE,
    QUANTITIES,
    Installation,
    Readings,
    Schedule,
    SensorSuite,
)
from tests.unit.ecu_emulator.rows import made_up_rows

SEGMENT_RAD = 2.0 * np.pi / 3.0
PLACE = Installation(
    crank_segment_rad=SEGMENT_RAD,
    output_ratio=4.059,
    wheel_radius_m=0.32,
    ambient_temperature_k=293.15,
    odometer_m=1000.0,
)
PERFECT: Sensors = {}
HIDDEN = frozenset(Col) - MEASURABLE


def schedule(*quantities: str, cycle_ms: int = 10, phase_ms: int = 0, sender: str = "ECM") -> Schedule:
    return Schedule(message="M", sender=sender, cycle_ms=cycle_ms, phase_ms=phase_ms, quantities=quantities)


def read(
    rows: FloatArray, *schedules: Schedule, sensors: Sensors = PERFECT, startup_s: float = 0.0, seed: int = 1
) -> list[Readings]:
    suite = SensorSuite(
        schedules=schedules, sensors=sensors, installation=PLACE, startup_s={"ECM": startup_s}, seed=seed
    )
    return suite.read(rows)


def test_a_perfect_sensor_reads_the_row_of_the_send_instant() -> None:
    rows = made_up_rows(50)
    (reading,) = read(rows, schedule("hub_speed_rad_s", phase_ms=1))
    assert reading.values["hub_speed_rad_s"] == pytest.approx(rows[1::10, Col.HUB_SPEED], abs=0.0)


@pytest.mark.parametrize("latency_ms", [0.0, 0.25, 1.0, 7.5, 23.0])
def test_latency_shows_the_past_interpolated_between_rows(latency_ms: float) -> None:
    rows = made_up_rows(200)
    sensor = Sensor(latency_s=latency_ms / 1000.0)
    (reading,) = read(rows, schedule("hub_speed_rad_s"), sensors={"hub_speed_rad_s": sensor})
    expected = np.interp(reading.t_s - latency_ms / 1000.0, rows[:, Col.T_S], rows[:, Col.HUB_SPEED])
    assert reading.values["hub_speed_rad_s"] == pytest.approx(expected, rel=1e-12)


def test_lag_follows_a_step_exponentially() -> None:
    rows = made_up_rows(400)
    rows[:, Col.SUMP_TEMPERATURE] = np.where(np.arange(400) > 0, 1.0, 0.0)
    sensor = Sensor(lag_s=0.050)
    (reading,) = read(rows, schedule("sump_temperature_k"), sensors={"sump_temperature_k": sensor})
    assert reading.values["sump_temperature_k"] == pytest.approx(-np.expm1(-reading.t_s / 0.050), abs=1e-12)


def test_noise_has_the_stated_standard_deviation_and_is_white() -> None:
    rows = made_up_rows(50_000)
    (reading,) = read(rows, schedule("engine_torque_nm"), sensors={"engine_torque_nm": Sensor(noise_std=3.0)})
    noise = reading.values["engine_torque_nm"] - rows[::10, Col.ENGINE_TORQUE]
    assert noise.std() == pytest.approx(3.0, rel=0.06)
    assert abs(noise.mean()) < 4.0 * 3.0 / np.sqrt(noise.size)
    assert abs(np.mean(noise[1:] * noise[:-1])) / noise.var() < 4.0 / np.sqrt(noise.size)


def test_derived_quantities() -> None:
    rows = made_up_rows(20)
    rows[:10, Col.BRAKE] = 0.0
    names = ("output_speed_rad_s", "wheel_fl_speed_m_s", "brake_pressure_pa", "brake_light", "odometer_m",
             "ambient_temperature_k")  # fmt: skip
    (reading,) = read(rows, schedule(*names))
    expected = (
        4.059 * rows[::10, Col.DIFF_SPEED],
        0.32 * rows[::10, Col.WHEEL_SPEED],
        BRAKE_PA_PER_M_S2 * rows[::10, Col.BRAKE],
        [0.0, 1.0],
        1000.0 + rows[::10, Col.DISTANCE],
        [293.15, 293.15],
    )
    for name, values in zip(names, expected, strict=True):
        assert reading.values[name] == pytest.approx(values), name


def test_engine_speed_is_the_mean_over_the_last_crank_segment() -> None:
    rows = made_up_rows(3000)
    t_s, angle_rad = rows[:, Col.T_S], rows[:, Col.CRANK_ANGLE]
    (reading,) = read(rows, schedule("engine_speed_rad_s"))
    later = reading.t_s > 0.1
    now_s = reading.t_s[later]
    begin_s = np.interp(np.interp(now_s, t_s, angle_rad) - SEGMENT_RAD, angle_rad, t_s)
    expected = SEGMENT_RAD / (now_s - begin_s)
    assert reading.values["engine_speed_rad_s"][later] == pytest.approx(expected, rel=1e-9)


def test_only_measurable_columns_reach_the_readings() -> None:
    assert {
        Col.MU_C1, Col.MU_S1, Col.MU_C2, Col.MU_S2, Col.FILM1, Col.FILM2, Col.STICK1, Col.STICK2,
        Col.CLUTCH1_TEMPERATURE, Col.CLUTCH2_TEMPERATURE, Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE,
        Col.VISCOUS1_TORQUE, Col.VISCOUS2_TORQUE, Col.FLYWHEEL_TORQUE, Col.SHAFT1_TORQUE, Col.SHAFT2_TORQUE,
        Col.ROUTINE, Col.REV,
        Col.EVENT_KIND, Col.EVENT_NUMBER, Col.IS_ABORTED, Col.GRADE, Col.WANTED_SPEED,
        Col.IMPELLER_TORQUE, Col.TURBINE_TORQUE,
    } == HIDDEN  # fmt: skip
    rows = made_up_rows(500)
    blind = rows.copy()
    blind[:, sorted(HIDDEN)] = np.nan
    everything = schedule(*sorted(QUANTITIES))
    (seen,) = read(rows, everything, sensors=NOMINAL_SENSORS)
    (unseen,) = read(blind, everything, sensors=NOMINAL_SENSORS)
    for quantity in QUANTITIES:
        assert np.array_equal(seen.values[quantity], unseen.values[quantity]), quantity


@pytest.mark.parametrize(
    ("errors", "named"),
    [
        ({"gain_ratio": 0.0}, "gain_ratio"),
        ({"noise_std": -1.0}, "noise_std"),
        ({"latency_s": -0.001}, "latency_s"),
        ({"lag_s": 3.0}, "lag_s"),
        ({"offset": float("nan")}, "offset"),
    ],
)
def test_impossible_sensors_are_refused(errors: dict[str, float], named: str) -> None:
    with pytest.raises(EmulatorConfigError, match=named):
        Sensor(**errors)
