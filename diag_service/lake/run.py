"""A run that makes a lake of logs: what is not in it yet is handed out, the largest first, and told row by row."""

import logging
import socket
import ssl
from collections import Counter, deque
from collections.abc import Generator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, TextIO
from urllib.parse import urlsplit

from canlog.extras import load_extra
from diag_service.batch.processes import DEADLY, handed_out, progress_bar, shared_out
from diag_service.batch.worker import leave_to_parent
from diag_service.errors import ConfigError, StoppedError, StoreError
from diag_service.lake.parts import DONE, FAILED, SIGNALS, LogRow, Manifest
from diag_service.lake.places import Place
from diag_service.lake.work import Job, LakeLog, make_in_worker, row_of
from diag_service.service.stopping import Trigger
from diag_service.settings.config import check_vehicle
from fleet_link import AddressError, TlsFiles

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
            what = "is a file: a lake is made of folders and stores" if Path(address).is_file() else "holds no log"
            raise ConfigError(f"{address} {what}")
        for name, one in held.items():
            own = check_vehicle(name.partition("/")[0] if "/" in name else "") if has_vehicles else vehicle
            log = LakeLog(place=place.address, held=one, vehicle=own)
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
            kept = tuple(part for part in row.parts if part.startswith(f"{SIGNALS}/")) if has_signals else ()
            missing.append(replace(log, kept=kept, kept_signals=row.signals if kept else ""))
    return sorted(missing, key=lambda log: (-log.held.size_bytes, log.source))


def fill_lake(
    job: Job,
    logs: Sequence[LakeLog],
    scheduler: tuple[str, TlsFiles] | None,
    *,
    jobs: int,
    stream: TextIO,
    stop: Trigger,
    is_shown: bool = False,
    is_retried: bool = False,
) -> Counter[str]:
    """Bring a lake up to date with logs, by a scheduler's workers or by processes of this machine.

    Return how many were in it ``before``, ``done``, ``failed``, their ``shifts``, and how many of all are ``held``.

    Started again after whatever ended it, it goes on where it was. Raises what workers raise, and StoppedError if it
    was stopped before everything was done.
    """
    lake, counts = Place(job.lake), Counter[str]()
    manifest = Manifest(lake)
    missing = to_do(job, logs, manifest, is_retried=is_retried)
    before = len(logs) - len(missing)
    rows = (
        _made_by_cluster(job, missing, *scheduler, stop)
        if scheduler
        else _made_here(job, missing, jobs, stop, is_shown)
    )
    with closing(rows), closing(manifest), progress_bar(is_shown=is_shown) as bar:
        task = bar.add_task("analysing", total=sum(log.held.size_bytes for log in missing), done=0, of=len(missing))
        for row in rows if missing else ():
            manifest.note(row)
            counts.update({row.outcome: 1, "shifts": row.shifts})
            bar.update(task, advance=row.size_bytes, done=counts[DONE] + counts[FAILED])
            result = f"{row.shifts} shifts" if row.outcome == DONE else "not analysed"
            stream.write(f"{row.source}: {result}{f'; {row.reason}' if row.reason else ''}\n")
            stream.flush()
    manifest.put_together()
    finished = before + counts[DONE] + counts[FAILED]
    if finished < len(logs):
        raise StoppedError(
            f"stopped early: {finished} of {len(logs)} logs are done; run the same command again to continue"
        )
    found = (manifest.row(log.source) for log in logs)
    counts.update({"before": before, "held": sum(row is not None and row.outcome == DONE for row in found)})
    return counts


def _made_here(job: Job, logs: Sequence[LakeLog], jobs: int, stop: Trigger, is_shown: bool) -> Rows:  # noqa: FBT001 - as a worker begins
    """Yield the rows of logs as processes of this machine make them, in no order."""
    for log, future in shared_out(partial(make_in_worker, job), logs, jobs, stop, leave_to_parent, (is_shown,)):
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


def _made_by_cluster(job: Job, logs: Sequence[LakeLog], address: str, tls: TlsFiles, stop: Trigger) -> Rows:
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
            for log, future in handed_out(pool, partial(make_in_worker, job), waiting, most, stop):
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
