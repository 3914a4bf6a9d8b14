"""Pictures of the pages as a telephone and a desk show them: ``python -m tests.tools.page_shots FOLDER``.

Fleet, maintenance and a vehicle from a made-up database, whose longest name has as many letters as the contract allows,
and a report. What cannot be seen on a page is printed; the status is 1 if there is anything.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Browser

from diag_service.diagnosis.records import Condition
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.writer import Batch, Writer
from tests.support.browsing import chromium, complaints_of, cut_in, height_of, new_page
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import fill_database, served
from tests.support.histories import fill_store, history
from tests.support.in_process import ended

WIDTHS_PX = (390, 1280)
LONG_NAME = "Workshop-of-the-northern-depot_sweeper-with-trailer_no.0000000017"[:64]
_TABLES_ONLY = ("fleet", "maintenance")


@contextmanager
def pages(folder: Path) -> Iterator[Mapping[str, str]]:
    """Make a fleet and a report in a folder, and yield the addresses of their pages by name."""
    database = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(database)
    migrate(engine)
    fill_database(engine)
    worn = [fleet_result(seq, vehicle=LONG_NAME, condition=Condition.CHANGE_FLUID) for seq in range(1, 5)]
    others = [fleet_result(1, vehicle=f"van-{number:02}", condition=Condition.WATCH) for number in range(12)]
    Writer(engine).store(Batch(shifts=[row_of(one) for one in (*worn, *others)]))
    engine.dispose()
    fill_store(folder / "car1.sqlite", history(60))
    made = ended("report", folder / "car1.sqlite", "-o", folder / "car1.html")
    if made.status != 0:
        raise RuntimeError(made.err)
    with served(database) as address:
        yield {
            "fleet": address + "/",
            "maintenance": f"{address}/maintenance",
            "vehicle": f"{address}/vehicles/car1",
            "long-name": f"{address}/vehicles/{LONG_NAME}",
            "report": (folder / "car1.html").as_uri(),
        }


def shown(browser: Browser, name: str, url: str, width_px: int, picture: Path | None) -> tuple[int, list[str]]:
    """Show a page; return its height in pixels and what is wrong with it, axe's violations among it."""
    page = new_page(browser, width_px, has_axe=True)
    said = complaints_of(page, url, "light", has_picture=name not in (*_TABLES_ONLY, "long-name"))
    said += cut_in(page)
    if picture is not None:
        page.screenshot(path=picture, full_page=True)
    height_px = height_of(page)
    page.context.close()
    return height_px, said


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the pictures; return 1 if something on a page cannot be seen."""
    parser = argparse.ArgumentParser(prog="page_shots", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the pictures are written, one PNG for each page and width")
    folder: Path = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    wrong_count = 0
    with TemporaryDirectory() as made_in, pages(Path(made_in)) as addresses, chromium() as browser:
        for name, url in addresses.items():
            for width_px in WIDTHS_PX:
                picture = folder / f"{name}-{width_px}.png"
                height_px, said = shown(browser, name, url, width_px, picture)
                print(f"{picture}: {width_px} x {height_px} px, {len(said)} complaints")
                for one in said:
                    print(f"  {one}")
                wrong_count += len(said)
    return 1 if wrong_count else 0


if __name__ == "__main__":
    sys.exit(main())
