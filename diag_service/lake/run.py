"""A run that makes a lake of logs: what is not in it yet is handed out, each log analysed and its parts written."""

import faulthandler
import hashlib
import logging
import socket
import ssl
import threading
from collections import defaultdict, deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import urlsplit

from canlog.column_files import TableFormat
from canlog.errors import SourceError
from canlog.extras import load_extra
from canlog.files import is_plain_file
from canlog.logs import looked_at
from canlog.tables.decoding import Plan, decode_logs
from clutch_results.records import dump, iso_utc
from diag_service.batch.drives import drive_of
from diag_service.batch.tables import Entry
from diag_service.batch.worker import DEADLY, Analyst, run_in_pool, run_in_processes, settings_digest
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.parts import (
    DATE_CHARACTERS,
    DONE,
    FAILED,
    SHIFTS,
    SIGNALS,
    Held,
    LogRow,
    Manifest,
    Place,
    first_date,
    part_name,
    signal_plan,
    write_shifts,
)
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.drive import stream_of
from diag_service.service.session import versions_for
from diag_service.settings.config import DiagnosisConfig, check_vehicle
from diag_service.stopping import Trigger
from fleet_contract import JsonObject
from fleet_link import AddressError, TlsFiles

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
    reused: tuple[str, ...] = ()  # parts of decoded signals that are there already
    reused_settings: str = ""  # digest of what decided about them

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

    def make(self, log: LakeLog) -> LogRow:
        """Return the row of a log whose parts are written; a log that cannot be analysed gives the reason instead.

        Raises StoreError if the lake does not take a part, ConfigError if this process would make other ones.
        """
        analyst, limit_s = self._analyst, self.job.time_limit_s
        content = ""
        with TemporaryDirectory(prefix="clutchdiag-") as name, _limited(limit_s) as stop:
            path = folder = Path(name)
            try:
                path = Place(log.place).fetched(log.held.name, folder)
                content = stream_of([path])
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
        if self.job.signals is not None and not log.reused:
            made, log_columns = folder / "signals.parquet", self.job.config.columns
            decode_logs([path], self._plan, made, TableFormat.PARQUET, columns=log_columns)
            date = first_date(path, log_columns)
            files[part_name(SIGNALS, date, log.vehicle, content, self.job.signal_settings)] = made
        lake = Place(self.job.lake)
        for name, made in files.items():
            lake.put(name, made)
        return [*files, *log.reused]


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
        signals=log.reused_settings or job.signal_settings,
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
    look = looked_at(path, analyst.config.columns)
    if look.format is None:
        raise SourceError(f"{log.source}: {look.reason}")
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


SCHEME: Final = "tls"
DEFAULT_PORT: Final = 8786
CONNECT_TIMEOUT_S: Final = 10.0
PATIENCE_S: Final = 120.0  # how long there may be no worker
MOST_HANDED_OUT: Final = 1000  # what a scheduler holds, however many logs there are
RETRIES: Final = 2  # of a log whose store refused
Rows = Generator[LogRow, None, None]


def find_logs(places: Sequence[str], lake: Place, vehicle: str, *, has_vehicles: bool) -> list[LakeLog]:
    """Return all that lies in some places; with ``has_vehicles`` the first folder below a place names the vehicle.

    Raises StoreError if a place cannot be looked into, ConfigError if it is empty or a folder bears no name of a
    vehicle.
    """
    logs: dict[str, LakeLog] = {}
    for address in places:
        place = Place(address)
        if f"{lake.address}/".startswith(f"{place.address}/") or f"{place.address}/".startswith(f"{lake.address}/"):
            raise ConfigError(f"{address}: logs and lake must not contain each other")
        held = place.held()
        if not held:
            what = "is a file: a lake is made of folders and stores" if is_plain_file(Path(address)) else "holds no log"
            raise ConfigError(f"{address} {what}")
        for name, file in held.items():
            log_vehicle = check_vehicle(name.partition("/")[0] if "/" in name else "") if has_vehicles else vehicle
            log = LakeLog(place=place.address, held=file, vehicle=log_vehicle)
            logs[log.source] = log
    return list(logs.values())


