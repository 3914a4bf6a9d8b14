import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario.faults import Phase, SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario import Ambient, Driver, Scenario, WorkshopRoutine, production_scatter
from ecu_emulator.scenario.scenario_file import load_scenario, scenario_of, shipped_scenarios

MINIMAL = 'name = "mine"\n'
FAULT = "[[sensor_faults]]\nquantity = 'hub_speed_rad_s'\n"


def test_shipped_scenarios_load_and_are_named_like_their_files() -> None:
    assert shipped_scenarios() == ("ageing", "case1", "case2", "gs7", "ideal", "lockup", "noise_only")
    for name in shipped_scenarios():
        scenario = load_scenario(name)
        assert scenario.name == name
        assert scenario.description


def test_a_scenario_needs_only_a_name() -> None:
    assert scenario_of(tomllib.loads(MINIMAL), "text") == Scenario(name="mine")


def test_every_key_reaches_its_place() -> None:
    text = """
        name = "all"
        description = "everything"
        vehicle = "car-7"
        seed = 99
        cycles = 3
        odometer_m = 5.0
        fluid = {condition = "ageing", ageing_cycles = 7}
        driver = {pedal_ratio = 0.5, variation_ratio = 0}
        routine = {open_revs = 4, closed_revs = 20}
        ambient = {temperature_k = 280.0, oil_temperature_k = 330.0}
        startup = {ecm_s = 1.0, tcu_s = 2.0, abs_s = 3.0, ic_s = 4.0}
        scatter = {torque_gain_ratio = 0.02}
        [sensors.engine_torque]
        gain_ratio = 1.02
        offset_nm = -4.0
        noise_std_nm = 1.0
        latency_s = 0.03
        lag_s = 0.01
        [truth.calibration]
        clutch1.friction.mu_c = 0.15
        viscosity.b_k = 700.0
        [truth.plant]
        vehicle.mass_kg = 1800.0
    """
    scenario = scenario_of(tomllib.loads(text), "text")
    assert (scenario.name, scenario.vehicle, scenario.seed, scenario.cycles) == ("all", "car-7", 99, 3)
    assert (scenario.odometer_m, scenario.fluid.ageing_cycles) == (5.0, 7)
    assert scenario.driver == Driver(pedal_ratio=0.5, variation_ratio=0.0)
    assert scenario.routine == WorkshopRoutine(open_revs=4, closed_revs=20)
    assert scenario.ambient == Ambient(temperature_k=280.0, oil_temperature_k=330.0)
    assert scenario.startup.by_sender() == {"ECM": 1.0, "TCU": 2.0, "ABS": 3.0, "IC": 4.0}
    assert scenario.scatter == replace(production_scatter(), torque_gain_ratio=0.02)
    sensor = scenario.sensors["engine_torque_nm"]
    assert (sensor.gain_ratio, sensor.offset, sensor.noise_std) == (1.02, -4.0, 1.0)
    assert (sensor.latency_s, sensor.lag_s) == (0.03, 0.01)
    assert scenario.truth.calibration == {"clutch1.friction.mu_c": 0.15, "viscosity.b_k": 700.0}
    assert scenario.truth.plant == {"vehicle.mass_kg": 1800.0}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "name"),
        (MINIMAL + "seed = -1", "seed must be"),
        (MINIMAL + "cycles = 0", "cycles must be"),
        (MINIMAL + 'vehicle = "a/+"', "vehicle must be"),
        (MINIMAL + "odometer_m = -1.0", "odometer_m must be"),
        (MINIMAL + 'fluid = {condition = "new"}', r"fluid\.condition must be one of"),
        (MINIMAL + "fluid = {ageing_cycles = 0}", r"fluid\.ageing_cycles must be"),
        (MINIMAL + "driver = {pedal_ratio = 1.5}", r"driver\.pedal_ratio must be"),
        (MINIMAL + "ambient = {oil_temperature_k = 90.0}", r"ambient\.oil_temperature_k must be"),
        (MINIMAL + "routine = {open_revs = 21}", r"routine\.open_revs must be"),
        (MINIMAL + "routine = {open_revs = 2, on_request = true}", "on request the tester says how many revs"),
        (MINIMAL + "startup = {ecm_s = -1.0}", r"startup\.ecm_s must be"),
        (MINIMAL + 'scatter = "some"', "scatter must be"),
        (MINIMAL + "scatter = {viscosity_ratio = 0.9}", r"scatter\.viscosity_ratio must be"),
        (MINIMAL + "sensors.lambda.gain_ratio = 1.0", r"sensors\.lambda is unknown"),
        (MINIMAL + "sensors.hub_speed.offset_nm = 1.0", r"sensors\.hub_speed\.offset_nm is unknown"),
        (MINIMAL + "sensors.hub_speed.latency_s = -0.1", r"sensors\.hub_speed\.latency_s must be"),
        (MINIMAL + FAULT + "kind = 'offset'", "needs a finite size other than 0"),
        (MINIMAL + FAULT + "kind = 'frozen'\nsize = 2", "needs no size"),
        (MINIMAL + FAULT + "kind = 'frozen'\nphase = 'hold'", "phase must be one of prefill"),
        (MINIMAL + FAULT + "kind = 'frozen'\nshift = -1", "shift must be"),
        (MINIMAL + FAULT + "kind = 'frozen'\nstart_s = -1", "start_s must be"),
        (MINIMAL + FAULT + "kind = 'frozen'\nduration_s = 0", "duration_s must be"),
        (MINIMAL + "[[sensor_faults]]\nquantity = 'shift_phase'\nkind = 'frozen'", "has no sensor"),
        (MINIMAL + "[[bus_faults]]\nkind = 'loss'\nshare = 0", "bus_faults 1: share must be above 0"),
    ],
)
def test_a_key_that_cannot_be_used_is_named(text: str, named: str) -> None:
    with pytest.raises(EmulatorConfigError, match=named) as caught:
        scenario_of(tomllib.loads(text), "here.toml")
    assert str(caught.value).startswith("here.toml")


def test_a_file_that_is_no_toml_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("name = ", encoding="ascii")
    with pytest.raises(EmulatorConfigError, match=r"scenario .*mine\.toml is not TOML"):
        load_scenario(str(tmp_path / "mine.toml"))


def test_sensor_faults_are_read_in_their_order() -> None:
    text = MINIMAL + FAULT + "kind = 'frozen'\n" + FAULT + "kind = 'drift'\nsize = -2\nshift = 3\nphase = 'inertia'"
    frozen, drift = scenario_of(tomllib.loads(text), "text").sensor_faults
    assert frozen == SensorFault(quantity="hub_speed_rad_s", kind=SensorFaultKind.FROZEN)
    assert (drift.kind, drift.size, drift.shift, drift.phase) == (SensorFaultKind.DRIFT, -2.0, 3, Phase.INERTIA)


def test_an_unknown_scenario_lists_the_shipped_ones() -> None:
    with pytest.raises(EmulatorConfigError, match="ageing, case1, case2, gs7, ideal, lockup, noise_only"):
        load_scenario("nothing")
