"""Folders of drives from Python."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from clutch_model.calibration import Calibration
from clutch_results.records import shift_from
from diag_service.api.analysis import Analysis, ResultTable
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, configuration, optional_path, path_list
from diag_service.batch.drives import LeftOut
from diag_service.batch.folder_run import FolderListener, analyse_folders
from diag_service.batch.tables import Entry, columns
from diag_service.console import collected_notices
from diag_service.service.stopping import Trigger


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderAnalysis:
    """What the drives in some folders say, each judged for itself.

    Attributes
    ----------
    drives : tuple of Analysis
        Those that could be read, by their names.
    unread : Mapping of str to str
        Logs that look like logs and could not be read, each with the reason.
    left_out : Mapping of str to str
        Files that are no logs, each with the reason.
    notices : tuple of str
        What concerns the run; what concerns a drive is in its own ``notices``.
    """

    drives: tuple[Analysis, ...]
    unread: Mapping[str, str]
    left_out: Mapping[str, str]
    notices: tuple[str, ...] = ()

    @property
    def shifts(self) -> ResultTable:
        """A row for each shift of all drives; the table that ``analyze -o`` writes."""
        return ResultTable(columns(), [row for drive in self.drives for row in drive.shifts])

    def __repr__(self) -> str:
        shifts = sum(len(drive.results) for drive in self.drives)
        others = f"{len(self.unread)} not read, {len(self.left_out)} left out"
        return f"<diag_service.FolderAnalysis: {len(self.drives)} drives, {shifts} shifts, {others}>"


def analyze_folders(
    paths: AnyPaths,
    *,
    output: AnyPath | None = None,
    jobs: int | None = None,
    has_vehicles: bool = False,
    is_strict: bool = False,
    **meaning: Unpack[LogMeaning],
) -> FolderAnalysis:
    """Diagnose every log in some folders as a drive of its own, as ``diag-service analyze FOLDER...`` does.

    Processes are started for it: a script that calls it must guard its top level by ``if __name__ == "__main__":``.
    All results are held in memory.

    Parameters
    ----------
    paths
        Folders, with what is below them; single logs among them are one drive together.
    output
        A ``.jsonl``, ``.csv`` or ``.parquet`` file for the results; one that is there is replaced. With it a run
        that was ended half-way, killed even, is taken up where it ended.
    jobs
        Drives at a time; by default one per core.
    has_vehicles
        Whether the folders below those that are named are called after vehicles, whose logs they hold.
    vehicle, dbc, profile, calibration, is_strict, columns
        As of ``analyze``.

    Raises
    ------
    ConfigError, DefinitionError, CalibrationError
        If an argument cannot be used, or a folder holds no log.
    SourceError
        If none of the logs can be read.
    IncompleteError
        If ``is_strict`` and a log or a channel contributed nothing.
    StoreError
        If a file cannot be written.
    """
    listener = _Listener()
    with collected_notices() as notices:
        config = configuration(is_strict=is_strict, **meaning)
        analyse_folders(
            config,
            path_list(paths),
            output=optional_path(output),
            jobs=jobs,
            listener=listener,
            stop=Trigger(),
            is_forced=True,
            has_vehicles=has_vehicles,
        )
    return FolderAnalysis(
        drives=tuple(
            _analysis(entry, config.calibration) for entry in listener.entries if entry.drive["summary"] is not None
        ),
        unread={_name(entry): str(entry.drive["error"]) for entry in listener.entries if not entry.drive["summary"]},
        left_out={str(one.path): one.reason for one in listener.left_out},
        notices=tuple(notices),
    )


class _Listener(FolderListener):
    """Keeps what a run says."""

    def __init__(self) -> None:
        self.left_out: Sequence[LeftOut] = ()
        self.entries: list[Entry] = []

    def leave_out(self, files: Sequence[LeftOut]) -> None:
        self.left_out = files

    def end(self, totals: Mapping[str, int], entries: Iterable[Entry]) -> None:  # noqa: ARG002 - the entries say it
        self.entries = list(entries)


def _analysis(entry: Entry, calibration: Calibration) -> Analysis:
    record: Mapping[str, Any] = entry.drive
    return Analysis(
        paths=tuple(map(Path, record["paths"])),
        results=tuple(map(shift_from, entry.shifts)),
        summary=record["summary"],
        notices=tuple(record["notices"]),
        calibration=calibration,
    )


def _name(entry: Entry) -> str:
    record: Mapping[str, Any] = entry.drive
    return ";".join(record["paths"])
