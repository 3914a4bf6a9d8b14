"""The overview of the fleet as people and browsers see it."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from sqlalchemy import update

from fleet_backend.database import open_database, transaction
from fleet_backend.page.calibrations import shipped_calibration
from fleet_backend.schema import SHIFT_RESULT
from tests.support.browsing import chromium, new_page
from tests.support.fleet_page import fill_database, served
from tests.support.patience import HANG_S


@pytest.fixture(name="address", scope="module")
def _address(sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = tmp_path_factory.mktemp("overview") / "fleet.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    engine = open_database(f"sqlite:///{path}")
    fill_database(engine)
    engine.dispose()
    with served(f"sqlite:///{path}") as address:
        yield address


def test_the_overview_has_one_row_a_vehicle_and_columns_that_sort(address: str) -> None:
    with chromium() as browser:
        page = new_page(browser)
        page.goto(address)
        names = page.locator("tbody th")
        assert names.all_text_contents() == ["worn", "car1", "good.1"]
        for count in ("change fluid: 1", "watch: 1", "good: 1"):
            assert page.get_by_role("link", name=count, exact=True).count() == 1
        for way, found in (("ascending", ["car1", "good.1", "worn"]), ("descending", ["worn", "good.1", "car1"])):
            page.get_by_role("columnheader", name="vehicle").get_by_role("link").click()
            page.locator(f"th[aria-sort={way}]").wait_for()
            assert names.all_text_contents() == found
        page.get_by_role("link", name="watch: 1").click()
        page.wait_for_url("**condition=watch")
        assert names.all_text_contents() == ["car1"]


def test_parts_of_an_order_follow_each_other(address: str) -> None:
    with httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as reader:
        first = reader.get("/api/v1/vehicles?limit=2&sort=-vehicle").json()
        second = reader.get(f"/api/v1/vehicles?limit=2&sort=-vehicle&after={first['next']}").json()
        assert [one["vehicle"] for one in first["vehicles"] + second["vehicles"]] == ["worn", "good.1", "car1"]
        assert second["next"] is None
        assert reader.get("/?sort=colour").status_code == 400


def test_a_type_has_a_name_where_its_calibration_is_at_hand(sqlite_template: Path, tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    engine = open_database(f"sqlite:///{path}")
    fill_database(engine)
    with transaction(engine) as connection:
        shipped = {"calibration_version": shipped_calibration()}
        connection.execute(update(SHIFT_RESULT).where(SHIFT_RESULT.c.vehicle == "car1").values(shipped))
    engine.dispose()
    with served(f"sqlite:///{path}") as address, httpx.Client(base_url=address, timeout=HANG_S) as reader:
        rows = reader.get("/").text.split("<tr")
        (known,), (other,) = ([row for row in rows if f">{name}<" in row] for name in ("car1", "worn"))
    assert "six-speed wet DCT" in known
    assert "1+0123456789ab" in other


def test_moments_are_shown_in_local_time_on_demand(address: str) -> None:
    with chromium() as browser:
        context = browser.new_context(timezone_id="Asia/Kolkata")
        context.set_default_timeout(1000.0 * HANG_S)
        page = context.new_page()
        page.goto(address)
        row = page.get_by_role("row", name="worn")
        assert row.locator("time").text_content() == "2026-01-01 00:00"
        page.get_by_role("button", name="Local time").click()
        assert row.locator("time").text_content() == "2026-01-01 05:30"
        assert page.get_by_role("columnheader", name="last event (local)").count() == 1
        page.goto(f"{address}/vehicles/worn")  # the choice is kept
        assert page.locator("time", has_text="2026-01-01 05:30:").count() >= 1
        page.get_by_role("button", name="Local time", pressed=True).click()
        assert page.locator("time", has_text="2026-01-01 05:30").count() == 0


def test_what_is_overdue_comes_first_and_is_marked(address: str) -> None:
    with httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as reader:
        due = reader.get("/api/v1/maintenance").json()["clutches"]
        assert [one["vehicle"] for one in due if one["is_overdue"]] == ["worn"]
        assert due[0]["vehicle"] == "worn"
        assert reader.get("/maintenance").text.count(">overdue<") == 1
