"""All of a page can be seen and read, on a telephone and on a desk; reports: test_report.py."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser

from clutch_results.records import Condition
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.writer import Batch, Writer
from tests.support.browsing import HIGHEST_PX, chromium, complaints_of, cut_in, height_of, new_page
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import fill_database, served

WIDTHS_PX = (390, 1280)
LONG_NAME = "Workshop-of-the-northern-depot_sweeper-with-trailer_no.0000000017"[:64]
_TABLES_ONLY = ("fleet", "maintenance")


@contextmanager
def pages(folder: Path) -> Iterator[Mapping[str, str]]:
    """Make a fleet in a folder, and yield the addresses of their pages by name."""
    database = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(database)
    migrate(engine)
    fill_database(engine)
    worn = [fleet_result(seq, vehicle=LONG_NAME, condition=Condition.CHANGE_FLUID) for seq in range(1, 5)]
    others = [fleet_result(1, vehicle=f"van-{number:02}", condition=Condition.WATCH) for number in range(12)]
    Writer(engine).store(Batch(shifts=[row_of(one) for one in (*worn, *others)]))
    engine.dispose()
    with served(database) as address:
        yield {
            "fleet": address + "/",
            "maintenance": f"{address}/maintenance",
            "vehicle": f"{address}/vehicles/car1",
            "long-name": f"{address}/vehicles/{LONG_NAME}",
        }


def shown(browser: Browser, name: str, url: str, width_px: int) -> tuple[int, list[str]]:
    """Show a page; return its height in pixels and what is wrong with it, axe's violations among it."""
    page = new_page(browser, width_px, has_axe=True)
    said = complaints_of(page, url, "light", has_picture=name not in (*_TABLES_ONLY, "long-name"))
    said += cut_in(page)
    height_px = height_of(page)
    page.context.close()
    return height_px, said


def test_all_of_a_page_can_be_seen_on_a_telephone_and_on_a_desk(tmp_path: Path) -> None:
    wrong, heights_px = {}, {}
    with pages(tmp_path) as addresses, chromium() as browser:
        for name, url in addresses.items():
            for width_px in WIDTHS_PX:
                key = f"{name} at {width_px} px"
                heights_px[key], wrong[key] = shown(browser, name, url, width_px)
    assert wrong == {key: [] for key in wrong}
    assert {key: height_px for key, height_px in heights_px.items() if height_px > HIGHEST_PX} == {}
