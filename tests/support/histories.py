"""Histories of results of any length: friction that falls, now and then a shift that is rejected."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Condition, FluidFill, Reason, ShiftResult
from diag_service.diagnosis.condition.thresholds import Cause
from diag_service.diagnosis.condition.verdict import advice
from diag_service.diagnosis.summary import latest_of
from diag_service.report.findings import Findings
from diag_service.service.session import versions_for
from diag_service.store import ResultStore, Row, VehicleState, Versions
from tests.support.builders import at, friction_estimate, rejected, shift_result

CALIBRATION = nominal_calibration()
VERSIONS = versions_for(CALIBRATION)
STATE = VehicleState(filter_state={}, condition={}, versions=VERSIONS)
_REFERENCE = CALIBRATION.clutches[0].friction


def history(count: int, *, vehicle: str = "car1", stream: str = "stream-1") -> list[ShiftResult]:
    """Return results of both clutches in turn, whose mu_C falls from new to 85 % of it; every seventh is rejected."""
    rng = np.random.default_rng(count)
    noise = 0.002 * rng.standard_normal(count)
    return [_result(seq, seq / count, noise[seq - 1], vehicle, stream) for seq in range(1, count + 1)]


def findings(count: int, **others: object) -> Findings:
    """Return what a store with such a history gives."""
    rows = tuple(Row(position=number, result=one) for number, one in enumerate(history(count), 1))
    found = Findings(
        vehicle="car1",
        sources=("car1.sqlite",),
        rows=rows,
        latest=latest_of(row.result for row in rows),
        versions=VERSIONS,
        calibration=CALIBRATION,
    )
    return replace(found, **others)  # type: ignore[arg-type]  # names of fields, as the caller spells them


def fill_store(path: Path, results: Sequence[ShiftResult], fills: Sequence[FluidFill] = ()) -> None:
    """Make a store of results."""
    store = ResultStore.open(path)
    for result in results:
        store.add(result, STATE)
    store.add_fills(fills)
    store.close()


def of_version(result: ShiftResult, versions: Versions) -> ShiftResult:
    """Return a result as another program or calibration would have made it."""
    return replace(result, algorithm_version=versions.algorithm, calibration_version=versions.calibration)


def _result(seq: int, age: float, noise: float, vehicle: str, stream: str) -> ShiftResult:
    result = of_version(shift_result(seq, vehicle=vehicle, stream=stream, to_gear=2 + seq % 2), VERSIONS)
    mu_c = _REFERENCE.mu_c * (1.0 - 0.1531 * age)  # as many digits as real ones have
    running = replace(friction_estimate(), mu_c=mu_c, mu_s=_REFERENCE.mu_s)
    condition = Condition.WATCH if age > 0.7 else Condition.GOOD
    cause = Cause.LEVEL_FALLING if condition is Condition.WATCH else None
    verdict = replace(
        result.verdict,
        condition=condition,
        friction=running,
        level_ratio=mu_c / _REFERENCE.mu_c,
        shift_count=(seq + 1) // 2,
        advice=advice(result.estimate.clutch, cause, 0.91),
        trend=None if seq < 30 else result.verdict.trend,
    )
    estimate = replace(
        at(result.estimate, odometer_m=1000.0 * seq), friction=replace(running, mu_c=mu_c + noise), number=seq
    )
    result = replace(result, estimate=estimate, verdict=verdict)
    if seq % 7:
        return result
    refused = rejected(result)
    return replace(refused, verdict=verdict, estimate=replace(refused.estimate, reasons=(Reason.FRAMES_MISSING,)))
