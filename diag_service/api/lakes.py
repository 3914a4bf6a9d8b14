"""Lakes: filled with what logs say, checked, and rid of a vehicle."""

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from diag_service.batch.worker import job_count, progress_bar
from diag_service.errors import StoppedError, StoreError
from diag_service.lake.parts import (
    DONE,
    FAILED,
    UNFINISHED,
    Disagreement,
    LogRow,
    Manifest,
    Place,
    RemovedParts,
    disagreement,
    forget,
    mend,
    parts_of,
)
from diag_service.lake.run import Job, find_logs, made_by_cluster, made_here, to_do, trusted_scheduler
from diag_service.settings.config import check_vehicle
from diag_service.settings.options import AnalyzeOptions, diagnosis_config, tls_files
from diag_service.stopping import Controls

SHOWN: Final = 5  # vehicles that are there
LOCAL: Final = "local"


def forget_vehicle(place: Path | str, vehicle: str) -> RemovedParts:
    """Remove a vehicle from a lake and return what is gone; raises StoreError if the lake had nothing of it."""
    lake = Place(str(place))
    gone = forget(lake, check_vehicle(vehicle))
    if not gone.parts and not gone.rows:
        known = sorted({row.vehicle for row in Manifest(lake).rows})
        shown = get_close_matches(gone.vehicle, known, n=SHOWN) or known[:SHOWN]
        others = f"; it has {', '.join(shown)}{'' if len(shown) == len(known) else ' and others'}" if known else ""
        raise StoreError(f"lake {lake.address} has nothing of {gone.vehicle}{others}")
    return gone


def check_lake(place: Path | str, *, repair: bool) -> Disagreement:
    """Return what is in a lake and in what manifest and parts disagree, after a repair if that is wanted."""
    lake = Place(str(place))
    if repair:
        mend(lake, disagreement(lake).missing)
        every = (part.name for part in parts_of(lake, with_unfinished=True))
        lake.remove([*disagreement(lake).unknown, *(name for name in every if name.endswith(UNFINISHED))])
    return disagreement(lake)


def fill_from_logs(
    options: AnalyzeOptions, controls: Controls, tell: Callable[[LogRow], None]
) -> tuple[str, Counter[str]]:
    """Bring a lake up to date with logs, by a scheduler's workers or by processes of this machine; ``tell`` of each.

    Return the lake's address, how many ``logs`` there are, and how many of them were in it ``before``, ``done``,
    ``failed``, their ``shifts``, and how many of all are ``held``.

    Started again after whatever ended it, it goes on where it was. Raises ConfigError, what workers raise, and
    StoppedError if it was stopped before everything was done.
    """
    jobs, scheduler = job_count(options.jobs), None
    if options.scheduler != LOCAL:
        tls = tls_files(options)
        scheduler = trusted_scheduler(options.scheduler, tls), tls
    # The certificates are the scheduler's, and nothing is published.
    config = diagnosis_config(replace(options, ca=None, cert=None, key=None, broker=None, store_budget=None))
    lake = Place(str(options.lake))
    has_vehicles = options.vehicle_from is not None
    logs = find_logs([str(log) for log in options.logs], lake, config.vehicle, has_vehicles=has_vehicles)
    for vehicle in {log.vehicle for log in logs}:
        replace(config, vehicle=check_vehicle(vehicle))  # complains of a calibration of another one
    job = Job.of(config, lake.address, options.signals, options.time_limit)
    manifest = Manifest(lake)
    missing = to_do(job, logs, manifest, is_retried=options.retry)
    counts = Counter[str](logs=len(logs), before=len(logs) - len(missing))
    rows = (
        made_by_cluster(job, missing, *scheduler, controls.stop)
        if scheduler
        else made_here(job, missing, jobs, controls.stop)
    )
    with closing(rows), closing(manifest), progress_bar(is_shown=True) as bar:
        task = bar.add_task("analysing", total=sum(log.held.size_bytes for log in missing), done=0, of=len(missing))
        for row in rows if missing else ():
            manifest.note(row)
            counts.update({row.outcome: 1, "shifts": row.shifts})
            bar.update(task, advance=row.size_bytes, done=counts[DONE] + counts[FAILED])
            tell(row)
    manifest.put_together()
    finished = counts["before"] + counts[DONE] + counts[FAILED]
    if finished < len(logs):
        raise StoppedError(
            f"stopped early: {finished} of {len(logs)} logs are done; run the same command again to continue"
        )
    rows_now = (manifest.row(log.source) for log in logs)
    counts["held"] = sum(row is not None and row.outcome == DONE for row in rows_now)
    return lake.address, counts
