"""``diag-service lake`` and ``analyze --lake``: lakes are filled and checked."""

import logging
import sys
from dataclasses import asdict, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canlog.errors import NOTICE, SourceError
from canlog.logs import STANDARD_INPUT
from clutch_results.records import dump
from diag_service.api.choices import diagnosis_config
from diag_service.batch.worker import job_count
from diag_service.errors import ConfigError, IncompleteError, StoreError
from diag_service.lake.parts import UNFINISHED, Manifest, Place, disagreement, forget, mend, parts_of
from diag_service.lake.run import Job, fill_lake, find_logs, trusted_scheduler
from diag_service.service.stopping import Controls
from diag_service.settings.config import check_vehicle
from fleet_link import AddressError, TlsFiles

if TYPE_CHECKING:
    from diag_service.commands.analyze import AnalyzeOptions

FORGOTTEN_SCHEMA: Final = "clutchdiag/forgotten/v1"
SHOWN: Final = 5  # of what is wrong, of vehicles that are there
LOCAL: Final = "local"
_NOT_FOR_LAKES: Final = ("output", "store", "broker", "json", "force")
_LOG = logging.getLogger(__name__)


def forget_vehicle(place: Path | str, vehicle: str, *, json: bool) -> None:
    """Forget a vehicle; raises StoreError if the lake had nothing of it."""
    lake = Place(str(place))
    gone = forget(lake, check_vehicle(vehicle))
    if not gone.parts and not gone.rows:
        known = sorted({row.vehicle for row in Manifest(lake).rows})
        shown = get_close_matches(gone.vehicle, known, n=SHOWN) or known[:SHOWN]
        others = f"; it has {', '.join(shown)}{'' if len(shown) == len(known) else ' and others'}" if known else ""
        raise StoreError(f"lake {lake.address} has nothing of {gone.vehicle}{others}")
    if json:
        sys.stdout.write(dump({"schema": FORGOTTEN_SCHEMA, "lake": lake.address, **asdict(gone)}) + "\n")
        return
    sys.stdout.writelines(f"removed {part}\n" for part in gone.parts)
    sys.stdout.write(
        f"{gone.vehicle}: {len(gone.parts)} parts ({gone.part_bytes} bytes), {gone.rows} logs of the manifest with "
        f"{gone.shifts} shifts removed; a second check found nothing left. The logs themselves were not touched\n"
    )


def check(place: Path | str, *, repair: bool) -> None:
    """Show what is in a lake; raises IncompleteError if manifest and parts disagree."""
    lake = Place(str(place))
    found = disagreement(lake)
    if repair:
        mend(lake, found.missing)
        every = (part.name for part in parts_of(lake, with_unfinished=True))
        lake.remove([*disagreement(lake).unknown, *(name for name in every if name.endswith(UNFINISHED))])
        found = disagreement(lake)
    sys.stdout.write(found.told + "\n")
    wrong = {"missing": found.missing, "of no log": found.unknown, "of a log that is there in two states": found.twice}
    for what, names in wrong.items():
        if names:
            sys.stdout.write(f"{len(names)} parts {what}: {', '.join(names[:SHOWN])}\n")
    if any(wrong.values()):
        raise IncompleteError(
            f"{lake.address}: manifest and parts disagree; --repair, and then another run into it, mend that"
        )


def fill(options: "AnalyzeOptions", controls: Controls) -> None:
    """Bring a lake up to date.

    Raises ConfigError if the words contradict each other, SourceError if no log could be analysed, now or before, and
    what ``fill_lake`` raises.
    """
    _check_words(options)
    scheduler = None
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
        jobs=job_count(options.jobs),
        stream=sys.stdout,
        stop=controls.stop,
        is_shown=True,
        is_retried=options.retry,
    )
    sys.stdout.write(
        f"{len(logs)} logs: {totals['before']} in the lake before, {totals['done']} analysed with {totals['shifts']} "
        f"shifts, {totals['failed']} not\n"
    )
    if not totals["held"]:
        raise SourceError(f"none of {len(logs)} logs could be analysed; --retry tries them again")
    _LOG.log(NOTICE, "the lake is %s", lake.address)


def _check_words(options: "AnalyzeOptions") -> None:
    if given := [name for name in _NOT_FOR_LAKES if name in options.given]:
        raise ConfigError(f"--{given[0]} does not go with --lake: the results are in the lake")
    if options.estimator == "paper":
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not kept")
    if STANDARD_INPUT in options.logs:
        raise ConfigError("a lake is made of what lies in folders and stores: standard input does not go with it")
    if options.vehicle_from is not None and "vehicle" in options.given:
        raise ConfigError(
            "--vehicle-from takes the vehicles from the folders, --vehicle names one: use only one of them"
        )
    job_count(options.jobs)  # complains
    if options.scheduler == LOCAL and (options.ca or options.cert or options.key):
        raise ConfigError("--ca, --cert and --key are for a scheduler: --scheduler tls://HOST:PORT")


def tls_files(options: "AnalyzeOptions") -> TlsFiles:
    """Return the certificates of the command line; raises ConfigError if one of a pair is missing."""
    try:
        return TlsFiles(authority=options.ca, certificate=options.cert, key=options.key)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
