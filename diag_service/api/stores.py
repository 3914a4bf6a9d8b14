"""What stores tell, and the report, from Python."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Unpack

from canlog.logs import STANDARD_INPUT
from canlog.logs.reading import Watch
from clutch_model.calibration import nominal_calibration
from clutch_results.records import FluidFill, ShiftResult, iso_utc, shift_from
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, configuration, path_list
from diag_service.console import collected_notices
from diag_service.errors import ConfigError
from diag_service.report.findings import Findings, findings_of_logs, findings_of_store
from diag_service.report.history import history_records
from diag_service.report.page import html_of, write_page
from diag_service.service.session import utc_now
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import StoreReader, is_store, note_fill
from fleet_contract.orders import EARLIEST

MOST_CHARACTERS: Final = 200  # of a name or a note
_CLOCK_ERROR: Final = timedelta(minutes=5)  # by which the clocks of people and machines may differ


def write_report(
    paths: AnyPaths,
    output: AnyPath,
    *,
    is_full: bool = False,
    **meaning: Unpack[LogMeaning],
) -> int:
    """Write what the logs of a drive, or a store, say as one HTML page: ``diag-service report``.

    Parameters
    ----------
    paths
        The logs of one drive, or one store.
    output
        The page, ``.html``; one that is there is replaced.
    is_full
        Whether everything else follows the sheet: numbers, single shifts, data quality, all events.
    vehicle, dbc, profile, calibration, columns
        As of ``analyze``; ``vehicle`` also says which one of a store is meant.

    Returns
    -------
    int
        The size of the page [bytes].

    Raises
    ------
    ConfigError, SourceError, StoreError
        If an argument, a log or the store cannot be used, or the page cannot be written.
    """
    check_name(Path(output))
    with collected_notices():
        found = findings_of(configuration(**meaning), path_list(paths), meaning.get("vehicle"), Trigger())
        return write_page(Path(output), html_of(found, utc_now(), is_full=is_full))


def history(store: AnyPath, *, vehicle: str | None = None, clutches: Sequence[int] = (1, 2)) -> list[dict[str, Any]]:
    """Return how the friction of each clutch went: the records of ``diag-service history --json``.

    Raises
    ------
    ConfigError, StoreError
        If the store cannot be read, or holds several vehicles and none is named.
    """
    found = findings_of_store(Path(store), vehicle, nominal_calibration())
    return [dict(record) for record in history_records(found, tuple(clutches))]


def stored_shift(store: AnyPath, shift: int) -> ShiftResult:
    """Return a shift of a store by the number that ``history`` has for it; raises ConfigError or StoreError."""
    with StoreReader.open(Path(store)) as reader:
        return shift_from(reader.record(shift))


def note_fluid(
    store: AnyPath,
    *,
    vehicle: str | None = None,
    at: datetime | str | None = None,
    odometer_km: float | None = None,
    product: str | None = None,
    note: str | None = None,
    is_insisted: bool = False,
) -> FluidFill:
    """Note new fluid, as ``diag-service fluid-changed`` does: the next shift after it begins a new baseline.

    Parameters
    ----------
    at
        When it was filled, ISO 8601 if a text, UTC unless it has a zone; by default now.
    odometer_km, product, note
        What is known of it.
    is_insisted
        Whether the odometer is right though it does not fit to the results.
    store, vehicle
        The store, and which vehicle of it.

    Raises
    ------
    ConfigError, StoreError
        If an argument or the store cannot be used.
    """
    with StoreReader.open(Path(store)) as reader:
        vehicle = reader.vehicle(vehicle)
    fill = FluidFill(
        vehicle=vehicle,
        filled_at=moment_of(at),
        odometer_m=_metres(odometer_km),
        product=_text("--product", product),
        note=_text("--note", note),
    )
    return note_fill(Path(store), fill, is_insisted=is_insisted)


def moment_of(at: datetime | str | None) -> str:
    """Return the moment of a fill: what is given, in UTC unless it has a zone, or now.

    Raises ConfigError if the text is no moment, one that is still to come or too long ago.
    """
    now = datetime.now(UTC)
    if at is None:
        return iso_utc(now)
    text = at if isinstance(at, str) else at.isoformat()
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise ConfigError(f"--at {text!r} is not a date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc
    if moment < EARLIEST:
        raise ConfigError(f"--at {text} is too long ago")
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


def findings_of(
    config: DiagnosisConfig, paths: Sequence[Path], vehicle: str | None, stop: Trigger, *, watch: Watch | None = None
) -> Findings:
    """Return what a report is made of: the logs of a drive, or a store and which vehicle of it is meant."""
    stores = [path for path in paths if path != STANDARD_INPUT and is_store(path)]
    if not stores:
        return findings_of_logs(config, paths, stop, watch=watch)
    if len(paths) > 1:
        raise ConfigError(f"{stores[0]} is a store: a report is of one store, or of the logs of one drive")
    return findings_of_store(stores[0], vehicle or config.calibration.vehicle, config.calibration)


def check_name(path: Path) -> None:
    """Raise ConfigError unless a file is called as a page is."""
    if path.suffix.lower() not in {".html", ".htm", ".pdf"}:
        raise ConfigError(f"{path}: a report is written as .html or .pdf")
