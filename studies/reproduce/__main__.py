"""Reproduce the paper: ``python -m studies.reproduce [--seeds N] [--output FOLDER]``."""

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table as ConsoleTable

from studies.reproduce.drives import CYCLE_COUNT
from studies.reproduce.findings import find
from studies.reproduce.report import EVIDENCE_HEADINGS, evidence_rows, page
from studies.reproduce.tables import PaperTable, write_csv
from studies.reproduce.text import html_tables, reading_headings, reading_rows, study_tables, written
from studies.run import parsed, study_parser

DEFAULT_SEEDS = 40
OUTPUT = Path("reproduce-output")


def main() -> int:
    """Run the studies, write report and tables, show the tables."""
    parser = study_parser("Reproduce SAE 2015-01-1146.", is_parallel=False)
    parser.add_argument("--seeds", type=int, default=DEFAULT_SEEDS, help="draws of the noise (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder (default: %(default)s)")
    parser.add_argument("--cycles", type=int, default=CYCLE_COUNT, help="of each drive (default: %(default)s)")
    options = parsed(parser, seeds=2, cycles=1)
    if options.seeds < 2:
        parser.error("--seeds must be 2 or more: a scatter needs two runs")
    started_s = time.monotonic()
    found = find(options.seeds, options.cycles)
    tables = study_tables(found)
    options.output.mkdir(parents=True, exist_ok=True)
    for table in tables:
        write_csv(options.output / f"{table.name}.csv", table.headings, table.rows)
    write_csv(options.output / "what-passes.csv", EVIDENCE_HEADINGS, evidence_rows(found.evidence))
    write_csv(options.output / "readings.csv", reading_headings(), reading_rows(found))
    for picture in found.pictures:
        (options.output / f"figure-{picture.number:02}.png").write_bytes(picture.png)
    report = options.output / "report.html"
    report.write_text(page(written(found), html_tables(found, tables), found.pictures), encoding="utf-8")
    console = Console(width=150)
    for table in tables:
        console.print(_shown(table))
    console.print(f"{report}: tables, pictures and what they mean; {time.monotonic() - started_s:.0f} s", markup=False)
    return 0


def _shown(table: PaperTable) -> ConsoleTable:
    shown = ConsoleTable(*table.headings, title=table.caption, title_justify="left")
    for row in table.rows:
        shown.add_row(*row)
    return shown


if __name__ == "__main__":
    sys.exit(main())
