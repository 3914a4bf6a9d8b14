"""``diag-service history``, ``show``, ``report`` and ``fluid-changed``: what a store holds, and notes in it."""

import json
import math
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Final

from canlog.logs import STANDARD_INPUT
from canlog.logs.reading import Watch
from clutch_model.calibration import nominal_calibration, read_calibration
from clutch_results.prognosis import Population, population_from
from clutch_results.records import FluidFill, dump, iso_utc
from clutchdiag_io.program import legible, replacement_refusal
from diag_service.console import PeopleConsole, ReadingLine, write_record
from diag_service.errors import ConfigError
from diag_service.report.findings import Findings, findings_of_logs, findings_of_store
from diag_service.report.history import history_lines, history_records, shift_lines
from diag_service.report.page import page_of, write_page
from diag_service.service.drive import insist
from diag_service.service.session import utc_now
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.config import DiagnosisConfig, diagnosis_config
from diag_service.store import StoreReader, is_store, note_fill, withdraw_fill
from fleet_contract.orders import EARLIEST

MOST_CHARACTERS: Final = 200  # of a name or a note
_CLOCK_ERROR: Final = timedelta(minutes=5)  # by which the clocks of people and machines may differ


def history(options: SimpleNamespace, controls: Controls) -> None:
    """Tell the history of one vehicle, on the clutches that are asked for."""
    del controls
    if options.rows < 1:
        raise ConfigError(f"--rows must be 1 or more, got {options.rows}")
    population = None if options.peers is None else _population(options.peers)
    calibration = nominal_calibration() if options.calibration is None else read_calibration(options.calibration)
    found = findings_of_store(options.store, options.vehicle, calibration)
    clutches = (1, 2) if options.clutch is None else (options.clutch,)
    if options.json:
        for record in history_records(found, clutches):
            sys.stdout.write(dump(record) + "\n")
        return
    PeopleConsole().print_all(history_lines(found, clutches, most_rows=options.rows, population=population))


def _population(path: Path) -> Population:
    """Return what a fleet taught, as ``fleet-backend peers --write`` wrote it."""
    try:
        return population_from(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError) as exc:
        raise ConfigError(f"{path}: {exc}") from exc


def show(options: SimpleNamespace, controls: Controls) -> None:
    del controls
    with StoreReader.open(options.store) as store:
        record = store.record(options.shift)
    write_record(record, shift_lines(record), as_json=options.json)


def fluid_changed(options: SimpleNamespace, controls: Controls) -> None:
    """Note the fill in the store; a service that is running takes it up before its next shift."""
    del controls
    if options.undo:
        with StoreReader.open(options.store) as store:
            vehicle = store.vehicle(options.vehicle)
        moment = None if options.at is None else moment_of(options.at, datetime.now(UTC))
        fill = withdraw_fill(options.store, vehicle, moment)
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


def moment_of(text: str | None, now: datetime) -> str:
    """Return the moment of a fill: what was said, in UTC unless it has a zone, or now.

    Raises ConfigError if the text is no moment, one that is still to come or too long ago.
    """
    if text is None:
        return iso_utc(now)
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


def report(options: SimpleNamespace, controls: Controls) -> None:
    """Write the report, and say where and how large it is."""
    check_name(options.output)
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    named, config = options.vehicle, diagnosis_config(options)  # which gives a vehicle without a name one
    with ReadingLine() as line:
        found = findings_of(config, options.logs, named, controls.stop, watch=line.watch)
        line.show("making the page")
        size_bytes = write_page(options.output, page_of(found, utc_now(), is_full=options.full))
    sys.stdout.write(f"{legible(str(options.output))}: {size_bytes / 1000.0:.0f} kB\n")
    if found.summary is not None:
        insist(found.summary.gaps, found.summary.contributions, is_strict=False)


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
    if path.suffix.lower() not in {".html", ".htm"}:
        raise ConfigError(f"{path}: a report is written as .html")
