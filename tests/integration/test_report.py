"""Reports as users make them: the same numbers as JSON and store, and pages that a real browser shows to everybody."""

import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Locator, PdfMargins, ViewportSize

from clutch_results.records import Causes, LikelyCause, ShiftResult
from tests.integration.test_tiers import profile_without
from tests.support.browsing import HIGHEST_PX, chromium, complaints_of, cut_in, height_of, new_page
from tests.support.builders import at
from tests.support.histories import fill_store, history
from tests.support.in_process import ended
from tests.support.shiftings import scattered


def record_in(page: Path) -> dict[str, object]:
    (text,) = re.findall(
        r'<script type="application/json" id="record">(.*?)</script>', page.read_text(encoding="utf-8")
    )
    record: dict[str, object] = json.loads(text)
    return record


@pytest.fixture(name="browser", scope="module")
def _browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture(name="log_report", scope="module")
def _log_report(drive_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("report") / "drive.html"
    found = ended("report", drive_log, "-o", page)
    assert found.status == 0, found.err
    assert found.out == f"{page}: {page.stat().st_size / 1000:.0f} kB\n"
    return page


@pytest.fixture(name="full_report", scope="module")
def _full_report(drive_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("full") / "drive.html"
    assert ended("report", drive_log, "-o", page, "--full").status == 0
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


def test_single_shifts_of_a_log_are_shown_where_all_is_asked_for(log_report: Path, full_report: Path) -> None:
    short, full = (path.read_text(encoding="utf-8") for path in (log_report, full_report))
    for unit in ("rpm", "bar", "Nm"):
        assert f"During the shift [{unit}]: " in full
        assert f"During the shift [{unit}]: " not in short
    assert re.search(r"<h3>Event \d+, ", full)


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (("report", "drive.log", "-o", "page.txt"), 2, "a report is written as .html or .pdf"),
        (("report", "nowhere.log", "-o", "page.html"), 3, "nowhere.log"),
        (("report", "car1.sqlite", "drive.log", "-o", "page.html"), 2, "is a store"),
        (("report", "car1.sqlite", "--vehicle", "ghost", "-o", "page.html"), 4, "no results of ghost; it has car1"),
        (("history", "drive.log"), 4, "is not a result store"),
        (("history", "nowhere.sqlite"), 4, "there is no store"),
        (("history", "car1.sqlite", "--rows", "0"), 2, "--rows must be 1 or more"),
        (("history", "car1.sqlite", "--peers", "car1.sqlite"), 2, "car1.sqlite: "),
        (("show", "car1.sqlite", "99"), 4, "has no shift 99; the newest is 3"),
        (("fluid-changed", "car1.sqlite", "--at", "yesterday"), 2, "is not a date"),
        (("fluid-changed", "car1.sqlite", "--at", "2999-01-01"), 2, "still to come"),
        (("fluid-changed", "car1.sqlite", "--at", "1026-01-31"), 2, "--at 1026-01-31 is too long ago"),
        (("fluid-changed", "car1.sqlite", "--odometer", "nan"), 2, "--odometer must be 0 km or more"),
        (("fluid-changed", "car1.sqlite", "--product", "a\nb"), 2, "--product must be"),
    ],
)
def test_what_cannot_be_told_is_one_clear_line(
    words: tuple[str, ...], status: int, complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fill_store(Path("car1.sqlite"), history(3))
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


SHEETS = (("A4", "0"), ("A4", "2cm"), ("Letter", "2cm"))  # the narrowest and the lowest, with wide margins
EDGE = slice(-6, -2)  # pixels of a shadow; the last two may be rounded


def ageing(count: int) -> list[ShiftResult]:
    """Return results whose fluid will be worn within some ten thousand kilometres, and why."""
    causes = Causes(
        event_count=count,
        likely=tuple(
            LikelyCause(cause=cause, clutch=clutch, probability=share, evidence=EVIDENCE)
            for cause, clutch, share in (("aged-fluid", None, 0.8), ("glazed-lining", 2, 0.12), ("water", None, 0.05))
        ),
        advice=EVIDENCE,
        test=EVIDENCE,
    )
    found = []
    for one in history(count):
        estimate = at(one.estimate, odometer_m=250.0 * (one.estimate.conditions.odometer_m or 0.0))
        found.append(replace(one, estimate=estimate, verdict=replace(one.verdict, causes=causes)))
    return found


EVIDENCE = (
    "For it: the margin of both clutches fell together over forty thousand kilometres, in the cold as in the heat."
)
SOUND = 40  # results of the same history before the verdict changes


def sheet_counts(browser: Browser, report: Path) -> list[int]:
    """Return on how many pages a report is printed, by paper and margins."""
    page, counts = new_page(browser), []
    page.goto(report.as_uri())
    for form, width in SHEETS:
        margins: PdfMargins = {"top": width, "bottom": width, "left": width, "right": width}
        counts.append(len(re.findall(rb"/Type */Page\b", page.pdf(format=form, margin=margins))))
    page.context.close()
    return counts


def test_a_sheet_of_paper_is_enough_unless_all_is_asked_for(
    log_report: Path, store_report: Path, full_report: Path, browser: Browser, tmp_path: Path
) -> None:
    """One page for a verdict; with causes, too, and no more than two whatever the margins."""
    fill_store(tmp_path / "causes.sqlite", ageing(200))
    assert ended("report", tmp_path / "causes.sqlite", "-o", tmp_path / "causes.html").status == 0
    assert (sheet_counts(browser, log_report), sheet_counts(browser, store_report)) == ([1] * 3, [1] * 3)
    causes = sheet_counts(browser, tmp_path / "causes.html")
    assert (causes[0], max(causes) <= 2) == (1, True)
    assert min(sheet_counts(browser, full_report)) >= 2


def test_a_sheet_is_a_pdf_where_a_browser_is_and_is_refused_where_none_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill_store(tmp_path / "car1.sqlite", history(60))
    made = ended("report", tmp_path / "car1.sqlite", "-o", tmp_path / "car1.pdf")
    assert made.status == 0, made.err
    sheet = (tmp_path / "car1.pdf").read_bytes()
    assert (sheet[:5], len(re.findall(rb"/Type */Page\b", sheet))) == (b"%PDF-", 1)
    monkeypatch.setenv("PATH", str(tmp_path))
    refused = ended("report", tmp_path / "car1.sqlite", "-o", tmp_path / "other.pdf")
    assert (refused.status, (tmp_path / "other.pdf").exists()) == (2, False)
    assert "write .html and print that" in refused.err


_FIRST_SCREEN = """() => [...document.querySelectorAll("body *")].filter(one => {
  const box = one.getBoundingClientRect();
  return !one.children.length && box.width && box.bottom <= innerHeight;
}).map(one => one.textContent.trim()).join("\\n")"""
SCREENS: tuple[ViewportSize, ...] = (
    {"width": 390, "height": 664}, {"width": 768, "height": 1024}, {"width": 1280, "height": 720},
)  # fmt: skip


def test_the_first_screen_names_the_order_and_the_kilometres_left(browser: Browser, tmp_path: Path) -> None:
    """What somebody sees in three seconds, by the visible text alone: the worst vehicle needs no scrolling."""
    wanted = {
        "sound": (history(60)[:SOUND], "Nothing to do now", r"at least [\d,]+ km left \(90 % sure\)", SCREENS[:1]),
        "ageing": (
            ageing(120)[:100],
            "changed at the next service",
            r"[\d,]+ to [\d,]+ km left \(80 % sure\)",
            SCREENS,
        ),
        "few": (history(60)[:2], "Nothing to do now", "km left: not known yet", SCREENS[:1]),
    }  # what is said most needs most room
    missed = []
    for name, (results, order, left, sizes) in wanted.items():
        store, path = tmp_path / f"{name}.sqlite", tmp_path / f"{name}.html"
        fill_store(store, results)
        assert ended("report", store, "-o", path).status == 0
        for size in sizes:
            page = browser.new_page(viewport=size)
            page.goto(path.as_uri())
            seen = str(page.evaluate(_FIRST_SCREEN))
            missed += [(name, size["width"], one) for one in (order, left) if not re.search(one, seen)]
            page.close()
    assert missed == []


def has_shadow(box: Locator) -> bool:
    """Return whether a shadow at the right edge of a table says that there is more."""
    picture = np.asarray(Image.open(io.BytesIO(box.screenshot())).convert("L"))
    return bool(np.median(picture[:, EDGE]) < 225)


def test_a_table_that_is_cut_off_shows_where_it_goes_on(full_report: Path, browser: Browser) -> None:
    told, shown, at_end = [], [], []
    page = new_page(browser, 390)
    page.goto(full_report.as_uri())
    for box in page.locator(".scroll").all():
        told.append(bool(box.evaluate("one => one.scrollWidth - one.clientWidth > 3")))
        shown.append(has_shadow(box))
        box.evaluate("one => one.scrollTo(one.scrollWidth, 0)")
        at_end.append(has_shadow(box))
    page.context.close()
    assert shown == told
    assert set(told) == {False, True}
    assert set(at_end) == {False}


def test_a_real_browser_shows_the_pages_to_everybody(
    log_report: Path, store_report: Path, full_report: Path, browser: Browser
) -> None:
    """Light and dark, wide and narrow; all of a short one can be seen without scrolling sideways."""
    complaints = {}
    for path, scheme, width in (
        (store_report, "light", 1280), (store_report, "dark", 390), (log_report, "dark", 768),
        (full_report, "light", 390),
    ):  # fmt: skip
        page = new_page(browser, width, has_axe=True)
        said = complaints_of(page, path.as_uri(), scheme)
        if path == store_report:
            said += cut_in(page)
            assert height_of(page) <= HIGHEST_PX
        complaints[f"{path}, {scheme}, {width} px"] = said
        page.context.close()
    assert complaints == {key: [] for key in complaints}


@pytest.fixture(name="untold_store", scope="module")
def _untold_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of a car without pressures that slips for longer from March to June."""
    store = tmp_path_factory.mktemp("untold") / "car1.sqlite"
    fill_store(store, scattered(np.random.default_rng(5), [0, 1, 2, 90, 91, 92], 12, growth=0.3, among=0.01))
    return store


def test_a_store_without_friction_tells_how_the_car_shifts_and_what_changed(untold_store: Path) -> None:
    text = ended("history", untold_store).out
    assert "Friction: cannot be known from this car; shifting: 72 events in 6 drives; power on upshift 2-3 (72)" in text
    assert re.search(r"slip time of all events \d+ ± \d+ % longer than in March", text)
    assert re.search(r"power on upshift 2-3 +72 +\d\.\d\d ± 0\.\d\d .* \+\d+ ± \d+ %", text)
    assert "What would be needed for friction:\n  clutch 1 pressure." in text
    assert not re.search("no event engaged|unobserved|No prognosis|fluid of unknown age|verdict *$", text, re.MULTILINE)
    records = ended("history", untold_store, "--json").records
    (shifting,) = (record for record in records if record["record"] == "shifting")
    change = shifting["rows"][0]["measures"]["slip_duration_s"]["over_drives"]
    assert abs(change["change_ratio"] - 0.3) < 2.0 * change["std_change_ratio"] < 0.3
    assert records[-1]["record"] == "fills"


def test_a_report_without_friction_is_one_sheet_about_shifting(
    untold_store: Path, drive_log: Path, tmp_path: Path, browser: Browser
) -> None:
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    assert ended("report", untold_store, "-o", tmp_path / "store.html").status == 0
    assert ended("report", drive_log, "--profile", profile, "-o", tmp_path / "log.html", "--full").status == 0
    for name, heads in (
        ("store", ["How it shifts", "What would be needed for friction", "What was not seen"]),
        ("log", ["How it shifts", "What would be needed for friction", "What was not seen", "How well it shifts"]),
    ):
        page = new_page(browser, 390, has_axe=True)
        url = (tmp_path / f"{name}.html").as_uri()
        assert [complaints_of(page, url, scheme) for scheme in ("light", "dark")] == [[], []]
        assert page.locator("section > h2").all_inner_texts()[1 : 1 + len(heads)] == heads
        words = page.locator("main").inner_text()
        assert "friction cannot be known from this car" in words
        assert not re.search("unobserved|signal missing|no event engaged|km left|No prognosis|mu_C", words)
        assert page.locator("#shifting ~ .pair svg").count() == (2 if name == "store" else 0)
        assert page.locator("section[aria-labelledby=shifting] tbody tr").count() == (1 if name == "store" else 3)
        page.close()
    assert "38EB at 7E1" in (tmp_path / "log.html").read_text(encoding="utf-8")
