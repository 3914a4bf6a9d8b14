"""What is usual is counted by type, clutch and fluid, where there are enough of a kind."""

import pytest

from fleet_backend.page.keeper import LEAST_CLUTCHES, group_of, usual_of
from tests.support.fleet_page import clutch_now


def test_what_is_usual_is_that_of_the_same_kind() -> None:
    usual = [clutch_now(f"v{number}", mu_c=0.12 + 0.0001 * number) for number in range(101)]
    other = [clutch_now(f"v{number}", 2, mu_c=0.2, fluid="DCTF") for number in range(LEAST_CLUTCHES)]
    few = [clutch_now(f"w{number}", 2, mu_c=0.3) for number in range(LEAST_CLUTCHES - 1)]
    unknown = [clutch_now(f"x{number}", mu_c=None) for number in range(50)]
    found = usual_of([*usual, *other, *few, *unknown])
    assert set(found) == {group_of(usual[0]), group_of(other[0])}
    one = found[group_of(usual[0])]
    assert one.clutch_count == 101
    assert (one.low_mu_c, one.middle_mu_c, one.high_mu_c) == pytest.approx((0.121, 0.125, 0.129))
    assert found[group_of(other[0])].low_mu_c == found[group_of(other[0])].high_mu_c == 0.2
