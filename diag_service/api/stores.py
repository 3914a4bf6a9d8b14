"""What stores tell, and the report, from Python."""

import math
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Unpack

from canlog.logs import STANDARD_INPUT
from canlog.logs.reading import Watch
from clutch_model.calibration import nominal_calibration, read_calibration
from clutch_results.clocks import nanoseconds
from clutch_results.records import FluidFill, ShiftResult, iso_utc, shift_from
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, named, path_list
from diag_service.console import SILENT, ReadingLine, collected_notices
from diag_service.errors import ConfigError
from diag_service.report.findings import Findings, findings_of_logs, findings_of_store
from diag_service.report.history import history_records
from diag_service.report.page import html_of, write_page
from diag_service.service.drive import check_complete
from diag_service.service.session import utc_now
from diag_service.settings.options import (
    FluidOptions,
    HistoryOptions,
    ReportOptions,
    check_replaceable,
    diagnosis_config,
)
from diag_service.stopping import Controls, Trigger
from diag_service.store import StoreReader, is_store, note_fill, withdraw_fill
from fleet_contract import JsonObject
from fleet_contract.orders import EARLIEST

PAGE_SUFFIXES: Final = (".html", ".htm", ".pdf")
MOST_CHARACTERS: Final = 200  # of a name or a note
_CLOCK_ERROR: Final = timedelta(minutes=5)  # by which the clocks of people and machines may differ


def write_report(paths: AnyPaths, output: AnyPath, *, is_full: bool = False, **meaning: Unpack[LogMeaning]) -> int:
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
    options = ReportOptions(logs=path_list(paths), output=Path(output), full=is_full, force=True, **named(meaning))
    with collected_notices():
        return make_report(options, Controls())


def make_report(
    options: ReportOptions,
    controls: Controls,
    line: ReadingLine = SILENT,
    conclude: Callable[[int], None] | None = None,  # None: a part of a drive is welcome, too
) -> int:
    """Write a report and return its size [bytes], which ``conclude`` is told before a part of a drive is refused."""
    if options.output.suffix.lower() not in PAGE_SUFFIXES:
        raise ConfigError(f"{options.output}: a report is written as .html or .pdf")
    check_replaceable(options.output, is_forced=options.force)
    findings = _findings_of(options, controls.stop, line.watch)
    line.show("making the page")
    size_bytes = write_page(options.output, html_of(findings, utc_now(), is_full=options.full))
    if conclude is not None:
        conclude(size_bytes)
        if findings.summary is not None:
            check_complete(findings.summary.gaps, findings.summary.contributions, is_strict=False)
    return size_bytes


def history(store: AnyPath, *, vehicle: str | None = None, clutches: Sequence[int] = (1, 2)) -> list[dict[str, Any]]:
    """Return how the friction of each clutch went: the records of ``diag-service history --json``.

    Raises
    ------
    ConfigError, StoreError
        If the store cannot be read, or holds several vehicles and none is named.
    """
    findings = past_of(HistoryOptions(store=Path(store), vehicle=vehicle))
    return [dict(record) for record in history_records(findings, tuple(clutches))]


def past_of(options: HistoryOptions) -> Findings:
    """Return what a store holds of a vehicle; raises ConfigError or StoreError."""
    path = options.calibration
    return findings_of_store(
        options.store,
        options.vehicle,
        nominal_calibration() if path is None else read_calibration(path),
        nanoseconds(utc_now()),
    )


def stored_shift(store: AnyPath, shift: int) -> ShiftResult:
    """Return a shift of a store by the number that ``history`` has for it; raises ConfigError or StoreError."""
    return shift_from(stored_record(Path(store), shift))


def stored_record(store: Path, shift: int) -> JsonObject:
    """Return the record of a shift as it was stored."""
    with StoreReader.open(store) as reader:
        return reader.record(shift)


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


def withdraw_fluid(options: FluidOptions) -> FluidFill:
    """Withdraw the last fill, or the one within a day of the moment that is named, and return it."""
    with StoreReader.open(options.store) as reader:
        vehicle = reader.vehicle(options.vehicle)
    return withdraw_fill(options.store, vehicle, None if options.at is None else moment_of(options.at))


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


def _findings_of(options: ReportOptions, stop: Trigger, watch: Watch) -> Findings:
    """Return what a report is made of: the logs of a drive, or a store and which vehicle of it is meant."""
    config = diagnosis_config(options)
    store = store_among(options.logs)
    if store is None:
        return findings_of_logs(config, options.logs, stop, watch=watch)
    if len(options.logs) > 1:
        raise ConfigError(f"{store} is a store: a report is of one store, or of the logs of one drive")
    vehicle = options.vehicle or config.calibration.vehicle
    return findings_of_store(store, vehicle, config.calibration, nanoseconds(utc_now()))


def store_among(paths: Iterable[Path | str]) -> Path | None:
    """Return the first of some files that is a store of results."""
    files = (path for path in paths if isinstance(path, Path) and path != STANDARD_INPUT)
    return next(filter(is_store, files), None)
