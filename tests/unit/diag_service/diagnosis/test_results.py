"""Results, states and summaries as they are stored and told."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.event_kinds import EventKind, PackHeat, ShiftControl, ShiftParts, ShiftQuality
from clutch_results.records import (
    Condition,
    FluidFill,
    FrictionSlope,
    Reason,
    ServiceStatus,
    ShiftStatistics,
    Status,
    Tier,
    clutch_record,
    dump,
    parse_shift,
    shift_record,
    status_record,
    utc_from_bus_ns,
)
from diag_service.diagnosis.capability import Capability
from diag_service.diagnosis.condition.condition import ConditionMemory, PairClutch, judge
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.summary import Summary, capability_line, of_own_fluid, order_by
from fleet_contract import schema
from fleet_contract.errors import ResultError
from fleet_contract.orders import Action
from tests.support.builders import friction_estimate, rejected, scale_free_friction, shift_result
from tests.support.histories import history

CURVE = nominal_calibration().clutches[0].friction
STATUS = ServiceStatus(
    vehicle="car1",
    is_online=True,
    connected_at="2026-01-01T00:00:00.000000Z",
    service_version="0.1.0",
    algorithm_version="algorithm-1",
    calibration_version="1+0123456789ab",
    calibration={"vehicle_type": "a car", "new_friction": [asdict(CURVE), asdict(CURVE)]},
)
SLOPE = FrictionSlope.of(scale_free_friction(), TorqueSource.MODELLED)
MODELLED = replace(
    shift_result(),
    estimate=replace(shift_result().estimate, friction=None, slope=SLOPE),
    verdict=replace(shift_result().verdict, friction=None, level_ratio=None, slope=SLOPE),
)
SCORED = replace(
    shift_result(),
    estimate=replace(
        shift_result().estimate,
        shift_quality=ShiftQuality(
            score=87.5,
            reasons=("flare_rad_s",),
            parts=ShiftParts(flare_rad_s=9.0),
            control=ShiftControl(fill_time_s=0.2),
            packs=(PackHeat(peak_k=350.0), PackHeat(slip_energy_j=7.0)),
        ),
    ),
)
RECORDS = [
    pytest.param("shift", shift_record(SCORED), id="shift with its quality"),
    pytest.param("shift", shift_record(MODELLED), id="shift of a modelled torque"),
    pytest.param("clutch", clutch_record(shift_record(MODELLED)), id="clutch of a modelled torque"),
    pytest.param("shift", shift_record(shift_result()), id="shift"),
    pytest.param("shift", shift_record(rejected(shift_result())), id="rejected shift"),
    pytest.param("clutch", clutch_record(shift_record(shift_result())), id="clutch"),
    pytest.param("clutch", clutch_record(shift_record(shift_result()), None, "Friction: ..."), id="clutch in words"),
    pytest.param("clutch", clutch_record(shift_record(rejected(shift_result()))), id="unknown clutch"),
    pytest.param("status", status_record(STATUS), id="online"),
    pytest.param("status", status_record(replace(STATUS, is_online=False)), id="offline"),
]


@pytest.mark.parametrize(("name", "record"), RECORDS)
def test_records_are_what_the_schema_describes(name: str, record: dict[str, object]) -> None:
    description = schema(name)
    Draft202012Validator.check_schema(description)
    Draft202012Validator(description).validate(json.loads(dump(record)))
    names = list(description["properties"])  # type: ignore[call-overload]
    where_there = {"slope", "revisions", "shift_quality", "micro_slip", "element", "causes", "shifting"}
    where_there.add("running_since_bus_ns")
    expected = [name for name in names if name not in where_there or record.get(name)]
    assert list(record) == expected  # keys and their order


def test_the_schemas_know_every_status_reason_and_condition() -> None:
    shift = schema("shift")
    properties = shift["properties"]
    assert isinstance(properties, dict)
    assert properties["status"]["enum"] == [status.value for status in Status]
    assert properties["reasons"]["items"]["enum"] == [reason.value for reason in Reason]
    clutch = schema("clutch")["properties"]
    assert isinstance(clutch, dict)
    assert clutch["condition"]["enum"] == [condition.name.lower() for condition in Condition]


@pytest.mark.parametrize("result", [shift_result(3, to_gear=5), rejected(shift_result()), MODELLED, SCORED])
def test_a_shift_survives_the_round_trip_to_the_bit(result: object) -> None:
    assert isinstance(result, type(shift_result()))
    assert parse_shift(dump(shift_record(result))) == result


def test_a_reader_ignores_keys_of_later_releases() -> None:
    record = shift_record(shift_result()) | {"colour": "amber"}
    assert parse_shift(dump(record)) == shift_result()


def test_results_of_before_the_sharp_numbers_are_read() -> None:
    record = json.loads(dump(shift_record(shift_result())))
    added = ("scale_free", "common_scale_std_ratio", "shift_scatter", "trend", "clutch_ratio", "lining", "stick_slip",
             "calibration_ratio", "advice")  # fmt: skip
    del record["scale_free"]
    for key in added:
        del record["verdict"][key]
    Draft202012Validator(schema("shift")).validate(record)
    old = parse_shift(json.dumps(record))
    assert old.estimate == replace(shift_result().estimate, scale_free=None)
    assert [getattr(old.verdict, key) for key in added] == [None] * len(added)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_json_for_a_number_that_is_not_finite(value: float) -> None:
    result = shift_result()
    broken = replace(result, estimate=replace(result.estimate, friction=replace(friction_estimate(), mu_s=value)))
    with pytest.raises(ResultError, match="not finite"):
        dump(shift_record(broken))


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "clutchdiag/shift/v2"},
        {"seq": "1"},
        {"seq": True},
        {"status": "perfect"},
        {"reasons": ["bad mood"]},
        {"reasons": "misfit"},
        {"friction": [1, 2]},
        {"friction": {"mu_c": 0.1}},
        {"scale_free": {"mu_c": 0.1}},
        {"verdict": None},
    ],
)
def test_a_foreign_record_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ResultError):
        parse_shift(dump(shift_record(shift_result()) | change))


def test_a_result_without_a_kind_is_of_a_shift_and_one_of_a_later_kind_is_no_poison() -> None:
    record = shift_record(shift_result())
    later = {**record, "kind": "reverse_launch", "end_reason": "parked"}
    assert Draft202012Validator(schema("shift")).is_valid(later)
    del record["kind"], record["end_reason"]
    assert Draft202012Validator(schema("shift")).is_valid(record)
    estimate = parse_shift(dump(record)).estimate
    assert (estimate.kind, estimate.end_reason) == (EventKind.SHIFT, None)


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


CALIBRATION = nominal_calibration()
GOLDEN = Path(__file__).parents[3] / "golden"


def kept(version: int) -> dict[str, Any]:
    table: dict[str, Any] = json.loads((GOLDEN / f"vehicle-state-v{version}.json").read_text(encoding="utf-8"))
    return table


@pytest.fixture
def stored() -> dict[str, Any]:
    return kept(4)


def test_the_verdict_on_a_stored_state_is_what_it_was(stored: dict[str, Any]) -> None:
    state = Posterior.from_json(stored["posterior"], CALIBRATION)
    _, verdict = judge(
        ConditionMemory.from_json(stored["condition"]), PairClutch.of(state, stored["clutch"], CALIBRATION)
    )
    assert verdict.friction is not None
    before = stored["verdict"]
    assert (verdict.condition.name, verdict.reason) == (before["condition"], before["reason"])
    assert verdict.friction.mu_c == pytest.approx(before["mu_c"], rel=1e-9)
    assert verdict.friction.mu_s == pytest.approx(before["mu_s"], rel=1e-9)


def test_a_state_of_the_format_before_is_refused_and_its_memory_is_read() -> None:
    before = kept(3)
    with pytest.raises(ValueError, match="running state of format 3, expected 4"):
        Posterior.from_json(before["belief"], CALIBRATION)
    assert ConditionMemory.from_json(before["condition"]).to_json() == before["condition"]
