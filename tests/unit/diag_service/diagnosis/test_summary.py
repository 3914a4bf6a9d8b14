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
    summary_record,
    values_line,
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


def test_the_record_for_programs() -> None:
    capability = Capability(profile="vw", tier=Tier.KINEMATIC, missing=MISSING, unseen=("pedal_ratio",))
    record = summary_record(summary_of(capability=capability))
    assert record["capability"] == {"profile": "vw", "tier": 3, "missing": MISSING, "unseen": ["pedal_ratio"]}


def test_an_automatic_without_an_event_is_no_pair_of_clutches() -> None:
    summary = summary_of(capability=Capability(elements=("lock-up clutch",)))
    assert summary.order.reasons == ("Lock-up clutch: no event engaged it yet.",)
    assert "elements" not in str(summary_record(summary)["capability"])


def test_which_signals_lost_values_and_why() -> None:
    invalid = {"pedal_ratio": {"out_of_range": 1}, "engine_speed_rad_s": {"not_available": 3, "out_of_range": 2}}
    frames = FrameCounts(invalid_values=6, invalid=invalid)
    assert values_line(frames) == (
        "6 values of 2 signals were no measurements after the first real one: engine_speed_rad_s (5), pedal_ratio (1)"
    )
    at_first = {"engine_speed_rad_s": 2, "pedal_ratio": 1}
    assert values_line(replace(frames, invalid_at_first=at_first)) == (
        "3 values of 1 signal were no measurements after the first real one: engine_speed_rad_s (3)"
    )
    assert values_line(replace(frames, invalid_at_first={"engine_speed_rad_s": 5, "pedal_ratio": 1})) == ""
    many = FrameCounts(invalid={f"signal{number}": {"not_available": number} for number in range(1, 28)})
    assert values_line(many) == (
        "378 values of 27 signals were no measurements after the first real one: signal27 (27), signal26 (26), "
        "signal25 (25) and 24 more signals"
    )
    assert values_line(FrameCounts()) == ""
    record = summary_record(summary_of(frames))
    assert isinstance(record["frames"], dict)
    assert record["frames"]["invalid_signals"] == invalid
    assert "invalid_at_first" not in record["frames"]


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
