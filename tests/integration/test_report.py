"""Reports as users make them: the same numbers as JSON and store, and pages that a real browser shows to everybody."""

import io
import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, PdfMargins

from tests.support.browsing import chromium, complaints_of, new_page
from tests.support.histories import fill_store, history
from tests.support.in_process import ended


def record_in(page: Path) -> dict[str, object]:
    (text,) = re.findall(
        r'<script type="application/json" id="record">(.*?)</script>', page.read_text(encoding="utf-8")
    )
    record: dict[str, object] = json.loads(text)
    return record


@pytest.fixture(name="log_report", scope="module")
def _log_report(drive_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("report") / "drive.html"
    found = ended("report", drive_log, "-o", page)
    assert found.status == 0, found.err
    assert found.out == f"{page}: {page.stat().st_size / 1000:.0f} kB\n"
    return page


@pytest.fixture(name="store_report", scope="module")
def _store_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("store")
    fill_store(folder / "car1.sqlite", history(60))
    found = ended("report", folder / "car1.sqlite", "-o", folder / "car1.html")
    assert found.status == 0, found.err
    return folder / "car1.html"


def test_a_report_has_the_numbers_of_json_and_store(log_report: Path, drive_log: Path, tmp_path: Path) -> None:
    store = tmp_path / "drive.sqlite"
    analysed = ended("analyze", drive_log, "--store", store, "--json")
    record = record_in(log_report)
    assert record["clutches"] == analysed.summary["clutches"]
    summary = record["summary"]
    assert isinstance(summary, dict)
    assert summary["frames"] == analysed.summary["frames"]
    of_store = ended("report", store, "-o", tmp_path / "store.html")
    assert of_store.status == 0
    assert record_in(tmp_path / "store.html")["clutches"] == record["clutches"]
    told = [one["advice"] for one in ended("history", store, "--json").records if one["record"] == "event"]
    for clutch in analysed.summary["clutches"]:
        assert clutch["advice"] in told
        assert clutch["advice"] in log_report.read_text(encoding="utf-8").replace("&#39;", "'")


def test_single_shifts_of_a_log_are_shown(log_report: Path) -> None:
    text = log_report.read_text(encoding="utf-8")
    for title in ("speeds", "pressures", "torques"):
        assert re.search(rf"<figcaption>Event \d+, [^<]*: {title}</figcaption>", text)
    assert "No shift was rejected." in text


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (("report", "drive.log", "-o", "page.pdf"), 2, "a report is written as .html"),
        (("report", "nowhere.log", "-o", "page.html"), 3, "nowhere.log"),
        (("report", "car1.sqlite", "-o", "there.htm"), 2, "there.htm is there already; --force writes over it"),
        (("report", "car1.sqlite", "drive.log", "-o", "page.html"), 2, "is a store"),
        (("report", "car1.sqlite", "--vehicle", "ghost", "-o", "page.html"), 4, "no results of ghost; it has car1"),
        (("history", "drive.log"), 4, "is not a result store"),
        (("history", "nowhere.sqlite"), 4, "there is no store"),
        (("history", "car1.sqlite", "--rows", "0"), 2, "--rows must be 1 or more"),
        (("history", "car1.sqlite", "--peers", "car1.sqlite"), 2, "car1.sqlite: "),
        (("history", "car1.sqlite", "--peers", "nowhere.json"), 2, "nowhere.json: "),
        (("show", "car1.sqlite", "99"), 4, "has no shift 99; the newest is 3"),
        (("show", "drive.log", "1"), 4, "is not a result store"),
        (("fluid-changed", "car1.sqlite", "--at", "yesterday"), 2, "is not a date"),
        (("fluid-changed", "car1.sqlite", "--at", "2999-01-01"), 2, "still to come"),
        (("fluid-changed", "car1.sqlite", "--at", "1026-01-31"), 2, "--at 1026-01-31 is too long ago"),
        (("fluid-changed", "car1.sqlite", "--odometer", "nan"), 2, "--odometer must be 0 km or more"),
        (("fluid-changed", "car1.sqlite", "--product", "a\nb"), 2, "--product must be"),
        (("fluid-changed", "nowhere.sqlite"), 4, "there is no store"),
    ],
)
def test_what_cannot_be_told_is_one_clear_line(
    words: tuple[str, ...], status: int, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fill_store(Path("car1.sqlite"), history(3))
    Path("there.htm").touch()
    Path("drive.log").write_text("(1.000000) can0 123#00\n", encoding="utf-8")
    ended(*words).assert_one_line(status, complaint)
    assert not list(tmp_path.glob("*.html"))
    assert not Path("nowhere.sqlite").exists()


def test_a_shift_is_shown_as_it_was_stored(tmp_path: Path) -> None:
    fill_store(tmp_path / "car1.sqlite", history(3))
    (record,) = ended("show", tmp_path / "car1.sqlite", "2", "--json").records
    assert (record["seq"], record["schema"]) == (2, "clutchdiag/shift/v1")
    assert ended("show", tmp_path / "car1.sqlite", "2").out.startswith(record["verdict"]["advice"])


def test_a_store_is_read_where_nothing_may_be_written(tmp_path: Path) -> None:
    """Reading leaves the folder as it was."""
    fill_store(tmp_path / "car1.sqlite", history(3))
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    tmp_path.chmod(0o500)
    try:
        assert ended("history", tmp_path / "car1.sqlite").status == 0
    finally:
        tmp_path.chmod(0o700)
    assert before.items() <= {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}.items()


PAPER_MARGINS = ("0", "2cm")
EDGE = slice(-6, -2)  # pixels of a shadow; the last two may be rounded


@pytest.mark.parametrize("is_full", [False, True])
def test_paper_gets_two_pages_unless_all_is_asked_for(drive_log: Path, tmp_path: Path, *, is_full: bool) -> None:
    fill_store(tmp_path / "car1.sqlite", history(60))
    counts = []
    with chromium() as browser:
        for source in (drive_log, tmp_path / "car1.sqlite"):
            made = ended("report", source, "-o", tmp_path / "page.html", "--force", *(["--full"] if is_full else []))
            assert made.status == 0, made.err
            page = new_page(browser)
            page.goto((tmp_path / "page.html").as_uri())
            for form, width in product(("A4", "Letter"), PAPER_MARGINS):
                margins: PdfMargins = {"top": width, "bottom": width, "left": width, "right": width}
                counts.append(len(re.findall(rb"/Type */Page\b", page.pdf(format=form, margin=margins))))
    assert [min(count, 3) for count in counts] == [3 if is_full else 2] * 8


def test_the_first_page_says_in_one_sentence_why(log_report: Path) -> None:
    text = log_report.read_text(encoding="utf-8")
    first = text[text.index("<section") : text.index("</section>")]
    (told,) = re.findall("<p>(.*?)</p>", first)
    assert re.fullmatch(
        r"Clutch [12]: that friction falls with slip is [^.]*\d+\.\d % likely, and at high slip it is \d+ ± \d+ % "
        r"of that of new fluid \(\d+ shifts?; ± two standard deviations\)\.",
        told,
    )


def edges(box: Locator) -> dict[str, bool]:
    """Return at which edges of a table a shadow says that there is more."""
    picture = np.asarray(Image.open(io.BytesIO(box.screenshot())).convert("L"))
    right, bottom = np.median(picture[:, EDGE]), np.median(picture[EDGE])
    return {"right": bool(right < 225), "bottom": bool(bottom < 225)}


def test_a_table_that_is_cut_off_shows_where_it_goes_on(log_report: Path) -> None:
    sizes = "one => [one.scrollWidth - one.clientWidth > 3, one.scrollHeight - one.clientHeight > 3]"
    told, shown, at_end = [], [], []
    with chromium() as browser:
        page = new_page(browser, 390)
        page.goto(log_report.as_uri())
        for box in page.locator(".scroll").all():
            told.append(tuple(box.evaluate(sizes)))
            shown.append(tuple(edges(box).values()))
            box.evaluate("one => one.scrollTo(one.scrollWidth, one.scrollHeight)")
            at_end.append(tuple(edges(box).values()))
    assert shown == told
    assert {one for pair in told for one in pair} == {False, True}
    assert set(at_end) == {(False, False)}


def test_a_real_browser_shows_the_pages_to_everybody(log_report: Path, store_report: Path) -> None:
    """One start of the browser: light and dark, wide and narrow."""
    with chromium() as browser:
        complaints = {}
        for path, scheme, width in ((log_report, "light", 1280), (store_report, "dark", 400)):
            page = new_page(browser, width, has_axe=True)
            complaints[f"{path.name}, {scheme}, {width} px"] = complaints_of(page, path.as_uri(), scheme)
            page.close()
    assert complaints == {key: [] for key in complaints}