def to_do(job: Job, logs: Sequence[LakeLog], manifest: Manifest, *, is_retried: bool) -> list[LakeLog]:
    """Return the logs of which the lake lacks something, the largest first, each with what of it may stay."""
    missing = list[LakeLog]()
    for log in logs:
        row = manifest.row(log.source)
        if row is None or row.key != log.key:
            missing.append(log)
            continue
        has_signals = job.signals is None or row.signals == job.signal_settings
        if row.settings != job.settings or not has_signals or (is_retried and row.outcome == FAILED):
            reused = tuple(part for part in row.parts if part.startswith(f"{SIGNALS}/")) if has_signals else ()
            missing.append(replace(log, reused=reused, reused_settings=row.signals if reused else ""))
    return sorted(missing, key=lambda log: (-log.held.size_bytes, log.source))


def made_here(job: Job, logs: Sequence[LakeLog], jobs: int, stop: Trigger) -> Rows:
    """Yield the rows of logs as processes of this machine make them, in no order."""
    for log, future in run_in_processes(partial(make_in_worker, job), logs, jobs, stop, is_shown=True):
        try:
            yield future.result()
        except BrokenProcessPool:
            yield row_of(job, log, reason=DEADLY)


def trusted_scheduler(text: str, tls: TlsFiles) -> str:
    """Return the address of the scheduler at ``tls://HOST:PORT``, its certificate seen: Dask compares no name.

    Whoever reaches a scheduler can have any program run by its workers, so nobody does without a certificate of the
    authority, not even on the same machine. Raises ConfigError if it is anything else or is not to be trusted,
    StoreError if nobody is there.
    """
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port or DEFAULT_PORT
    except ValueError as exc:
        raise ConfigError(f"{text} is not an address of a scheduler: {exc}") from exc
    if parts.scheme != SCHEME or not host or parts.username or parts.path.strip("/") or parts.query:
        raise ConfigError(f"{text}: a scheduler is reached by tls://HOST:PORT only: its workers run what they are sent")
    if tls.authority is None or tls.certificate is None or tls.key is None:
        raise ConfigError("a cluster needs --ca, --cert and --key (docs/operations.md shows how to make them)")
    try:
        with (
            socket.create_connection((host, port), CONNECT_TIMEOUT_S) as plain,
            tls.context().wrap_socket(plain, server_hostname=host) as secure,
        ):
            secure.recv(1)  # with TLS 1.3 a refused certificate is heard of only here
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    except ssl.SSLError as exc:
        raise ConfigError(f"{text} is not trusted, or does not trust us: {exc.reason or exc}") from exc
    except OSError as exc:
        raise StoreError(f"no scheduler at {text}: {exc.strerror or exc}") from exc
    return f"{SCHEME}://[{host}]:{port}" if ":" in host else f"{SCHEME}://{host}:{port}"


def made_by_cluster(job: Job, logs: Sequence[LakeLog], address: str, tls: TlsFiles, stop: Trigger) -> Rows:
    """Yield the rows of logs as workers of Dask make them, in no order; a log that ended several of them is told."""
    distributed = load_extra("distributed", "a cluster needs Dask", "cluster", ".")
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what a run needs to know is told by us
    files = {"tls_ca_file": str(tls.authority), "tls_client_cert": str(tls.certificate), "tls_client_key": str(tls.key)}
    security = distributed.Security(require_encryption=True, **files)
    try:
        client = distributed.Client(address, security=security, set_as_default=False, timeout=CONNECT_TIMEOUT_S)
    except OSError as exc:
        raise StoreError(f"no scheduler at {address}: {exc}") from exc
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError as exc:
            raise StoreError(f"{address} has no worker; run the same command again when it has one") from exc
        pool, suspects = client.get_executor(pure=False, retries=RETRIES), deque[LakeLog]()
        # A worker that dies has the next log already: those that were at it are done again one at a time.
        for waiting, most in ((deque(logs), MOST_HANDED_OUT), (suspects, 1)):
            for log, future in run_in_pool(pool, partial(make_in_worker, job), waiting, most, stop):
                if future.cancelled():
                    if stop.is_set:
                        continue
                    raise StoreError(f"{address} is gone; run the same command again to continue")
                error = future.exception()
                if not isinstance(error, distributed.KilledWorker | StoreError | ConfigError | None):
                    raise ConfigError(f"a worker cannot do this work: {type(error).__name__}: {error}") from error
                if not isinstance(error, distributed.KilledWorker):
                    yield future.result()
                elif waiting is suspects:
                    yield row_of(job, log, reason=DEADLY)
                else:
                    suspects.append(log)
