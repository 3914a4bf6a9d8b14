"""One log of a lake: fetched, analysed, its parts written; whatever is wrong with it becomes the reason in its row."""

import faulthandler
import hashlib
import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canlog.column_files import TableFormat
from canlog.errors import SourceError
from canlog.logs import looked_at
from canlog.tables.decoding import Plan, decode_logs
from clutch_results.records import dump, iso_utc
from diag_service.batch.drives import drive_of
from diag_service.batch.folder_run import settings_digest
from diag_service.batch.journal import Entry
from diag_service.batch.worker import Analyst
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.parts import (
    DATE_CHARACTERS,
    DONE,
    FAILED,
    SHIFTS,
    SIGNALS,
    LogRow,
    content_digest,
    first_date,
    part_name,
    signal_plan,
    write_shifts,
)
from diag_service.lake.places import Held, Place
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.session import versions_for
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from fleet_contract import JsonObject

PARTS_VERSION: Final = "1"  # of how parts are laid out; those of an older one are made anew
GRACE_S: Final = 30.0  # a log that does not heed its time limit ends its process so much later
STDERR: Final = 2  # its descriptor: a stream that stands in for it may have none
_MAKERS: Final[list["Maker"]] = []  # of this process: one, of the job that it works at
_ONE_AT_A_TIME: Final = threading.Lock()  # whatever threads a worker has: memory is reckoned by logs


