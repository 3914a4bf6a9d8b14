"""The overview of the fleet as people and browsers see it."""

import csv
import io
import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser

from fleet_backend.database import open_database
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
        for count in ("1 change fluid", "1 watch", "1 good"):
            assert page.get_by_role("link", name=count, exact=True).count() == 1
        for way, found in (("ascending", ["car1", "good.1", "worn"]), ("descending", ["worn", "good.1", "car1"])):
            page.get_by_role("columnheader", name="vehicle").get_by_role("link").click()
            page.locator(f"th[aria-sort={way}]").wait_for()
            assert names.all_text_contents() == found
        page.get_by_role("link", name="1 watch", exact=True).click()
        page.wait_for_url("**condition=watch")
        assert names.all_text_contents() == ["car1"]


def test_moments_are_shown_in_local_time_on_demand(address: str) -> None:
    with chromium() as browser:
        context = browser.new_context(timezone_id="Asia/Kolkata")
        context.set_default_timeout(1000.0 * HANG_S)
        page = context.new_page()
        page.goto(address)
        row = page.get_by_role("row", name="worn")
        assert row.locator("time").last.text_content() == "2026-01-01 00:00"
        page.get_by_role("button", name="Local time").click()
        assert row.locator("time").last.text_content() == "2026-01-01 05:30"
        assert page.get_by_role("columnheader", name="last event (local)").count() == 1
        page.goto(f"{address}/vehicles/worn")  # the choice is kept
        assert page.locator("time", has_text="2026-01-01 05:30:").count() >= 1
        page.get_by_role("button", name="Local time", pressed=True).click()
        assert page.locator("time", has_text="2026-01-01 05:30").count() == 0


def test_the_list_is_a_table_for_other_programs_too(address: str) -> None:
    with httpx.Client(base_url=address, trust_env=False) as client:
        (link,) = re.findall(r'href="(/vehicles\.csv[^"]*)"', client.get("/?sort=-vehicle&limit=2").text)
        answer = client.get(unescape(link))
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert [(row["vehicle"], row["condition"]) for row in rows] == [("worn", "change_fluid"), ("good.1", "good")]


def seen_at_once(browser: Browser, url: str, width_px: int) -> str:
    """Return the words of the first screen of a page, without its scripts."""
    context = browser.new_context(java_script_enabled=False, viewport={"width": width_px, "height": 900})
    page = context.new_page()
    page.goto(url)
    seen = [
        one.inner_text()
        for one in page.locator("main :is(h1, li, p, th, td)").all()
        if (box := one.bounding_box()) is not None and box["y"] + box["height"] <= 900
    ]
    context.close()
    return " ".join(" ".join(seen).split())


def test_the_first_screen_tells_who_is_worst_what_to_do_and_how_far_it_goes(address: str) -> None:
    with chromium() as browser:
        fleet = seen_at_once(browser, address, 1280)
        assert re.search(r"worn CHANGE FLUID Change the fluid now\. [0-9-]+ 0 ", fleet)  # kilometres left
        assert "1 change fluid" in fleet
        for width_px in (390, 768, 1280):
            vehicle = seen_at_once(browser, f"{address}/vehicles/car1", width_px)
            assert "WATCH Have the fluid changed at the next service." in vehicle
            assert "Left: " in vehicle
