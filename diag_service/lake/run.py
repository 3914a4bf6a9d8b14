"""A run that makes a lake of logs: what is not in it yet is handed out, the largest first, and told row by row."""

import logging
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Final, Self, TextIO

from canlog.errors import NOTICE
from diag_service.batch.processes import progress_bar
from diag_service.errors import ConfigError, StoppedError
from diag_service.lake.parts import DONE, FAILED, SIGNALS, LogRow, Manifest, copies, partition_of, strayed
from diag_service.lake.places import Place
from diag_service.lake.pools import ClusterAddress, ClusterPool, LocalPool, Pool
from diag_service.lake.work import Job, LakeLog, row_of
from diag_service.service.stopping import Trigger
from diag_service.settings.config import check_vehicle

POLL_S: Final = 0.2  # how soon a request to stop is heard
WAITING_PER_WORKER: Final = 2  # logs handed out ahead: nobody waits, and memory and what a stop throws away are bounded
MOST_DEATHS: Final = 2  # of a log's process with nothing beside it: then it is the log
DEADLY: Final = f"its process died each time, {MOST_DEATHS} times with no other log beside it: out of memory or time?"
MOST_REFUSALS: Final = 3  # of a store, each after its own attempts
ROWS_PER_FILE: Final = 256
FILE_EVERY_S: Final = 5.0
GROUP_LOGS: Final = 50_000  # whose rows of the manifest are held together, and those of their vehicles
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class LakeTotals:
    """What became of the logs of a run."""

    found: int
    before: int  # in the lake already, as they are
    done: int
    failed: int
    shifts: int
    holds_any: bool  # whether any of them, now or before, was analysed


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
    scheduler: ClusterAddress | None,
    *,
    jobs: int,
    stream: TextIO,
    stop: Trigger,
    is_shown: bool = False,
    is_retried: bool = False,
) -> LakeTotals:
    """Bring a lake up to date with logs; a scheduler of ``None`` stands for processes of this machine.

    Started again after whatever ended it, it goes on where it was. Raises what the pools raise, and StoppedError if it
    was stopped before everything was done.
    """
    lake = Place(job.lake)
    before, holds_any, counts = 0, False, Counter[str]()
    for group, partitions in _groups(logs, lake):
        manifest = Manifest(lake, partitions)
        missing = to_do(job, group, manifest, is_retried=is_retried)
        before += len(group) - len(missing)
        if len(missing) < len(group):
            _LOG.log(NOTICE, "%d of %d logs were done before", len(group) - len(missing), len(group))
        if missing:
            pool: Pool = (
                ClusterPool(job, scheduler) if scheduler else LocalPool(job, min(jobs, len(missing)), is_shown=is_shown)
            )
            size_bytes = sum(log.held.size_bytes for log in missing)
            with closing(pool), Ledger(manifest, lake) as ledger, progress_bar(is_shown=is_shown) as bar:
                task = bar.add_task("analysing", total=size_bytes, done=0, of=len(missing))
                for row in Dispatch(job, pool, missing, stop).rows():
                    ledger.add(row)
                    counts.update({row.outcome: 1, "shifts": row.shifts})
                    bar.update(task, advance=row.size_bytes, done=counts[DONE] + counts[FAILED])
                    stream.write(line_of(row) + "\n")
                    stream.flush()
        rows = (manifest.row(log.source) for log in group)
        holds_any = holds_any or any(row is not None and row.outcome == DONE for row in rows)
        manifest.put_together()
        if stop.is_set:
            break
    finished = before + counts[DONE] + counts[FAILED]
    if finished < len(logs):
        raise StoppedError(
            f"stopped early: {finished} of {len(logs)} logs are done; run the same command again to continue"
        )
    made = {"done": counts[DONE], "failed": counts[FAILED], "shifts": counts["shifts"]}
    return LakeTotals(found=len(logs), before=before, holds_any=holds_any, **made)


