"""All of a page can be seen and read, on a telephone and on a desk."""

from pathlib import Path

from tests.support.browsing import chromium
from tests.tools.page_shots import WIDTHS_PX, pages, shown

HIGHEST_PX = 9000  # of a telephone's page; a name that is broken letter by letter made 13,000


def test_all_of_a_page_can_be_seen_on_a_telephone_and_on_a_desk(tmp_path: Path) -> None:
    wrong, heights_px = {}, {}
    with pages(tmp_path) as addresses, chromium() as browser:
        for name, url in addresses.items():
            for width_px in WIDTHS_PX:
                key = f"{name} at {width_px} px"
                heights_px[key], wrong[key] = shown(browser, name, url, width_px, None)
    assert wrong == {key: [] for key in wrong}
    assert {key: height_px for key, height_px in heights_px.items() if height_px > HIGHEST_PX} == {}
