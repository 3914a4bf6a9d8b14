"""What the metrics say of vehicle and clutches: every number of a verdict, the usual names, bounded labels."""

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import Metric, Sample
from prometheus_client.parser import text_string_to_metric_families

from canlog.live import BusState, BusStatus
from clutch_results.event_kinds import EventKind
from clutch_results.loads import Load, borne
from clutch_results.records import FluidFill, ShiftResult, ShiftStatistics, quality_from
from clutchdiag_io.metrics import Told
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary, of_present_fluid
from diag_service.service.metrics import families as _families
from diag_service.service.snapshot import Snapshot
from tests.support.builders import shift_result
from tests.support.histories import history

BUS = BusStatus(state=BusState.UP, errors={}, interruption_count=0, restart_count=0, last_problem=None)
FILL = FluidFill(vehicle="car1", filled_at="2026-01-01T00:00:00.000000Z")
MADE_S = 1_767_225_605.0  # 2026-01-01T00:00:05Z, as the builders have it


def snapshot(*results: ShiftResult, fluid: FluidFill | None = None) -> Snapshot:
    """Return what a run has to show after these results."""
    statistics, loads = ShiftStatistics(), dict[int, Load]()
    for result in results:
        statistics = statistics.with_shift(result, is_new=True)
        loads = borne(loads, result.estimate)
    return Snapshot(
        taken_s=0.0,
        bus=BUS,
        clock_steps=0,
        load_ratio=0.25,
        messages={},
        rates_hz={},
        summary=Summary(vehicle="car1", frames=FrameCounts(), shifts=statistics, unpublished_count=None, loads=loads),
        recent=statistics.recent,
        stuck=None,
        clutches=tuple(result for _, result in sorted(statistics.latest.items())),
        fluid=fluid,
    )


def exposition(shown: Snapshot) -> str:
    """Return the metrics as they are served."""
    registry = CollectorRegistry()
    registry.register(Told(lambda: _families(shown)))
    return generate_latest(registry).decode()


def families(shown: Snapshot) -> list[Metric]:
    """Return the metrics as Prometheus reads them."""
    return list(text_string_to_metric_families(exposition(shown)))


def samples(shown: Snapshot) -> Iterator[Sample]:
    return (sample for family in families(shown) for sample in family.samples)


def of_clutch(shown: Snapshot, clutch: int) -> dict[str, float]:
    """Return the numbers of a clutch by name, with their third label if they have one."""
    found = {}
    for sample in samples(shown):
        labels = dict(sample.labels)
        if labels.pop("clutch", None) == str(clutch):
            assert labels.pop("vehicle") == "car1"
            name = sample.name.removeprefix("clutchdiag_clutch_")
            found[" ".join((name, *labels.values()))] = sample.value
    return found


def test_every_number_of_a_verdict_is_there() -> None:
    result = shift_result(1)
    verdict, friction, trend = result.verdict, result.verdict.friction, result.verdict.trend
    assert friction is not None
    assert trend is not None
    assert of_clutch(snapshot(result), 2) == {
        "verdict no_verdict": 0.0,
        "verdict good": 1.0,
        "verdict watch": 0.0,
        "verdict change_fluid": 0.0,
        f"advice_info There is no verdict on the fluid yet. Clutch 1: no event engaged it yet. {verdict.advice}": 1.0,
        "shifts_total valid": 1.0,
        "shifts_total rejected": 0.0,
        "shifts_total unobserved": 0.0,
        "last_result_timestamp_seconds": MADE_S,
        "level_ratio": verdict.level_ratio,
        "estimate_shifts": 1.0,
        "mu mu_c": friction.mu_c,
        "mu mu_s": friction.mu_s,
        "mu_std mu_c": friction.std_mu_c,
        "mu_std mu_s": friction.std_mu_s,
        "negative_slope_probability_ratio": friction.probability_negative_slope,
        "mu_change_ratio mu_c": trend.change_mu_c_ratio,
        "mu_change_ratio mu_s": trend.change_mu_s_ratio,
        "mu_change_std_ratio mu_c": trend.std_change_mu_c_ratio,
        "mu_change_std_ratio mu_s": trend.std_change_mu_s_ratio,
    }


def test_new_fluid_takes_verdict_and_friction_away_but_not_when_the_last_result_was() -> None:
    shown = snapshot(shift_result(1), fluid=FILL)
    later = replace(FILL, filled_at="2026-02-01T00:00:00.000000Z")
    summary = replace(shown.summary, fluid=later)
    old = replace(shown, clutches=of_present_fluid(shown.clutches, later), summary=summary)
    known = of_clutch(old, 2)
    assert (known["verdict no_verdict"], known["last_result_timestamp_seconds"]) == (1.0, MADE_S)
    assert not [name for name in known if "mu_" in name]
    assert any(
        name.startswith("advice_info New fluid since 2026-02-01 00:00 UTC: nothing is known of it yet.")
        for name in known
    )
    (filled,) = [sample for sample in samples(old) if sample.name == "clutchdiag_fluid_fill_timestamp_seconds"]
    assert (filled.labels, filled.value) == ({"vehicle": "car1"}, MADE_S - 5.0)


def test_names_and_types_are_those_that_prometheus_expects() -> None:
    found = families(snapshot(*history(40), fluid=FILL))
    assert len(found) == len({family.name for family in found}) > 20
    for family in found:
        assert re.fullmatch(r"clutchdiag_[a-z0-9_]+", family.name)
        assert family.documentation.endswith(".")
        assert family.type in {"gauge", "counter", "histogram"}
        assert not re.search(r"_(ms|milliseconds|percent|celsius|count|total)$", family.name)
        for sample in family.samples:
            assert sample.name.endswith("_total") is (family.type == "counter")


def test_what_the_clutches_had_to_bear_is_a_histogram_with_its_peak() -> None:
    launch = quality_from({"score": None, "slip_energy2_j": 40e3, "peak2_k": 410.0, "life2_ratio": 4.6e-6})
    shift = quality_from({"score": 80.0, "slip_energy2_j": 2e3, "peak2_k": 380.0, "life2_ratio": 2e-7})
    given = [shift_result(2 * number) for number in (1, 2, 3)]
    kinds = EventKind.LAUNCH, EventKind.POWER_ON_UPSHIFT, EventKind.POWER_ON_UPSHIFT
    shown = snapshot(*(
        replace(one, estimate=replace(one.estimate, kind=kind, shift_quality=quality))
        for one, kind, quality in zip(given, kinds, (launch, shift, shift), strict=True)
    ))  # fmt: skip
    found = {
        (one.name.removeprefix("clutchdiag_clutch_"), one.labels.get("le")): one.value
        for one in samples(shown)
        if one.labels.get("clutch") == "2"
    }
    bounds = {"300.0": 0.0, "1000.0": 0.0, "3000.0": 2.0, "10000.0": 2.0, "30000.0": 2.0, "+Inf": 3.0}
    assert {bound: found["slip_energy_joules_bucket", bound] for bound in bounds} == bounds
    assert found["slip_energy_joules_sum", None] == 44e3
    assert (found["launches_total", None], found["peak_temperature_kelvin", None]) == (1.0, 410.0)
    assert found["life_ratio_total", None] == pytest.approx(5e-6)
