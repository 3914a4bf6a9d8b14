"""``diag-service analyze``: the results of the logs of one drive, or of folders of drives, for people and as JSON."""

import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import closing
from typing import Final

from rich.table import Table

from canlog.errors import NOTICE
from canlog.files import is_folder
from canlog.logs import STANDARD_INPUT
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole, plain_table
from clutchdiag_io.program import legible
from diag_service.api.analysis import PaperAnalysis, analyze_drive, analyze_drive_by_paper
from diag_service.batch.drives import LeftOut, left_out_record
from diag_service.batch.tables import Entry
from diag_service.console import ReadingLine
from diag_service.delivery import standard_output_reporter
from diag_service.diagnosis.frame_counts import FrameCounts, frames_line
from diag_service.diagnosis.friction.paper import PaperEstimate, PaperShift, PooledClutch
from diag_service.diagnosis.summary import GAP_TEXT, Gap, gaps_line
from diag_service.errors import ConfigError
from diag_service.settings.config import PROPOSED
from diag_service.settings.options import AnalyzeOptions
from diag_service.stopping import Controls
from fleet_contract import JsonObject
from fleet_contract.orders import UNKNOWABLE

PAPER_SCHEMA: Final = "clutchdiag/paper/v1"
_PAPER_HEAD: Final = f"{'shift':>5}  {'gears':<5} {'clutch':>6}  {'mu_C':>8} {'n':>4} {'mu_S':>8} {'n':>4}"
_LOG = logging.getLogger(__name__)


def analyze(options: AnalyzeOptions, controls: Controls) -> None:
    if options.vehicle_from is not None and "vehicle" in options.given:
        raise ConfigError(
            "--vehicle-from takes the vehicles from the folders, --vehicle names one: use only one of them"
        )
    if options.lake is not None:
        from diag_service.commands.lake import fill  # noqa: PLC0415 - nothing else needs any of it

        fill(options, controls)
        return
    if stored := [log for log in options.logs if isinstance(log, str)]:
        raise ConfigError(f"{stored[0]}: what is in a store is analysed into a lake: --lake PLACE")
    _refuse(options, {"scheduler", "signals", "time_limit", "retry"}, "is for a lake: --lake PLACE says where")
    if any(is_folder(path) for path in options.paths if path != STANDARD_INPUT):
        _analyze_folders(options, controls)
        return
    for_folders = {"vehicle_from"} if options.output else {"vehicle_from", "jobs"}
    _refuse(options, for_folders, "is for folders: the logs that were named are one drive")
    if options.estimator == "paper":
        _analyze_by_paper(options, controls)
        return
    with ReadingLine() as line:
        reporter = standard_output_reporter(controls.stop, as_json=options.json, is_detailed=controls.verbosity > 0)
        analyze_drive(options, controls, line, reporter, watch=line.watch)


def _refuse(options: AnalyzeOptions, names: AbstractSet[str], reason: str) -> None:
    """Raise ConfigError if the command line has one of some options."""
    if given := sorted(names & options.given):
        raise ConfigError(f"--{given[0].replace('_', '-')} {reason}")


def _analyze_by_paper(options: AnalyzeOptions, controls: Controls) -> None:
    if options.store is not None or options.broker or options.output is not None:
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not stored or published")
    with ReadingLine() as line:
        analysis, account = analyze_drive_by_paper(options, controls, line.watch)
    if options.json:
        for record in (*map(_shift_record, analysis.shifts), *_pooled_records(analysis.clutches, account.gaps)):
            _write_line(dump(record))
    else:
        _show_text(analysis, account.gaps, account.frames)
    account.check_complete(is_strict=options.strict)


def _show_text(analysis: PaperAnalysis, gaps: Sequence[Gap], frames: FrameCounts) -> None:
    console = PeopleConsole()
    console.print(_PAPER_HEAD, style="bold")
    console.print_all(map(paper_line, analysis.shifts))
    if gaps:
        console.print(gaps_line(tuple(gaps)), style="bold red")
    console.print(_table(analysis.clutches))
    console.print("n: samples that passed every gate; no uncertainty is stated, so no verdict")
    console.print(frames_line(frames))


