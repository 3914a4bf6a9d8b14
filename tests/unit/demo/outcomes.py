"""A demonstration that succeeded; a test changes what it is about."""

from dataclasses import replace

from clutch_model.calibration import clutch_of_gear
from clutch_results.records import ClutchVerdict, Condition, ShiftResult
from demo.outcome import FrameAccount, Outcome
from ecu_emulator.truth import ShiftTruth, Totals, TruthLog
from tests.support.builders import friction_estimate, shift_result
from tests.unit.ecu_emulator.truth.test_records import DRIVE

GEARS = ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 5), (5, 4), (4, 3), (3, 2), (2, 1))
FRICTION = friction_estimate()


def shift(number: int) -> ShiftResult:
    from_gear, to_gear = GEARS[number - 1]
    result = shift_result(number, to_gear=to_gear)
    return replace(result, estimate=replace(result.estimate, from_gear=from_gear, to_gear=to_gear))


def true_shift(number: int) -> ShiftTruth:
    from_gear, to_gear = GEARS[number - 1]
    return ShiftTruth(
        number=number,
        t_start_s=4.0 * number,
        t_end_s=4.0 * number + 1.0,
        from_gear=from_gear,
        to_gear=to_gear,
        clutch=clutch_of_gear(to_gear),
        mu_c=FRICTION.mu_c,
        mu_s=FRICTION.mu_s,
        clutch_temperature_k=360.0,
    )


def good_frames() -> FrameAccount:
    return FrameAccount(
        sent=1000,
        given_up=0,
        lateness_max_s=0.004,
        on_bus=1000,
        decoded=990,
        ignored=10,
        rejected={},
        dropped=0,
        missing=0,
        late=0,
    )


def good_outcome() -> Outcome:
    numbers = range(1, len(GEARS) + 1)
    return Outcome(
        expected=len(GEARS),
        shifts=tuple(shift(number) for number in numbers),
        origin="as a subscriber received them",
        clutches={
            clutch: ClutchVerdict(
                clutch=clutch,
                condition=Condition.GOOD,
                reason="sound",
                level_ratio=1.0,
                friction=FRICTION,
                shift_count=5,
                advice=f"Clutch {clutch}: nothing to do.",
            )
            for clutch in (1, 2)
        },
        order="Nothing to do.",
        truth=TruthLog(
            drive=replace(DRIVE, mu_c=(FRICTION.mu_c,) * 2, mu_s=(FRICTION.mu_s,) * 2),
            shifts=tuple(true_shift(number) for number in numbers),
            totals=Totals(shifts=len(GEARS), duration_s=40.6, frames=1000),
        ),
        frames=good_frames(),
    )
