"""The overview of the fleet as people and browsers see it."""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from hashlib import sha256
from html import unescape
from importlib import resources
from pathlib import Path
from typing import Literal

import httpx
import pytest
from playwright.sync_api import Browser, ConsoleMessage

from tests.support.browsing import Words, chromium, new_page, words_seen
from tests.support.fleet_page import filled, served
from tests.support.patience import HANG_S


@pytest.fixture(name="address", scope="module")
def _address(sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with served(filled(sqlite_template, tmp_path_factory.mktemp("overview"), has_alarms=False)) as address:
        yield address


@pytest.fixture(name="browser", scope="module")
def _browser() -> Iterator[Browser]:
    """Yield a browser for all tests, which ask for it behind the server: it goes before that waits for it."""
    with chromium() as browser:
        yield browser


def test_the_overview_has_one_row_a_vehicle_and_columns_that_sort(address: str, browser: Browser) -> None:
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


def test_moments_are_shown_in_local_time_on_demand(address: str, browser: Browser) -> None:
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


def nearest(words: Iterable[Words], x: float, y: float) -> str:
    """Return the words that begin nearest to a point; a line above or below is as far as three letters beside it."""
    return min(words, key=lambda one: abs(one.left - x) + 3.0 * abs(one.top - y)).text


def below(words: Sequence[Words], head: str) -> str:
    """Return what stands first below a head."""
    heads = [one for one in words if one.text == head]
    under = (one for one in words if heads and one.top > heads[0].top + 10 and abs(one.left - heads[0].left) < 8)
    return min(under, key=lambda one: one.top).text if heads else ""


def read_list(words: Sequence[Words]) -> tuple[str, str, str]:
    """Return what a stranger reads off a list: which vehicle is worst, what to do with it, how many km are left.

    The worst one is where words are red; its name can be clicked and stands before them, the order behind.
    """
    red = min((one for one in words if one.colour == "red" and one.text[0].isalpha()), key=lambda one: one.top)
    names = [one for one in words if one.colour == "blue" and one.left < red.left + 50 and one.top <= red.top + 5]
    orders = [one for one in words if one.left > red.right - 5 and one.text.endswith(".") and one.top >= red.top - 5]
    order = nearest(orders, red.right, red.top).split(". ")[0].rstrip(".") + "."
    return nearest(names, red.left, red.top), order, below(words, "km left")


def read_vehicle(words: Sequence[Words]) -> tuple[str, str, str, str]:
    """Return what is read off a vehicle: its name, the colour of its verdict, the order beside that, its km left."""
    title = max(words, key=lambda one: one.bottom - one.top if one.text.startswith("Vehicle ") else 0.0)
    badges = (one for one in words if one.colour in {"red", "yellow", "green"} and one.text[0].isalpha())
    badge = min(badges, key=lambda one: one.top)
    order = nearest((one for one in words if one.text.endswith(".")), badge.left, badge.top).split(". ")[0] + "."
    (km,) = [one.text for one in words if re.search(r"km left", one.text, re.IGNORECASE) and one.top > badge.top]
    return title.text.removeprefix("Vehicle "), badge.colour, order, km


LOOKS: tuple[tuple[Literal["light", "dark"], int], ...] = (
    ("light", 390),
    ("dark", 768),
    ("light", 1280),
    ("dark", 1280),
)


def test_a_screenshot_tells_who_is_worst_what_to_do_and_how_far_it_goes(address: str, browser: Browser) -> None:
    """Whoever looks for three seconds sees words and colours of the first screen; scripts may be switched off."""
    with httpx.Client(base_url=address, trust_env=False) as client:
        worst = client.get("/api/v1/vehicles").json()["vehicles"][0]
        (left_m,) = {
            due["left_m"]
            for due in client.get("/api/v1/maintenance").json()["clutches"]
            if (due["vehicle"], due["clutch"]) == (worst["vehicle"], worst["clutch"])
        }
    told = (worst["vehicle"], worst["order"].split(". ")[0] + ".", f"{left_m / 1000.0:,.0f}")
    assert told == ("worn", "Change the fluid now.", "0")
    for scheme, width_px in LOOKS:
        context = browser.new_context(
            java_script_enabled=False, viewport={"width": width_px, "height": 900}, color_scheme=scheme
        )
        page = context.new_page()
        page.goto(address)
        assert read_list(words_seen(page)) == told, width_px
        if width_px == 1280:
            page.goto(f"{address}/maintenance")
            assert read_list(words_seen(page)) == told
        page.goto(f"{address}/vehicles/worn")
        assert read_vehicle(words_seen(page)) == (told[0], "red", told[1], "0 km left"), width_px
        page.goto(f"{address}/vehicles/car1")
        name, colour, order, km = read_vehicle(words_seen(page))
        assert (name, colour, order) == ("car1", "yellow", "Have the fluid changed at the next service."), width_px
        assert re.search(r"[0-9,]+ km left \([89]0 % sure\)", km), width_px
        context.close()


def heard(said: list[str], message: ConsoleMessage) -> None:
    said.append(message.text)


def test_a_click_in_the_chart_leads_to_an_event_and_without_scripts_its_picture_stays(
    address: str, browser: Browser
) -> None:
    for width_px in (390, 1280):
        page, refused = new_page(browser, width_px), list[str]()
        page.on("console", partial(heard, refused))
        page.goto(f"{address}/vehicles/car1")
        page.locator(".chart .u-over").hover()
        page.get_by_text("A click opens the event.").wait_for()
        page.locator(".chart .u-over").click()
        page.wait_for_url("**/vehicles/car1/shift?stream=*")
        assert str(page.locator("h1").text_content()).endswith(" of car1")
        assert refused == []  # by the policy for contents
    plain = browser.new_context(java_script_enabled=False).new_page()
    plain.goto(f"{address}/vehicles/car1")
    assert plain.locator("figure.fan svg.plot").is_visible()
    assert plain.locator(".chart").count() == 0


def test_the_chart_library_is_the_one_that_its_note_names() -> None:
    folder = resources.files("fleet_backend.page") / "static" / "uplot"
    told = re.findall(r"^sha256 (\w{64})  (\S+)$", (folder / "VERSION.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert {name: sha256((folder / name).read_bytes()).hexdigest() for _, name in told} == {one: at for at, one in told}
    assert {one.name for one in folder.iterdir()} == {"LICENSE", "VERSION.txt", *(name for _, name in told)}


def test_the_list_can_be_of_a_range_of_time(address: str, browser: Browser) -> None:
    page = new_page(browser)
    page.goto(address)
    page.get_by_text("Filters").click()
    page.get_by_label("Last event from").fill("2026-01-02")
    page.get_by_role("button", name="Show").click()
    page.wait_for_url("**since=2026-01-02**")
    page.get_by_text("No vehicle matches these filters.").wait_for()
    page.goto(f"{address}/?since=2026-01-01&until=2026-01-01")
    assert page.locator("tbody th").all_text_contents() == ["worn", "car1", "good.1"]
    page.get_by_text("Filters").click()
    assert page.get_by_label("Last event to").input_value() == "2026-01-01"
    with httpx.Client(base_url=address, trust_env=False) as client:
        wrong = client.get("/api/v1/vehicles?until=yesterday")
        assert (wrong.status_code, "until" in wrong.json()["detail"]) == (400, True)


def test_maintenance_has_a_lane_a_type_with_the_weeks_to_come(address: str, browser: Browser) -> None:
    page = new_page(browser)
    page.goto(f"{address}/maintenance")
    table = page.get_by_role("region", name="Table: Vehicles due, a lane a type: in which week")
    heads = table.locator("thead th").all_text_contents()
    assert (heads[:3], heads[-2:], len(heads)) == (["type", "now", "this week"], ["later", "no day"], 12)
    lanes = [row.locator("td").all_text_contents() for row in table.locator("tbody tr").all()]
    counts = [[int(text) if text != "–" else 0 for text in lane] for lane in lanes]
    assert [sum(lane) for lane in counts] == [2, 1]  # the largest type first
    assert counts[0][0] == 1  # the worn one is due now
