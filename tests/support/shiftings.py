"""Results of a vehicle that tells slip times and no friction, with drives that differ among themselves."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from clutch_results.event_kinds import EventKind, ShiftIndices, ShiftParts, ShiftQuality
from clutch_results.records import Condition, Reason, ShiftResult, Status, Tier
from diag_service.diagnosis.condition.condition import no_verdict
from diag_service.diagnosis.condition.thresholds import Silence
from tests.support.builders import at, shift_result

FIRST_AT = datetime(2026, 3, 4, 8, 0, tzinfo=UTC)
DAY_NS = 86_400_000_000_000
EVENT_NS = 20_000_000_000


def told(
    seq: int,
    start_ns: int,
    slip_s: float | None = 1.0,
    *,
    stream: str = "stream-1",
    kind: EventKind = EventKind.POWER_ON_UPSHIFT,
    to_gear: int = 3,
    peak_slip_rad_s: float | None = 100.0,
    capacity: tuple[float, float] | None = (0.84, 0.06),
    oil_k: float | None = 353.15,
    tier: Tier = Tier.TORQUE,
) -> ShiftResult:
    """Return the result of an event of a vehicle without pressures."""
    result = shift_result(seq, stream=stream, to_gear=to_gear)
    indices = None
    if slip_s is not None:
        indices = ShiftIndices(
            shift_time_s=slip_s + 0.3,
            slip_duration_s=slip_s,
            peak_slip_rad_s=peak_slip_rad_s,
            torque_capacity_ratio=capacity and capacity[0],
            std_torque_capacity_ratio=capacity and capacity[1],
        )
    estimate = replace(
        result.estimate,
        number=seq,
        start_ns=start_ns,
        end_ns=start_ns + 1_300_000_000,
        kind=kind,
        status=Status.UNOBSERVED,
        reasons=(Reason.SIGNAL_MISSING,),
        friction=None,
        scale_free=None,
        tier=tier,
        indices=indices,
        shift_quality=ShiftQuality(score=60.0, parts=ShiftParts(acceleration_m_s2=1.0)),
    )
    verdict = no_verdict(estimate.clutch, "friction needs clutch 1 pressure", Silence.SIGNALS_MISSING)
    assert verdict.condition is Condition.NO_VERDICT
    return replace(result, estimate=at(estimate, sump_temperature_k=oil_k, odometer_m=None), verdict=verdict)


def drives(
    days: Sequence[int],
    events: int,
    slip_s: Callable[[int, int], float],  # of a day, and of an event in its drive
    **others: object,
) -> list[ShiftResult]:
    """Return drives on some days since the first, of so many events each."""
    begin_ns = int(FIRST_AT.timestamp()) * 1_000_000_000
    return [
        told(
            number * events + event + 1,
            begin_ns + day * DAY_NS + event * EVENT_NS,
            slip_s(day, event),
            stream=f"stream-{number}",
            **others,  # type: ignore[arg-type]
        )
        for number, day in enumerate(days)
        for event in range(events)
    ]


def scattered(
    rng: np.random.Generator, days: Sequence[int], events: int, *, growth: float = 0.0, among: float = 0.05
) -> list[ShiftResult]:
    """Return drives whose slip times scatter by a tenth, and from drive to drive; they grow by so much in all."""
    drive_ratio = {day: 1.0 + among * rng.standard_normal() for day in days}

    def slip_s(day: int, _event: int) -> float:
        grown = 1.0 + growth * (day - days[0]) / max(days[-1] - days[0], 1)
        return float(max(0.9 * grown * (drive_ratio[day] + 0.1 * rng.standard_normal()), 0.05))

    return drives(days, events, slip_s)
