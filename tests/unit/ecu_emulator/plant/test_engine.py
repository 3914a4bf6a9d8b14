import math

import pytest

from ecu_emulator.plant.engine import (
    cylinder_air_kg_rad,
    engine_losses_nm,
    indicated_torque_nm,
    manifold_rate_pa_s,
    throttle_flow_kg_s,
)
from ecu_emulator.plant.parameters import nominal_parameters

ENGINE = nominal_parameters().engine
AIR_K = 300.0


def test_an_open_throttle_passes_the_most_air() -> None:
    assert throttle_flow_kg_s(1.0, ENGINE) == pytest.approx(ENGINE.max_air_flow_kg_s)
    assert 0.0 < throttle_flow_kg_s(0.0, ENGINE) < 0.02 * ENGINE.max_air_flow_kg_s


def test_the_cylinders_draw_a_displacement_every_two_turns() -> None:
    per_cycle_kg = cylinder_air_kg_rad(1.0e5, AIR_K, ENGINE) * 4.0 * math.pi
    density_kg_m3 = 1.0e5 / (287.0 * AIR_K)
    assert per_cycle_kg == pytest.approx(ENGINE.volumetric_efficiency_ratio * ENGINE.displacement_m3 * density_kg_m3)


def test_the_manifold_fills_behind_an_open_throttle_and_empties_behind_a_closed_one() -> None:
    assert manifold_rate_pa_s(0.3e5, throttle_flow_kg_s(0.5, ENGINE), 150.0, AIR_K, ENGINE) > 0.0
    assert manifold_rate_pa_s(0.9e5, throttle_flow_kg_s(0.0, ENGINE), 300.0, AIR_K, ENGINE) < 0.0


def test_full_load_torque_is_that_of_a_3_8_litre_engine() -> None:
    torque_nm = indicated_torque_nm(0.97e5, 1.0, 0.0, AIR_K, ENGINE) - engine_losses_nm(0.97e5, 300.0, ENGINE)
    assert 250.0 < torque_nm < 350.0


def test_spark_scales_combustion() -> None:
    whole, half = (indicated_torque_nm(0.8e5, spark, 0.0, AIR_K, ENGINE) for spark in (1.0, 0.5))
    assert half == pytest.approx(0.5 * whole)


def test_ripple_fires_three_times_per_turn() -> None:
    rippled = ENGINE._replace(ripple_ratio=0.5)
    mean = indicated_torque_nm(0.8e5, 1.0, 0.0, AIR_K, ENGINE)
    assert indicated_torque_nm(0.8e5, 1.0, math.pi / 6.0, AIR_K, rippled) == pytest.approx(1.5 * mean)
    assert indicated_torque_nm(0.8e5, 1.0, math.pi / 2.0, AIR_K, rippled) == pytest.approx(0.5 * mean)
