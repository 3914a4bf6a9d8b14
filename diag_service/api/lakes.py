"""Lakes: filled with what logs say, checked, and rid of a vehicle."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from diag_service.batch.worker import job_count
from diag_service.errors import StoreError
from diag_service.lake.parts import (
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
from diag_service.lake.run import Job, fill_lake, find_logs, trusted_scheduler
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
    """Bring a lake up to date and ``tell`` of each log that was analysed; return its address and the counts.

    Raises ConfigError and what ``fill_lake`` raises.
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
    totals = fill_lake(
        Job.of(config, lake.address, options.signals, options.time_limit),
        logs,
        scheduler,
        jobs=jobs,
        tell=tell,
        stop=controls.stop,
        is_shown=True,
        is_retried=options.retry,
    )
    totals["logs"] = len(logs)
    return lake.address, totals
