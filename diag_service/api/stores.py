"""What stores tell, and the report, from Python."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Unpack

from clutch_model.calibration import nominal_calibration
from clutch_results.records import FluidFill, ShiftResult, shift_from
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, configuration, path_list
from diag_service.commands.store import check_name, findings_of, noted_fill
from diag_service.console import collected_notices
from diag_service.report.findings import findings_of_store
from diag_service.report.history import history_records
from diag_service.report.page import page_of, write_page
from diag_service.service.session import utc_now
from diag_service.service.stopping import Trigger
from diag_service.store import StoreReader


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
        Whether paper gets all sections, not only the first two pages.
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
        return write_page(Path(output), page_of(found, utc_now(), is_full=is_full))


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
    at: datetime | None = None,
    odometer_km: float | None = None,
    product: str | None = None,
    note: str | None = None,
    is_insisted: bool = False,
) -> FluidFill:
    """Note new fluid, as ``diag-service fluid-changed`` does: the next shift after it begins a new baseline.

    Parameters
    ----------
    at
        When it was filled, UTC unless it has a zone; by default now.
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
    moment = None if at is None else at.isoformat()
    return noted_fill(
        Path(store), vehicle, at=moment, odometer_km=odometer_km, product=product, note=note, is_insisted=is_insisted
    )
