import numpy as np
import pytest

from ecu_emulator.plant.drive import DriveSettings, cycle_table
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.shift_control import tcu, tcu_data
from ecu_emulator.shift_control.tcu_data import ClutchActuation

CONTROL = nominal_parameters().control
CYCLES = cycle_table(DriveSettings(), CONTROL)
ACTUATION = ClutchActuation(
    touch_pressure_pa=(1.3e5, 1.5e5), pressure_per_torque_pa_nm=(2.0e3, 3.0e3), inertia_kg_m2=0.24
)


class Controller:
    """The control in 2nd gear with its arrays; a test changes what it is about."""

    def __init__(self, gear: int = 2) -> None:
        self.memory = np.zeros(tcu_data.MEMORY_COUNT)
        self.sense = np.zeros(tcu_data.SENSE_COUNT)
        self.commands = np.zeros(tcu_data.COMMAND_COUNT)
        self.memory[[tcu_data.CURRENT_GEAR, tcu_data.TARGET_GEAR]] = gear
        self.memory[tcu_data.IS_DRIVING] = 1.0
        self.memory[tcu_data.DWELL] = 2.0
        self.memory[tcu_data.INPUT_TORQUE] = 100.0
        self.sense[tcu_data.ENGINE_TORQUE] = 100.0
        self.sense[tcu_data.ENGINE_SPEED] = 250.0
        self.put_gear(0, 3)
        self.put_gear(1, gear)

    def put_gear(self, shaft: int, gear: int) -> None:
        self.sense[tcu_data.SHAFT_GEAR + shaft] = self.commands[tcu_data.WANTED_GEAR + shaft] = gear
        self.sense[tcu_data.IS_ENGAGED + shaft] = 1.0 if gear else 0.0

    def run(self, milliseconds: int = 1) -> None:
        for _ in range(milliseconds):
            tcu.control(self.memory, self.sense, self.commands, CYCLES, ACTUATION, CONTROL)

    def enter(self, phase: int, target: int = 3) -> None:
        self.memory[tcu_data.TARGET_GEAR] = target
        tcu.enter_phase(self.memory, phase)


def test_a_held_clutch_gets_more_than_the_engine_gives() -> None:
    controller = Controller()
    controller.run()
    capacity_nm = 1.5 * 100.0 + 70.0
    assert controller.commands[tcu_data.TORQUE_COMMAND + 1] == pytest.approx(capacity_nm)
    assert controller.commands[tcu_data.PRESSURE + 1] == pytest.approx(1.5e5 + 3.0e3 * capacity_nm)
    assert controller.commands[tcu_data.PRESSURE] == 0.0


def test_an_upshift_waits_for_speed_dwell_and_gear() -> None:
    controller = Controller()
    controller.run()
    assert controller.memory[tcu_data.PHASE] == tcu_data.HOLD
    controller.sense[tcu_data.ENGINE_SPEED] = 321.0
    controller.memory[tcu_data.DWELL] = 0.5
    controller.run()
    assert controller.memory[tcu_data.PHASE] == tcu_data.HOLD
    controller.memory[tcu_data.DWELL] = 2.0
    controller.sense[tcu_data.IS_ENGAGED] = 0.0
    controller.run()
    assert controller.memory[tcu_data.PHASE] == tcu_data.HOLD
    controller.sense[tcu_data.IS_ENGAGED] = 1.0
    controller.run()
    assert controller.memory[tcu_data.PHASE] == tcu_data.PREFILL
    assert controller.memory[tcu_data.TARGET_GEAR] == 3


def test_prefill_stops_at_the_touch_point_once_full() -> None:
    controller = Controller()
    controller.enter(tcu_data.PREFILL)
    controller.run()
    assert controller.commands[tcu_data.PRESSURE] == 7.0e5
    controller.sense[tcu_data.FILL] = 0.85
    controller.run()
    controller.sense[tcu_data.FILL] = 0.75
    controller.run()
    assert controller.commands[tcu_data.PRESSURE] == pytest.approx(1.3e5 + 0.1e5)
    controller.run(220)
    assert controller.memory[tcu_data.PHASE] == tcu_data.TORQUE


def test_torque_moves_over_and_the_old_clutch_is_dumped() -> None:
    controller = Controller()
    controller.enter(tcu_data.TORQUE)
    controller.run(150)
    assert controller.commands[tcu_data.TORQUE_COMMAND] == pytest.approx(0.5 * 108.0)
    assert controller.commands[tcu_data.TORQUE_COMMAND + 1] == pytest.approx(1.08 * 0.5 * 108.0)
    controller.run(145)
    assert controller.commands[tcu_data.PRESSURE + 1] == 0.0


def test_flare_is_caught_by_the_off_going_clutch() -> None:
    calm, flaring = Controller(), Controller()
    for controller, slip_rad_s in ((calm, 2.0), (flaring, 8.0)):
        controller.enter(tcu_data.TORQUE)
        controller.sense[tcu_data.SLIP + 1] = slip_rad_s
        controller.run(100)
    extra_nm = flaring.commands[tcu_data.TORQUE_COMMAND + 1] - calm.commands[tcu_data.TORQUE_COMMAND + 1]
    assert extra_nm == pytest.approx(6.0 * (8.0 - 3.0))


def test_the_slip_reference_goes_smoothly_to_zero_and_beyond() -> None:
    assert tcu.slip_reference(0.0, 80.0, 0.42, CONTROL) == pytest.approx((80.0, 0.0))
    slip_rad_s, rate = tcu.slip_reference(0.21, 80.0, 0.42, CONTROL)
    assert slip_rad_s == pytest.approx(40.0)
    assert rate == pytest.approx(-1.5 * 80.0 / 0.42)
    assert tcu.slip_reference(0.42 + 0.2, 80.0, 0.42, CONTROL) == pytest.approx((-5.0, -25.0))
    assert tcu.slip_reference(0.42 + 2.0, -80.0, 0.42, CONTROL) == pytest.approx((12.0, 0.0))
