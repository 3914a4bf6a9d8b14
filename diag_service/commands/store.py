"""``diag-service history``, ``show``, ``report`` and ``fluid-changed``: what a store holds, and notes in it."""

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.text import Text

from clutch_model.calibration import nominal_calibration, read_calibration
from clutch_model.units import for_people, reading_of
from clutch_results.prognosis import Population, population_from
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.people import PLUS_MINUS, STDS, digits
from clutchdiag_io.program import legible, replacement_refusal
from diag_service.api.choices import diagnosis_config
from diag_service.api.stores import check_name, findings_of, moment_of, note_fluid
from diag_service.console import ReadingLine, write_record
from diag_service.errors import ConfigError
from diag_service.report.findings import findings_of_store
from diag_service.report.history import history_lines, history_records
from diag_service.report.page import html_of, write_page
from diag_service.service.drive import insist
from diag_service.service.session import utc_now
from diag_service.service.stopping import Controls
from diag_service.settings.config import MeaningOptions
from diag_service.store import StoreReader, withdraw_fill
from fleet_contract import JsonObject

NONE: Final = "-"


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryOptions:
    """Whose history is shown, and how."""

    store: Path
    vehicle: str | None
    clutch: int | None
    rows: int
    calibration: Path | None
    peers: Path | None
    json: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidOptions:
    """Which fill of fluid is noted, or taken back."""

    store: Path
    vehicle: str | None
    at: str | None
    odometer: float | None  # [km]
    product: str | None
    note: str | None
    insist: bool
    undo: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions(MeaningOptions):
    """What a report is of, and where it goes."""

    logs: tuple[Path, ...]  # or a store
    output: Path
    full: bool
    force: bool


def history(options: HistoryOptions) -> None:
    """Tell the history of one vehicle, on the clutches that are asked for."""
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


def show(store: Path, shift: int, *, json: bool) -> None:
    with StoreReader.open(store) as reader:
        record = reader.record(shift)
    write_record(record, shift_lines(record), as_json=json)


def fluid_changed(options: FluidOptions) -> None:
    """Note the fill in the store; a service that is running takes it up before its next shift."""
    if options.undo:
        with StoreReader.open(options.store) as store:
            vehicle = store.vehicle(options.vehicle)
        fill = withdraw_fill(options.store, vehicle, None if options.at is None else moment_of(options.at))
        sys.stdout.write(f"{fill.vehicle}: the fill at {fill.filled_at} is taken back\n")
        return
    fill = note_fluid(
        options.store,
        vehicle=options.vehicle,
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


def report(options: ReportOptions, controls: Controls) -> None:
    """Write the report, and say where and how large it is."""
    check_name(options.output)
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    config = diagnosis_config(options)
    with ReadingLine() as line:
        found = findings_of(config, options.logs, options.vehicle, controls.stop, watch=line.watch)
        line.show("making the page")
        size_bytes = write_page(options.output, html_of(found, utc_now(), is_full=options.full))
    sys.stdout.write(f"{legible(str(options.output))}: {size_bytes / 1000.0:.0f} kB\n")
    if found.summary is not None:
        insist(found.summary.gaps, found.summary.contributions, is_strict=False)


def shift_lines(record: JsonObject) -> Iterator[Text]:
    """Yield everything that is stored of a shift, a line per value; groups of values are indented."""
    verdict = record.get("verdict")
    if isinstance(verdict, Mapping) and verdict.get("advice"):
        yield Text(str(verdict["advice"]))
    yield Text(PLUS_MINUS)
    yield from _value_lines(record, "")


def _value_lines(table: Mapping[str, object], indent: str) -> Iterator[Text]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield Text(f"{indent}{name}")
            yield from _value_lines(value, f"{indent}  ")
        elif isinstance(value, list):
            words = (for_people(one, 0.0)[0] if isinstance(one, str) else str(one) for one in value)
            yield Text(f"{indent}{name}  {', '.join(words) or NONE}")
        elif (reading := reading_of(table, name)) is not None:
            label, amount, std, unit = reading
            spread = "" if std is None else f" ± {digits(STDS * std)}"
            yield Text(f"{indent}{label}  {digits(amount)}{spread} {unit}".rstrip())
        elif not isinstance(value, float):
            yield Text(f"{indent}{name}  {NONE if value is None else value}")
