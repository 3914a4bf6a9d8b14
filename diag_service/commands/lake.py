"""``diag-service lake``: take a vehicle out of a lake, and see whether a lake is as it should be."""

import sys
from dataclasses import asdict
from difflib import get_close_matches
from types import SimpleNamespace
from typing import Final

from diag_service.diagnosis.results import dump
from diag_service.errors import IncompleteError, StoreError
from diag_service.lake.manifest import DONE, Manifest
from diag_service.lake.parts import disagreement, forget, parts_of
from diag_service.lake.places import Place
from diag_service.service.stopping import Controls
from diag_service.settings.config import check_vehicle

FORGOTTEN_SCHEMA: Final = "clutchdiag/forgotten/v1"
SHOWN: Final = 5  # of what is wrong, of vehicles that are there


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Do what is asked with a lake."""
    del controls
    lake = Place(str(options.lake))
    if options.action == "forget":
        _forget(options, lake)
    else:
        _check(options, lake)


def _forget(options: SimpleNamespace, lake: Place) -> None:
    """Forget a vehicle; raises StoreError if the lake had nothing of it."""
    gone = forget(lake, check_vehicle(options.vehicle))
    if not gone.parts and not gone.rows:
        known = sorted({row.vehicle for row in Manifest(lake).rows})
        shown = get_close_matches(gone.vehicle, known, n=SHOWN) or known[:SHOWN]
        others = f"; it has {', '.join(shown)}{'' if len(shown) == len(known) else ' and others'}" if known else ""
        raise StoreError(f"lake {lake.address} has nothing of {gone.vehicle}{others}")
    if options.json:
        sys.stdout.write(dump({"schema": FORGOTTEN_SCHEMA, "lake": lake.address, **asdict(gone)}) + "\n")
        return
    sys.stdout.writelines(f"removed {part}\n" for part in gone.parts)
    sys.stdout.write(
        f"{gone.vehicle}: {len(gone.parts)} parts ({gone.part_bytes} bytes), {gone.rows} logs of the manifest with "
        f"{gone.shifts} shifts removed; a second check found nothing left. The logs themselves were not touched\n"
    )


def _check(options: SimpleNamespace, lake: Place) -> None:
    """Show what is in a lake; raises IncompleteError if manifest and parts disagree."""
    found = disagreement(lake)
    if options.repair:
        unfinished = parts_of(lake, with_unfinished=True).keys() - parts_of(lake).keys()
        lake.remove([*found.unknown, *sorted(unfinished)])
        found = disagreement(lake)
    rows = Manifest(lake).rows
    done = [row for row in rows if row.outcome == DONE]
    sys.stdout.write(
        f"{len(rows)} logs, {len(rows) - len(done)} of them not analysed, {sum(row.shifts for row in done)} shifts of "
        f"{len({row.vehicle for row in rows})} vehicles in {len(parts_of(lake))} parts\n"
    )
    wrong = {"missing": found.missing, "of no log": found.unknown, "of a log that is there in two states": found.twice}
    for what, names in wrong.items():
        if names:
            sys.stdout.write(f"{len(names)} parts {what}: {', '.join(names[:SHOWN])}\n")
    if any(wrong.values()):
        raise IncompleteError(f"{lake.address}: manifest and parts disagree; another run into this lake repairs it")