def _groups(logs: Sequence[LakeLog], lake: Place) -> Iterator[tuple[list[LakeLog], set[str]]]:
    """Yield logs that are worked on together, with the partitions of the manifest that know of them."""
    others = strayed(lake, {log.source: log.vehicle for log in logs})
    group, known = list[LakeLog](), set[str]()
    for partition, own in groupby(sorted(logs, key=_partition), _partition):
        group += own
        known.add(partition)
        known.update(
            partition_of(one) for now, before in others.items() if partition_of(now) == partition for one in before
        )
        if len(group) >= GROUP_LOGS:
            yield group, known
            group, known = [], set()
    if group:
        yield group, known


def _partition(log: LakeLog) -> str:
    return partition_of(log.vehicle)


def line_of(row: LogRow) -> str:
    said = f"{row.shifts} shifts" if row.outcome == DONE else "not analysed"
    return f"{row.source}: {said}{f'; {row.reason}' if row.reason else ''}"


class Dispatch:
    """Hands logs out, a bounded number at a time.

    One whose process died is tried again alone, so that none is blamed for another.
    """

    def __init__(self, job: Job, pool: Pool, logs: Sequence[LakeLog], stop: Trigger) -> None:
        self._job = job
        self._pool = pool
        self._waiting = deque(logs)
        self._suspects: deque[LakeLog] = deque()
        self._stop = stop
        self._running_count = 0
        self._attempts: Counter[str] = Counter()
        self._deaths_alone: Counter[str] = Counter()
        self._refusals: Counter[str] = Counter()

    def rows(self) -> Iterator[LogRow]:
        """Yield rows as logs are done, in no order; when told to stop, those that were begun."""
        while self._running_count or ((self._waiting or self._suspects) and not self._stop.is_set):
            if self._stop.is_set:
                self._running_count -= len(self._pool.withdraw())
            else:
                self._hand_out()
            was_alone = self._running_count == 1 and not self._waiting
            for outcome in self._pool.finished(POLL_S):
                self._running_count -= 1
                if outcome.row is not None:
                    yield outcome.row
                elif outcome.error is not None:
                    self._refusals[outcome.log.source] += 1
                    if self._refusals[outcome.log.source] >= MOST_REFUSALS:
                        raise outcome.error
                    self._waiting.append(outcome.log)
                elif not outcome.is_blamed:
                    self._waiting.appendleft(outcome.log)
                else:
                    self._deaths_alone[outcome.log.source] += was_alone
                    if self._deaths_alone[outcome.log.source] < MOST_DEATHS:
                        self._suspects.append(outcome.log)
                    else:
                        yield row_of(self._job, outcome.log, self._attempts[outcome.log.source], reason=DEADLY)

    def _hand_out(self) -> None:
        most = WAITING_PER_WORKER * self._pool.width
        while self._waiting and self._running_count < most:
            self._submit(self._waiting.popleft())
        if self._suspects and not self._running_count:
            self._submit(self._suspects.popleft())

    def _submit(self, log: LakeLog) -> None:
        self._attempts[log.source] += 1
        self._running_count += 1
        self._pool.submit(log, self._attempts[log.source])


class Ledger:
    """Brings rows into the manifest, many at once, and then removes what they made superfluous."""

    def __init__(self, manifest: Manifest, lake: Place) -> None:
        self._manifest = manifest
        self._lake = lake
        self._rows: list[LogRow] = []
        self._due_s = time.monotonic() + FILE_EVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.write()

    def add(self, row: LogRow) -> None:
        """Take a row, whose parts are there."""
        self._rows.append(row)
        if len(self._rows) >= ROWS_PER_FILE or time.monotonic() >= self._due_s:
            self.write()

    def write(self) -> None:
        """Write the rows, in place of parts of before."""
        rows = [*self._rows, *copies(self._manifest.rows, self._rows)]
        self._lake.remove(self._manifest.superseded(rows))  # first: a kill after it leaves a row that is made anew
        self._manifest.add(rows)
        self._rows = []
        self._due_s = time.monotonic() + FILE_EVERY_S