@dataclass(frozen=True, slots=True, kw_only=True)
class LakeLog:
    """A log that is to be analysed."""

    place: str  # where logs are
    held: Held
    vehicle: str
    kept: tuple[str, ...] = ()  # parts of decoded signals that are there already
    kept_signals: str = ""  # digest of what decided about them

    @property
    def source(self) -> str:
        return f"{self.place}/{self.held.name}"

    @property
    def key(self) -> str:
        """What tells this log from any other, from itself of another vehicle, and from an earlier state of it."""
        parts = (self.place, self.held.name, str(self.held.size_bytes), self.held.mark, self.vehicle)
        return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What is to be done with every log; a worker gets it with its first one."""

    config: DiagnosisConfig
    lake: str
    settings: str  # digest of what decides about shifts, as the run has it
    signals: str | None  # patterns of the signals that are decoded, too; None: none
    signal_settings: str  # digest of what decides about them
    time_limit_s: float

    @classmethod
    def of(cls, config: DiagnosisConfig, lake: str, signals: str | None, time_limit_s: float) -> "Job":
        """Return what is to be done; raises ConfigError if database and profile cannot be used or a signal is none."""
        if not 0.0 < time_limit_s < float("inf"):
            raise ConfigError(f"--time-limit must be > 0 s, got {time_limit_s:g}")
        meaning = config.interpretation()
        if signals is not None:
            signal_plan(Plan.of(meaning.database.messages), signals)
        return cls(
            config=config,
            lake=lake,
            settings=settings_digest(config),
            signals=signals,
            signal_settings="" if signals is None else signal_digest(meaning, signals, config.columns),
            time_limit_s=time_limit_s,
        )


def signal_digest(meaning: Interpretation, signals: str, log_columns: str) -> str:
    """Return a digest of all that decides about decoded signals besides the log; the algorithm does not."""
    messages = sorted((repr(message), repr(message.signals)) for message in meaning.database.messages)
    return hashlib.sha256("\0".join((PARTS_VERSION, repr(messages), signals, log_columns)).encode()).hexdigest()


class Maker:
    """Makes the parts of logs in one process; database and profile are read once."""

    def __init__(self, job: Job) -> None:
        self.job = job

    @cached_property
    def _analyst(self) -> Analyst:
        if settings_digest(self.job.config) != self.job.settings:
            raise ConfigError(
                "a worker has another database, profile, calibration or version of clutchdiag than the run: its "
                "results would be others"
            )
        return Analyst(self.job.config)

    @cached_property
    def _plan(self) -> Plan:
        meaning = self.job.config.interpretation()
        return signal_plan(Plan.of(meaning.database.messages), self.job.signals or "")

    @cached_property
    def _lake(self) -> Place:
        return Place(self.job.lake)

    def make(self, log: LakeLog) -> LogRow:
        """Return the row of a log whose parts are written; a log that cannot be analysed gives the reason instead.

        Raises StoreError if the lake does not take a part, ConfigError if this process would make other ones.
        """
        analyst, limit_s = self._analyst, self.job.time_limit_s
        content = ""
        with TemporaryDirectory(prefix="clutchdiag-") as name, _limited(limit_s) as stop:
            path = folder = Path(name)
            try:
                path = Place(log.place).brought(log.held.name, folder)
                content = content_digest(path)
                entry = _analysed(analyst, log, path, stop, limit_s)
                return row_of(self.job, log, content, entry, self._parts(log, content, entry, path, folder))
            except (StoreError, ConfigError):
                raise
            except SourceError as exc:
                reason = str(exc).replace(str(path), log.source)
            except Exception as exc:  # noqa: BLE001 - one log, whatever is wrong with it, must not stop the others
                reason = f"{type(exc).__name__}: {exc}"
        return row_of(self.job, log, content, reason=reason)

    def _parts(self, log: LakeLog, content: str, entry: Entry, path: Path, folder: Path) -> list[str]:
        """Write the parts of a log, all of them or none, and return their names."""
        files, days = dict[str, Path](), defaultdict[str, list[JsonObject]](list)
        for shift in entry.shifts:
            days[str(shift["start_utc"])[:DATE_CHARACTERS]].append(shift)
        for date, shifts in days.items():
            made = folder / f"shifts-{date}.parquet"
            write_shifts(made, content, shifts, is_complete=entry.is_complete)
            files[part_name(SHIFTS, date, log.vehicle, content, self.job.settings)] = made
        if self.job.signals is not None and not log.kept:
            made, log_columns = folder / "signals.parquet", self.job.config.columns
            decode_logs([path], self._plan, made, TableFormat.PARQUET, columns=log_columns)
            date = first_date(path, log_columns)
            files[part_name(SIGNALS, date, log.vehicle, content, self.job.signal_settings)] = made
        for name, made in files.items():
            self._lake.put(name, made)
        return [*files, *log.kept]


def row_of(
    job: Job, log: LakeLog, content: str = "", entry: Entry | None = None, parts: Sequence[str] = (), reason: str = ""
) -> LogRow:
    """Return the row of a log; without what it said it failed."""
    return LogRow(
        source=log.source,
        key=log.key,
        size_bytes=log.held.size_bytes,
        vehicle=log.vehicle,
        content=content,
        settings=job.settings,
        signals=log.kept_signals or job.signal_settings,
        algorithm_version=versions_for(job.config.calibration).algorithm,
        outcome=DONE if entry else FAILED,
        reason=reason,
        shifts=len(entry.shifts) if entry else 0,
        parts=tuple(parts),
        account=dump({"logs": [entry.drive] if entry else []}),
        made_at=iso_utc(datetime.now(UTC)),
    )


def make_in_worker(job: Job, log: LakeLog) -> LogRow:
    """Make the parts of a log in a process that gets many of the same job, one after another."""
    with _ONE_AT_A_TIME:
        if not _MAKERS or replace(_MAKERS[0].job, config=job.config) != job:  # `settings` is a digest of the former
            _MAKERS[:] = [Maker(job)]
        return _MAKERS[0].make(log)


def _analysed(analyst: Analyst, log: LakeLog, path: Path, stop: Trigger, limit_s: float) -> Entry:
    """Return what the log said; raises SourceError, saying why it could not be read."""
    one = looked_at(path, analyst.config.columns)
    if one.format is None:
        raise SourceError(f"{log.source}: {one.reason}")
    entry = analyst.analyse(drive_of([path], log.vehicle), stop)
    if stop.is_set:
        raise SourceError(f"took longer than {limit_s:g} s")
    if error := entry.drive["error"]:
        raise SourceError(str(error))
    return Entry(key=entry.key, drive={**entry.drive, "paths": [log.source]}, shifts=entry.shifts)


@contextmanager
def _limited(limit_s: float) -> Iterator[Trigger]:
    """Give a trigger that the time limit sets; a process that does not heed it is ended, with all that it holds."""
    stop = Trigger()
    timer = threading.Timer(limit_s, stop.set)
    timer.daemon = True
    timer.start()
    faulthandler.dump_traceback_later(limit_s + GRACE_S, exit=True, file=STDERR)
    try:
        yield stop
    finally:
        timer.cancel()
        faulthandler.cancel_dump_traceback_later()
