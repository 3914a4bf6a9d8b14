"""What is said of the capability of a run."""

from dataclasses import replace

import pytest

from diag_service.diagnosis.records import FluidFill, ShiftStatistics, Tier, utc_from_bus_ns
from diag_service.diagnosis.summary import (
    Capability,
    FrameCounts,
    Summary,
    capability_line,
    of_own_fluid,
    order_by,
)
from fleet_contract.orders import Action
from tests.support.builders import shift_result
from tests.support.histories import history

MISSING = "friction needs clutch1_pressure_pa"


def summary_of(
    frames: FrameCounts = FrameCounts(on_bus=1, ignored=1),  # noqa: B008 - it cannot be changed
    capability: Capability = Capability(),  # noqa: B008 - likewise
    shifts: ShiftStatistics = ShiftStatistics(),  # noqa: B008 - likewise
) -> Summary:
    return Summary(vehicle="car1", frames=frames, shifts=shifts, unpublished_count=None, capability=capability)


def line(capability: Capability, *, has_shift: bool) -> str:
    shifts = ShiftStatistics().with_shift(shift_result(1), is_new=True) if has_shift else ShiftStatistics()
    return capability_line(summary_of(capability=capability, shifts=shifts))


@pytest.mark.parametrize(
    ("capability", "has_shift", "said"),
    [
        (Capability(), True, ""),
        (Capability(), False, "no shift was found"),
        (Capability(tier=Tier.TORQUE, missing=MISSING), True, f"tier 2 of 3, torque capacity, no friction: {MISSING}"),
        (
            Capability(tier=None, missing="x", unseen=("pedal_ratio",)),
            False,
            "no shift was found; the signals do not show shifts: x; mapped by profile dct, but never seen: pedal_ratio",
        ),
        (Capability(tier=None, missing="x"), True, "the signals show that gears change, and no more: x"),
    ],
)
def test_the_line_for_people(capability: Capability, has_shift: bool, said: str) -> None:
    assert line(capability, has_shift=has_shift) == said


def test_what_rests_on_events_before_a_fill_says_nothing_of_the_fluid_after_it() -> None:
    one = history(60)[-1]
    assert one.verdict.friction is not None
    start_ns = one.estimate.start_ns
    fill = FluidFill(vehicle="car1", filled_at=utc_from_bus_ns(start_ns - 10**12))
    for since_ns, is_told in ((None, True), (start_ns - 10**13, False), (start_ns - 10**11, True)):
        verdict = replace(one.verdict, trend=None, running_since_bus_ns=since_ns)
        (found,) = of_own_fluid([replace(one, verdict=verdict)], [fill])
        assert (found.verdict.friction is not None) is is_told
        assert order_by([found], fill).action is not Action.NEW_FLUID or not is_told
