"""``diag-service fluid-changed``: the workshop notes new fluid; what was known of the old one says nothing any more."""

import math
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Final

from diag_service.diagnosis.records import FluidFill
from diag_service.diagnosis.results import iso_utc
from diag_service.errors import ConfigError
from diag_service.service.stopping import Controls
from diag_service.store import StoreReader, note_fill, withdraw_fill

MOST_CHARACTERS: Final = 200  # of a name or a note
_CLOCK_ERROR: Final = timedelta(minutes=5)  # by which the clocks of people and machines may differ


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Note the fill in the store; a service that is running takes it up before its next shift."""
    del controls
    if options.undo:
        fill = undone_fill(options.store, options.vehicle, at=options.at)
        sys.stdout.write(f"{fill.vehicle}: the fill at {fill.filled_at} is taken back\n")
        return
    fill = noted_fill(
        options.store,
        options.vehicle,
        at=options.at,
        odometer_km=options.odometer,
        product=options.product,
        note=options.note,
        is_insisted=options.insist,
    )
    sys.stdout.write(
        f"{fill.vehicle}: {fill.product or 'new fluid'} since {fill.filled_at}; "
        "the next shift after that begins a new baseline, what is known of sensors and lining stays\n"
    )


def noted_fill(
    path: Path,
    vehicle: str | None,
    *,
    at: str | None,
    odometer_km: float | None,
    product: str | None,
    note: str | None,
    is_insisted: bool = False,
) -> FluidFill:
    """Note a fill in a store and return it; raises ConfigError or StoreError."""
    with StoreReader.open(path) as store:
        vehicle = store.vehicle(vehicle)
    fill = FluidFill(
        vehicle=vehicle,
        filled_at=moment_of(at, datetime.now(UTC)),
        odometer_m=_metres(odometer_km),
        product=_text("--product", product),
        note=_text("--note", note),
    )
    return note_fill(path, fill, is_insisted=is_insisted)


def undone_fill(path: Path, vehicle: str | None, *, at: str | None) -> FluidFill:
    """Take back the last fill, or that of a moment, and return it; raises ConfigError or StoreError."""
    with StoreReader.open(path) as store:
        vehicle = store.vehicle(vehicle)
    return withdraw_fill(path, vehicle, None if at is None else moment_of(at, datetime.now(UTC)))


def moment_of(text: str | None, now: datetime) -> str:
    """Return the moment of a fill: what was said, in UTC unless it has a zone, or now.

    Raises
    ------
    ConfigError
        If the text is no moment, or one that is still to come.
    """
    if text is None:
        return iso_utc(now)
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise ConfigError(f"--at {text!r} is not a date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc
    if moment > now + _CLOCK_ERROR:
        raise ConfigError(f"--at {text} is still to come: note a fill when it is done")
    return iso_utc(moment)


def _metres(odometer_km: float | None) -> float | None:
    if odometer_km is None:
        return None
    if not math.isfinite(odometer_km) or odometer_km < 0.0:
        raise ConfigError(f"--odometer must be 0 km or more, got {odometer_km:g}")
    return odometer_km * 1000.0


def _text(name: str, text: str | None) -> str | None:
    if text is not None and (not text.isprintable() or not 0 < len(text) <= MOST_CHARACTERS):
        raise ConfigError(f"{name} must be 1 to {MOST_CHARACTERS} characters that can be printed")
    return text
