"""What scores and slip of many changes come to."""

from dataclasses import replace

import pytest

from diag_service.diagnosis.condition.shift_course import Course, courses, load_line, loads
from diag_service.diagnosis.condition.shift_quality import PARTS
from diag_service.diagnosis.events import EventKind
from diag_service.diagnosis.records import ShiftEstimate, ShiftQuality
from tests.support.builders import shift_result

UPSHIFT = ShiftQuality(
    score=80.0, reasons=("jerk_m_s3",), std_touch_error_pa=1_000.0, slip_energy1_j=0.0, slip_energy2_j=5_000.0
)


def result(
    seq: int, quality: ShiftQuality | None, *, oil_k: float = 350.0, kind: str = "power_on_upshift"
) -> ShiftEstimate:
    given = shift_result(seq).estimate
    return replace(given, shift_quality=quality, sump_temperature_k=oil_k, kind=EventKind(kind))


def test_a_course_has_both_ends_and_the_oil() -> None:
    some = [result(seq, replace(UPSHIFT, score=90.0), oil_k=300.0) for seq in range(20)]
    some += [result(20 + seq, replace(UPSHIFT, score=60.0)) for seq in range(20)]
    some.append(result(41, None))
    (found,) = courses(some)
    assert found == Course(
        kind=EventKind.POWER_ON_UPSHIFT, from_gear=1, to_gear=2, count=40, first=90.0, last=60.0,
        by_oil=(90.0, 60.0, None), reason="jerk_m_s3", untold=tuple(part.name for part in PARTS),
    )  # fmt: skip
    assert courses([result(1, None)]) == []
    some += [result(50 + seq, replace(UPSHIFT, score=40.0, reasons=("flare_rad_s",))) for seq in range(20)]
    assert courses(some)[0].reason == "flare_rad_s"  # why they go badly now, however many did for another reason


def test_the_load_of_a_clutch_is_what_it_slipped() -> None:
    hot = replace(UPSHIFT, peak2_k=390.0, life2_ratio=2e-6)
    launch = replace(hot, score=None, slip_energy2_j=40_000.0, peak2_k=410.0, life2_ratio=16e-6)
    unseen = ShiftQuality(score=None)  # without pressures
    some = [result(1, hot), result(2, hot), result(3, launch, kind="launch"), result(4, unseen, kind="launch")]
    (found,) = loads([*some, result(5, unseen), result(6, None)])
    assert (found.clutch, found.counts, found.energy_j, found.launch_count) == (2, (0, 0, 0, 2, 0, 1), 50_000.0, 2)
    assert found.peak_k == 410.0
    assert found.life_ratio == pytest.approx(20e-6)
    assert load_line(found) == (
        "Clutch 2 turned 0.05 MJ into heat in 3 events, launches: 2, at most 137 °C; 0.0020 % of its lining's life, as "
        "an index."
    )
