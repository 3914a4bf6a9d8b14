"""``diag-service analyze``: the results of the logs of one drive, or of folders of drives, for people and as JSON."""

import logging
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from rich.table import Table

from canlog.errors import NOTICE
from canlog.logs import STANDARD_INPUT
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole, plain_table
from clutchdiag_io.program import legible
from diag_service.api.analysis import PaperAnalysis, analyze_drive, analyze_drive_by_paper
from diag_service.api.folders import FolderListener
from diag_service.batch.drives import DriveLogs, LeftOut, left_out_record
from diag_service.batch.tables import Entry
from diag_service.console import ReadingLine
from diag_service.delivery import standard_output_reporter
from diag_service.diagnosis.friction.paper import PaperEstimate, PaperShift, PooledClutch
from diag_service.diagnosis.summary import GAP_TEXT, FrameCounts, Gap, frames_line, gaps_line
from diag_service.errors import ConfigError
from diag_service.settings.config import PROPOSED
from diag_service.settings.options import AnalyzeOptions
from diag_service.stopping import Controls
from fleet_contract import JsonObject

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
    _check_words_without_lake(options)
    if any(path.is_dir() for path in options.paths if path != STANDARD_INPUT):
        _analyze_folders(options, controls)
        return
    _check_words_for_a_drive(options)
    if options.estimator == "paper":
        _analyze_by_paper(options, controls)
        return
    with ReadingLine() as line:
        reporter = standard_output_reporter(controls.stop, as_json=options.json, is_detailed=controls.verbosity > 0)
        analyze_drive(options, controls, line, reporter, watch=line.watch)


def _check_words_without_lake(options: AnalyzeOptions) -> None:
    if stored := [log for log in options.logs if isinstance(log, str)]:
        raise ConfigError(f"{stored[0]}: what is in a store is analysed into a lake: --lake PLACE")
    if options.scheduler != "local":
        raise ConfigError("--scheduler is for a lake: --lake PLACE says where the results go")
    if given := sorted({"signals", "time_limit", "retry"} & options.given):
        raise ConfigError(f"--{given[0].replace('_', '-')} is for a lake: --lake PLACE")


def _check_words_for_a_drive(options: AnalyzeOptions) -> None:
    if options.vehicle_from is not None:
        raise ConfigError("--vehicle-from is for folders: the logs that were named are one drive of one vehicle")
    if options.jobs is not None and options.output is None:
        raise ConfigError("--jobs is for folders: the logs that were named are one drive")
    if options.jobs is not None and options.jobs < 1:
        raise ConfigError(f"--jobs must be at least 1, got {options.jobs}")


def _analyze_by_paper(options: AnalyzeOptions, controls: Controls) -> None:
    if options.store is not None or options.broker or options.output is not None:
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not stored or published")
    with ReadingLine() as line:
        analyze_drive_by_paper(options, controls, _show_json if options.json else _show_text, line.watch)


def _show_json(analysis: PaperAnalysis, gaps: Sequence[Gap], _frames: FrameCounts) -> None:
    for shift in analysis.shifts:
        _write_record(_shift_record(shift))
    for clutch in analysis.clutches:
        _write_record(_pooled_record(clutch, gaps))


def _show_text(analysis: PaperAnalysis, gaps: Sequence[Gap], frames: FrameCounts) -> None:
    console = PeopleConsole()
    console.print(_PAPER_HEAD, style="bold")
    console.print_all(map(paper_line, analysis.shifts))
    if gaps:
        console.print(gaps_line(tuple(gaps)), style="bold red")
    console.print(_table(analysis.clutches))
    console.print("n: samples that passed every gate; no uncertainty is stated, so no verdict")
    console.print(frames_line(frames))


def _write_record(record: Mapping[str, object]) -> None:
    _write_line(dump(record))


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


def _pooled_record(clutch: PooledClutch, gaps: Sequence[Gap]) -> JsonObject:
    return {
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
    from diag_service.api.folders import analyze_drives  # noqa: PLC0415 - one drive needs none of it

    analyze_drives(options, controls, FolderLines(as_json=options.json), is_shown=True)


class FolderLines(FolderListener):
    """A line per drive on standard output: for people, or a JSON record per shift and drive."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._left_out = 0

    def add(self, drive: DriveLogs, entry: Entry) -> None:
        if self._as_json:
            for record in (*entry.shifts, entry.drive):
                _write_record(record)
            return
        _write_line(f"{legible(drive.name)}: {drive_line(entry)}")

    def leave_out(self, files: Sequence[LeftOut]) -> None:
        """Tell of files that are no drives: people on standard error, each with its reason."""
        self._left_out = len(files)
        for left in files:
            _LOG.log(NOTICE, "left out: %s: %s", left.path, left.reason)
            if self._as_json:
                _write_record(left_out_record(left))

    def end(self, totals: Mapping[str, int], entries: Iterable[Entry]) -> None:  # noqa: ARG002 - all were told before
        if not self._as_json:
            left_out = f", {self._left_out} files left out" if self._left_out else ""
            cut = f", {totals['cut']} are cut off and have no verdict" if totals["cut"] else ""
            what = f"{totals['drives']} drives, {totals['shifts']} shifts, {totals['failed']} could not be read"
            _write_line(f"{what}{cut}{left_out}")


def drive_line(entry: Entry) -> str:
    summary = entry.drive["summary"]
    if not isinstance(summary, dict):
        return f"not read: {entry.drive['error']}"
    statuses = {name: count for name, count in summary["shifts"]["by_status"].items() if count}
    counts = f" ({', '.join(f'{count} {name}' for name, count in statuses.items())})" if statuses else ""
    clutches = [f"clutch {clutch['clutch']} {clutch['condition'].replace('_', ' ')}" for clutch in summary["clutches"]]
    tier = f"tier {summary['capability']['tier'] or 'none'}"
    if summary["capability"]["profile"] == PROPOSED:
        tier += ", columns read as proposed"
    frames = summary["frames"]
    parts = [
        f"{frames['on_bus']} frames",
        f"{sum(frames['rejected'].values())} rejected",
        tier,
        f"{len(entry.shifts)} shifts{counts}",
        *clutches,
        *(GAP_TEXT[Gap(gap)] for gap in summary["incomplete"]),
        *summary["idle"],
    ]
    return ", ".join(parts)
