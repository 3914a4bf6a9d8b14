"""What each cause does to a car, how it grows, and that the truth names it."""

from dataclasses import replace

from ecu_emulator.commands import DriveOptions, choose_scenario
from ecu_emulator.drive.build import BuiltVehicle, build_vehicle, drive_truth
from ecu_emulator.drive.causes import PER_STRENGTH
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import Cause, CauseKind
from ecu_emulator.scenario.scenario_file import load_scenario

IDEAL = load_scenario("ideal")
SOUND = build_vehicle(IDEAL)


def built(said: str, seed: int = 1) -> BuiltVehicle:
    return build_vehicle(replace(choose_scenario(DriveOptions(scenario=IDEAL, cause=said)), vehicle_seed=seed))


def test_water_makes_friction_erratic_from_shift_to_shift() -> None:
    def spread(cause: str | None) -> float:
        _, truth = frames_of(replace(choose_scenario(DriveOptions(scenario=IDEAL, cause=cause)), cycles=1))
        levels = [shift.mu_c / truth.drive.mu_c[shift.clutch - 1] for shift in truth.shifts]
        return max(levels) - min(levels)

    assert spread(None) == 0.0
    assert spread("water:2") > 0.05


def test_a_cause_grows_by_the_odometer_and_the_truth_names_it() -> None:
    growing = Cause(kind=CauseKind.GLAZED_LINING, strength=2.0, clutch=1, begins_m=1e6, grows_over_m=2e6)
    assert [growing.strength_at(km * 1e6) for km in (0.5, 1.0, 2.0, 3.0, 9.0)] == [0.0, 0.0, 1.0, 2.0, 2.0]
    for odometer_m, strengths in ((5e5, []), (2e6, [1.0]), (4e6, [2.0])):
        scenario = replace(IDEAL, causes=(growing,), odometer_m=odometer_m)
        truth = drive_truth(scenario, build_vehicle(scenario))
        assert [(one.kind, one.clutch) for one in truth.causes] == [("glazed-lining", 1)] * len(strengths)
        assert [one.strength for one in truth.causes] == strengths


def test_every_cause_changes_the_car() -> None:
    assert set(PER_STRENGTH) == set(CauseKind)
    for kind in CauseKind:
        faulty = built(kind.value)
        assert (faulty.calibration, faulty.parameters, faulty.sensors) != (
            SOUND.calibration,
            SOUND.parameters,
            SOUND.sensors,
        )
