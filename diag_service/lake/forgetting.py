"""One vehicle taken out of a lake, with a proof; and whether manifest and parts of a lake agree."""

from dataclasses import dataclass

from diag_service.errors import StoreError
from diag_service.lake.manifest import DONE, Manifest
from diag_service.lake.parts import SHIFTS, SIGNALS
from diag_service.lake.places import Held, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class Forgotten:
    """What was taken out of a lake."""

    vehicle: str
    parts: tuple[str, ...]
    part_bytes: int
    rows: int  # of the manifest
    shifts: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """What of manifest and parts has no counterpart; a lake that is as it should be has neither."""

    missing: tuple[str, ...]  # parts that a row speaks of
    unknown: tuple[str, ...]  # parts that no row speaks of
    twice: tuple[str, ...]  # logs whose shifts are in more than one state


def parts_of(lake: Place, *, with_unfinished: bool = False) -> dict[str, Held]:
    """Return all parts of a lake, if asked for with those that a killed process has not finished."""
    shifts, signals = (lake.held(kind, with_unfinished=with_unfinished) for kind in (SHIFTS, SIGNALS))
    return shifts | signals


def forget(lake: Place, vehicle: str) -> Forgotten:
    """Take one vehicle out of a lake: its parts, whoever made them, its rows, its folders; then look again.

    Logs that are not in the lake, and copies that others made of it, stay.

    Raises StoreError if anything of the vehicle is still there afterwards.
    """
    manifest = Manifest(lake)
    rows = [row for row in manifest.rows if row.vehicle == vehicle]
    found = _of(vehicle, lake)
    lake.remove(found)
    manifest.put_together(without=[row.source for row in rows])
    folders = [name for kind in (SHIFTS, SIGNALS) for name in lake.remove_folders(f"{kind}/*/{_folder(vehicle)}")]
    left = [*_of(vehicle, lake), *folders, *(row.source for row in Manifest(lake).rows if row.vehicle == vehicle)]
    if left:
        raise StoreError(f"{len(left)} things of {vehicle} are still in {lake.address}, the first: {left[0]}")
    return Forgotten(
        vehicle=vehicle,
        parts=tuple(found),
        part_bytes=sum(one.size_bytes for one in found.values()),
        rows=len(rows),
        shifts=sum(row.shifts for row in rows),
    )


def disagreement(lake: Place) -> Disagreement:
    """Return in what manifest and parts disagree."""
    rows, there = Manifest(lake).rows, set(parts_of(lake))
    known = {part for row in rows for part in row.parts}
    shifts: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        if row.outcome == DONE:
            shifts.setdefault((row.content, row.vehicle), set()).add(row.settings)
    twice = sorted({content for (content, _), settings in shifts.items() if len(settings) > 1})
    return Disagreement(missing=tuple(sorted(known - there)), unknown=tuple(sorted(there - known)), twice=tuple(twice))


def _of(vehicle: str, lake: Place) -> dict[str, Held]:
    parts = parts_of(lake, with_unfinished=True)
    return {name: one for name, one in parts.items() if f"/{_folder(vehicle)}/" in name}


def _folder(vehicle: str) -> str:
    return f"vehicle={vehicle}"
