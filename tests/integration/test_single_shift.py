"""Sensor faults from the scenario to the estimate: a lying sensor is found out, and the truth says when it lied."""

from dataclasses import replace

import pytest

from clutch_results.records import Reason, Status
from ecu_emulator.scenario.faults import Phase, SensorFault, SensorFaultKind
from studies.builders import diagnose
from tests.support.builders import drive_scenario

SHIFT = 3  # 3-4 by clutch 2


def fault(quantity: str, kind: str, size: float = 0.0, *, start_s: float = 0.0) -> SensorFault:
    """Return a fault that begins in the inertia phase, in which the slip window lies."""
    return SensorFault(
        quantity=quantity,
        kind=SensorFaultKind(kind),
        size=size,
        shift=SHIFT,
        phase=Phase.INERTIA,
        start_s=start_s,
        duration_s=1.0,
    )


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (fault("engine_torque_nm", "frozen"), Reason.SENSOR_FROZEN),
        (fault("clutch2_pressure_pa", "frozen", start_s=0.1), Reason.SENSOR_FROZEN),
        (fault("input2_speed_rad_s", "offset", 5.0), Reason.SPEEDS_DISAGREE),
        (fault("hub_speed_rad_s", "drift", -10.0), Reason.SPEEDS_DISAGREE),
        (fault("clutch2_pressure_pa", "offset", -0.3e5), Reason.PRESSURE_OFF_COMMAND),
        (fault("clutch2_pressure_pa", "drift", 1.0e5), Reason.PRESSURE_OFF_COMMAND),
        (fault("engine_torque_nm", "offset", 80.0, start_s=0.1), Reason.MISFIT),
        (fault("engine_torque_nm", "not_available"), Reason.FRAMES_MISSING),
    ],
    ids=lambda value: f"{value.quantity} {value.kind}" if isinstance(value, SensorFault) else str(value),
)
def test_a_lying_sensor_costs_its_shift_and_no_other(broken: SensorFault, reason: Reason) -> None:
    diagnoses, truth = diagnose(replace(drive_scenario(seed=41), sensor_faults=(broken,)))
    (told,) = truth.totals.faults if truth.totals else ()
    shift = truth.shifts[SHIFT - 1]
    assert shift.t_start_s < told.t_start_s < shift.t_end_s
    assert (told.what, told.kind, told.size) == (broken.quantity, broken.kind, broken.size)
    assert told.count == 100  # one second at 100 Hz
    estimates = [diagnosis.estimate for diagnosis in diagnoses]
    hit = estimates.pop(SHIFT - 1)
    assert (hit.status, hit.friction) == (Status.REJECTED, None)
    assert reason in hit.reasons
    assert [estimate.status for estimate in estimates] == [Status.VALID] * 9


def test_a_rejected_shift_leaves_no_trace_in_the_running_state() -> None:
    diagnoses, _ = diagnose(replace(drive_scenario(seed=41), sensor_faults=(fault("engine_torque_nm", "frozen"),)))
    assert diagnoses[SHIFT - 1].belief.posterior is diagnoses[SHIFT - 2].belief.posterior


def test_a_zero_that_jumps_is_found_on_the_empty_clutch() -> None:
    """A pressure sensor that suddenly reads 0.2 bar more does so before the shift as well."""
    _, truth = diagnose(drive_scenario(seed=41))
    start_s = truth.shifts[SHIFT - 1].t_start_s - 1.0
    broken = SensorFault(
        quantity="clutch2_pressure_pa", kind=SensorFaultKind.OFFSET, size=0.2e5, start_s=start_s, duration_s=2.5
    )
    diagnoses, _ = diagnose(replace(drive_scenario(seed=41), sensor_faults=(broken,)))
    assert diagnoses[SHIFT - 1].estimate.reasons == (Reason.ZERO_JUMPED,)
