"""How long a report takes to make and to show, and how large it is: of 30 and of 10,000 shifts."""

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright

from tests.support.histories import fill_store, history

GOALS = {30: (3.0, 500_000), 10_000: (10.0, 2_000_000)}  # events: seconds, bytes
_FIRST_PAINT = "performance.getEntriesByType('paint').find(one => one.name === 'first-contentful-paint').startTime"


def made_s(source: Path, page: Path) -> float:
    """Return how long the whole command takes, start included."""
    begin_s = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "diag_service", "report", str(source), "-o", str(page), "--force"],
        check=True,
        capture_output=True,
    )
    return time.perf_counter() - begin_s


def first_paint_ms(pages: list[Path]) -> list[float]:
    """Return when a browser first shows something of each page."""
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        found = []
        for path in pages:
            page = browser.new_page(bypass_csp=True)
            page.goto(path.as_uri())
            found.append(float(page.evaluate(f"new Promise(done => setTimeout(() => done({_FIRST_PAINT}), 300))")))
            page.close()
        browser.close()
    return found


def main() -> None:
    """Print a line per report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, help="folder to keep the pages in")
    keep: Path | None = parser.parse_args().keep
    with TemporaryDirectory() as name:
        folder = keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        drive = Path(name) / "drive.log"
        record = [sys.executable, "-m", "ecu_emulator", "record", str(drive), "--scenario", "case2", "--cycles", "3"]
        subprocess.run(record, check=True, capture_output=True)
        sources = {"log, 30 shifts": (drive, 30)}
        for count in GOALS:
            store = Path(name) / f"store-{count}.sqlite"
            fill_store(store, history(count))
            sources[f"store, {count} shifts"] = (store, count)
        pages = {what: folder / f"{source.stem}.html" for what, (source, _) in sources.items()}
        times_s = {what: min(made_s(source, pages[what]) for _ in range(3)) for what, (source, _) in sources.items()}
        paints_ms = first_paint_ms(list(pages.values()))
        for (what, (_, count)), paint_ms in zip(sources.items(), paints_ms, strict=True):
            goal_s, goal_bytes = GOALS[count]
            size = pages[what].stat().st_size
            print(
                f"{what}: made in {times_s[what]:.2f} s (goal {goal_s:g} s), {size / 1000:.0f} kB "
                f"(goal {goal_bytes / 1000:.0f} kB), first paint after {paint_ms:.0f} ms"
            )


if __name__ == "__main__":
    main()