def _write_line(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def paper_line(shift: PaperShift) -> str:
    """Return one shift as a line for people; columns as in the head."""
    start = f"{shift.number:>5}  {f'{shift.from_gear}-{shift.to_gear}':<5} {shift.clutch:>6}  "
    if shift.estimate is None:
        reason = "" if shift.reason is None else shift.reason.value.replace("_", " ")
        return f"{start}{'-':>8} {'-':>4} {'-':>8} {'-':>4}  ({reason})"
    estimate, mu_c, mu_s = shift.estimate, _number(shift.estimate.mu_c), _number(shift.estimate.mu_s)
    return f"{start}{mu_c:>8} {estimate.coulomb_count:>4} {mu_s:>8} {estimate.static_count:>4}"


def _table(pooled: Sequence[PooledClutch]) -> Table:
    table = plain_table(("clutch", "mu_C", "n", "mu_S", "n", "std", "shifts"))
    for clutch in pooled:
        mu_c, mu_s, mu_c_samples, mu_s_samples = _estimate_record(clutch.estimate).values()
        cells = (_number(mu_c), mu_c_samples, _number(mu_s), mu_s_samples, "n/a", clutch.shift_count)
        table.add_row(str(clutch.clutch), *map(str, cells))
    return table


def _shift_record(shift: PaperShift) -> JsonObject:
    return {
        "schema": PAPER_SCHEMA,
        "scope": "shift",
        "number": shift.number,
        "from_gear": shift.from_gear,
        "to_gear": shift.to_gear,
        "clutch": shift.clutch,
        "reason": None if shift.reason is None else shift.reason.value,
        **_estimate_record(shift.estimate),
    }


def _pooled_records(clutches: Sequence[PooledClutch], gaps: Sequence[Gap]) -> Iterator[JsonObject]:
    for clutch in clutches:
        yield {
            "schema": PAPER_SCHEMA,
            "scope": "pooled",
            "clutch": clutch.clutch,
            "shift_count": clutch.shift_count,
            "complete": not gaps,
            "incomplete": [gap.value for gap in gaps],
            **_estimate_record(clutch.estimate),
        }


def _estimate_record(estimate: PaperEstimate | None) -> dict[str, float | None]:
    if estimate is None:
        return {"mu_c": None, "mu_s": None, "mu_c_samples": 0, "mu_s_samples": 0}
    return {
        "mu_c": estimate.mu_c,
        "mu_s": estimate.mu_s,
        "mu_c_samples": estimate.coulomb_count,
        "mu_s_samples": estimate.static_count,
    }


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _analyze_folders(options: AnalyzeOptions, controls: Controls) -> None:
    # What is on the command line: settings of other runs do not matter to folders.
    if "store" in options.given or options.estimator == "paper":
        raise ConfigError(
            "folders take neither --store nor --estimator paper: every drive in them is judged for itself, and a store "
            "keeps the state of one vehicle"
        )
    if STANDARD_INPUT in options.logs:
        raise ConfigError("folders are read by several processes: standard input does not go with them")
    from diag_service.api.folders import FolderTotals, analyze_drives  # noqa: PLC0415 - one drive needs none of it

    left_out_count = 0
    with closing(analyze_drives(options, controls, is_shown=True)) as run:
        for news in run:
            records: Sequence[JsonObject] = ()
            if isinstance(news, LeftOut):
                left_out_count += 1
                _LOG.log(NOTICE, "left out: %s: %s", news.path, news.reason)
                records, line = [left_out_record(news)], ""
            elif isinstance(news, FolderTotals):
                line = _totals_line(news.counts, left_out_count)
            else:
                drive, entry = news
                records, line = [*entry.shifts, entry.drive], f"{legible(drive.name)}: {drive_line(entry)}"
            for text in map(dump, records) if options.json else filter(None, [line]):
                _write_line(text)


def _totals_line(counts: Mapping[str, int], left_out_count: int) -> str:
    left_out = f", {left_out_count} files left out" if left_out_count else ""
    cut = f", {counts['cut']} are cut off and have no verdict" if counts["cut"] else ""
    return f"{counts['drives']} drives, {counts['shifts']} shifts, {counts['failed']} could not be read{cut}{left_out}"


def drive_line(entry: Entry) -> str:
    summary = entry.drive["summary"]
    if not isinstance(summary, dict):
        return f"not read: {entry.drive['error']}"
    statuses = {name: count for name, count in summary["shifts"]["by_status"].items() if count}
    counts = f" ({', '.join(f'{count} {name}' for name, count in statuses.items())})" if statuses else ""
    clutches = [f"clutch {clutch['clutch']} {clutch['condition'].replace('_', ' ')}" for clutch in summary["clutches"]]
    if str(summary["order"]).startswith(tuple(UNKNOWABLE.values())):
        clutches = ["friction cannot be known from this car"]
    tier = f"tier {summary['capability']['tier'] or 'none'}"
    content = "frames"
    if summary["capability"]["profile"] == PROPOSED:
        tier, content = f"{tier}, columns read as proposed", "values"
    frames = summary["frames"]
    parts = [
        f"{frames['on_bus']} {content}",
        f"{sum(frames['rejected'].values())} rejected",
        tier,
        f"{len(entry.shifts)} shifts{counts}",
        *clutches,
        *(GAP_TEXT[Gap(gap)] for gap in summary["incomplete"]),
        *summary["idle"],
    ]
    return ", ".join(parts)
