"""``diag-service signals FOLDER``: which vehicles can be judged, for people, as JSON lines and as CSV."""

import csv
import io
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Final

from canlog.errors import SourceError
from clutch_results.records import dump
from clutchdiag_io.console import INDENT, PeopleConsole
from clutchdiag_io.program import legible
from diag_service.api.reaches import best_of_vehicles, place_of, survey
from diag_service.batch.log_reach import NO_LOG, LogReach
from diag_service.errors import ConfigError
from diag_service.settings.options import SignalsOptions
from diag_service.stopping import Controls

CSV_COLUMNS: Final = (
    *("vehicle", "path", "kind", "tier", "tells", "missing", "next_step", "remarks", "format", "database", "profile"),
    *("signals", "absent"),
)


def show(options: SignalsOptions, controls: Controls) -> None:
    """Print a row for each file, by vehicle and path; what was looked into when it was stopped, too."""
    if options.json and options.csv:
        raise ConfigError("--json and --csv: use only one of them")
    rows = list[LogReach]()
    try:
        with closing(survey(options, controls, is_shown=True)) as run:
            rows.extend(run)
    finally:
        rows.sort(key=place_of)
        _print(rows, options)
    if all(row.kind == NO_LOG for row in rows):
        first = f", for one {rows[0].path.name}: {rows[0].remarks[0]}" if rows else ""
        raise SourceError(f"none of {len(rows)} files is a log that can be read{first}")


def _print(rows: Sequence[LogReach], options: SignalsOptions) -> None:
    if options.json:
        sys.stdout.writelines(f"{dump(row.to_record())}\n" for row in rows)
    elif options.csv:
        sys.stdout.write(_csv_text(rows))
    elif rows:
        console = PeopleConsole()
        console.print_all(_lines(rows))


def _csv_text(rows: Sequence[LogReach]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row in rows:
        record = row.to_record()
        record |= {name: "; ".join(getattr(row, name)) for name in ("remarks", "signals", "absent")}
        writer.writerow("" if record[name] is None else record[name] for name in CSV_COLUMNS)
    return out.getvalue()


def _lines(rows: Sequence[LogReach]) -> Iterator[str]:
    """Yield the rows for people: what a log is and tells, below it what is missing and the next step."""
    for row in rows:
        yield f"{legible(str(row.path))}: {_tier_words(row)}"
        yield f"{INDENT}{row.kind}"
        if row.missing:
            yield f"{INDENT}{row.missing}"
        yield from (f"{INDENT}{remark}" for remark in row.remarks)
        if row.next_step:
            yield f"{INDENT}next: {legible(row.next_step)}"
    yield ""
    yield from _vehicle_lines(rows)
    yield _totals_line(rows)


def _tier_words(row: LogReach) -> str:
    if row.kind == NO_LOG:
        return "not read"
    return f"tier {row.tier}, {row.tells}" if row.tier else f"no tier, tells {row.tells}"


def _vehicle_lines(rows: Sequence[LogReach]) -> Iterator[str]:
    logs = Counter(row.vehicle for row in rows if row.kind != NO_LOG)
    for vehicle, best in sorted(best_of_vehicles(rows).items()):
        yield f"vehicle {legible(vehicle)}: {_tier_words(best)}, by {legible(best.path.name)} of {logs[vehicle]} logs"


def _totals_line(rows: Sequence[LogReach]) -> str:
    logs = [row for row in rows if row.kind != NO_LOG]
    tiers = Counter(f"tier {row.tier}" if row.tier else "no tier" for row in logs)
    counts = ", ".join(f"{count} of {name}" for name, count in sorted(tiers.items(), key=lambda item: item[0][::-1]))
    others = len(rows) - len(logs)
    return f"{len(logs)} logs{f': {counts}' if counts else ''}{f'; {others} other files' if others else ''}"
