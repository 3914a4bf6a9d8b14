"""The trend of a clutch on the fleet's page: where fluid was changed it is marked, and the curve breaks."""

import re
from datetime import UTC, datetime, timedelta

import pytest

from fleet_backend.page.pictures import Course, Quantity, course_picture
from fleet_backend.page.records import Fill, TrendPoint, VehicleAnswer
from tests.support.fleet_page import clutch_now

START = datetime(2026, 1, 1, tzinfo=UTC)
ENDS = [START + timedelta(days=day) for day in range(10)]


def point(number: int) -> TrendPoint:
    told = dict.fromkeys(TrendPoint.__dataclass_fields__)
    known = {"end_at": ENDS[number], "mu_c": 0.13, "mu_s": 0.12, "running_mu_c": 0.13 + 0.001 * number}
    rest = {"running_std_mu_c": 0.003, "running_mu_s": 0.12, "running_std_mu_s": 0.003, "running_correlation": 0.5}
    return TrendPoint(**{**told, **known, **rest, "reasons": ()})  # type: ignore[arg-type]


def course(fills: list[datetime], quantity: Quantity = Quantity.MU_C) -> Course:
    told = dict.fromkeys(VehicleAnswer.__dataclass_fields__) | {"alarms": ()}
    noted = tuple(Fill(filled_at=at, odometer_m=None, product="DCTF-II", note=None) for at in fills)
    answer = VehicleAnswer(**{**told, "fills": noted})  # type: ignore[arg-type]
    return Course.of(clutch_now(), quantity, [point(number) for number in range(10)], answer, None)


@pytest.mark.parametrize("quantity", [Quantity.MU_C, Quantity.MU_S, Quantity.MARGIN])
def test_the_curve_and_its_bands_break_at_a_fill(quantity: Quantity) -> None:
    for fills, stretches in (([], 1), ([ENDS[4] + timedelta(hours=1)], 2), ([ENDS[2], ENDS[6]], 3)):
        picture = course_picture(course(fills, quantity))
        (line,) = re.findall(r'<path d="([^"]*)" class="line strong clutch1"', picture)
        (band,) = re.findall(r'<path d="([^"]*)" class="band clutch1"', picture)
        assert [one.count("M") for one in (line, band)] == [stretches] * 2
        assert picture.count("new fluid: DCTF-II") == len(fills)
