"""The clutch temperature that the controller computes, beside the plant's; and what becomes of it on the road."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.diagnostics.clutches import heated_k, packs_of
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.drive.recording import Drive
from ecu_emulator.driving.journey import PlannedTrip
from ecu_emulator.plant import Col
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario import Truth
from tests.support.builders import drive_scenario
from tests.unit.ecu_emulator.diagnostics.test_monitors import sensed
from tests.unit.ecu_emulator.driving.drives import driven, trace

TOO_HOT = 0x27874B  # P2787
STEP_S = 0.1
PACKS = packs_of()
HARD_LAUNCHES = ((0.0, 0.0), (2.0, 0.0), (4.4, 6.0), (5.4, 6.0), (6.9, 0.0), (8.9, 0.0), (11.3, 6.0), (12.3, 6.0))
CREEP = ((0.0, 0.0), (2.0, 0.0), (4.0, 1.5), (30.0, 1.5))
LAUNCH = ((0.0, 0.0), (2.0, 0.0), (8.0, 6.0))


def known(row: np.ndarray) -> dict[str, float]:
    """Return what sensors without errors say of a row of the plant."""
    return {
        "sump_temperature_k": float(row[Col.SUMP_TEMPERATURE]),
        **{f"clutch{k}_pressure_pa": float(row[Col.PRESSURE1 + k - 1]) for k in (1, 2)},
        **{f"clutch{k}_slip_rad_s": float(row[Col.HUB_SPEED] - row[Col.INPUT1_SPEED + k - 1]) for k in (1, 2)},
    }


@pytest.mark.parametrize(("points", "grade_ratio", "most_k"), [(HARD_LAUNCHES, 0.15, 8.0), (CREEP, 0.12, 8.0)])
def test_the_computed_temperature_is_near_the_true_one(
    points: tuple[tuple[float, float], ...], grade_ratio: float, most_k: float
) -> None:
    rows = driven(trace(*points, grade_ratio=grade_ratio))[:: round(STEP_S * 1000)]
    now_k, errors_k = None, []
    for row in rows:
        now_k = heated_k(now_k, known(row), STEP_S, PACKS)
        assert now_k is not None
        errors_k.append([now_k[0] - row[Col.CLUTCH1_TEMPERATURE], now_k[1] - row[Col.CLUTCH2_TEMPERATURE]])
    warming_k = (rows[:, Col.CLUTCH1_TEMPERATURE] - rows[:, Col.SUMP_TEMPERATURE]).max()
    assert warming_k > 8.0
    assert np.abs(errors_k).max() < most_k
    assert np.abs(np.mean(errors_k)) < 0.2 * warming_k


class Judged:
    """A controller on the road, whose monitors look at its frames."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.controller = Controller(shipped_table(), values=lambda: self.values, clock=lambda: 0.0, chance=bytes)

    def drive(
        self, points: tuple[tuple[float, float], ...], *, grade_ratio: float = 0.0, mass_kg: float = 1700.0
    ) -> float:
        """Drive an operation cycle; return how warm the controller thought its clutches to be, at most."""
        monitoring, warmest_k = Monitoring(self.controller), 0.0
        for place, moment in enumerate(moments(points, grade_ratio, mass_kg)):
            self.values = moment
            if place >= 5:  # by then all messages have been sent
                monitoring.look(moment, place * STEP_S)
                warmest_k = max(warmest_k, *monitoring.temperatures.values())
        return warmest_k

    @property
    def status(self) -> Status:
        return self.controller.state.memory.records[TOO_HOT].status


def moments(points: tuple[tuple[float, float], ...], grade_ratio: float, mass_kg: float) -> Iterator[dict[str, float]]:
    scenario = replace(
        drive_scenario("ideal"), drive=DriveName.UDDS, truth=Truth(plant={"vehicle.mass_kg": mass_kg})
    )  # fmt: skip
    planned = PlannedTrip(trace=trace(*points, grade_ratio=grade_ratio), parked_s=0.0)
    for stretch in Drive(scenario, planned=iter([planned])).stretches(60.0):
        yield from sensed(stretch.frames)


def test_a_clutch_that_holds_a_trailer_on_a_slope_is_too_hot_until_it_has_cooled() -> None:
    car = Judged()
    assert car.drive(HARD_LAUNCHES, grade_ratio=0.1) < 400.0
    assert car.status == Status(0)  # tested, and sound
    car.controller.cycle()
    assert car.drive(CREEP, grade_ratio=0.2, mass_kg=3000.0) > 423.15
    failed = Status.TEST_FAILED | Status.CONFIRMED | Status.WARNING_REQUESTED
    assert car.status & failed == failed
    for _ in range(3):  # good cycles until the lamp goes out
        assert car.status & Status.WARNING_REQUESTED
        car.controller.cycle()
        car.drive(LAUNCH)
        assert not car.status & Status.TEST_FAILED
    car.controller.cycle()
    assert car.status & (Status.WARNING_REQUESTED | Status.CONFIRMED) == Status.CONFIRMED
