"""``diag-service history``, ``show``, ``report`` and ``fluid-changed``: what a store holds, and notes in it."""

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from rich.text import Text

from canlog.files import read_small_file
from clutch_model.units import for_people, reading_of
from clutch_results.prognosis import Population, population_from
from clutch_results.records import dump, fill_words
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.people import PLUS_MINUS, STDS, digits
from clutchdiag_io.program import legible
from diag_service.api.stores import make_report, note_fluid, past_of, stored_record, withdraw_fluid
from diag_service.console import ReadingLine, write_record
from diag_service.errors import ConfigError
from diag_service.report.history import history_lines, history_records
from diag_service.settings.options import FluidOptions, HistoryOptions, ReportOptions
from diag_service.stopping import Controls
from fleet_contract import JsonObject

NONE: Final = "-"


def history(options: HistoryOptions) -> None:
    """Tell the history of one vehicle, on the clutches that are asked for."""
    if options.rows < 1:
        raise ConfigError(f"--rows must be 1 or more, got {options.rows}")
    population = None if options.peers is None else _population(options.peers)
    findings = past_of(options)
    clutches = (1, 2) if options.clutch is None else (options.clutch,)
    if options.json:
        for record in history_records(findings, clutches):
            sys.stdout.write(dump(record) + "\n")
        return
    PeopleConsole().print_all(history_lines(findings, clutches, most_rows=options.rows, population=population))


def _population(path: Path) -> Population:
    """Return what a fleet taught, as ``fleet-backend peers --write`` wrote it."""
    try:
        return population_from(json.loads(read_small_file(path)))
    except OSError as exc:
        raise ConfigError(f"cannot read {path}: {exc.strerror}") from exc
    except (ValueError, RecursionError) as exc:
        raise ConfigError(f"{path}: {exc}") from exc


def show(store: Path, shift: int, *, json: bool) -> None:
    record = stored_record(store, shift)
    write_record(record, shift_lines(record), as_json=json)


def fluid_changed(options: FluidOptions) -> None:
    """Note the fill in the store; a service that is running takes it up before its next shift."""
    if options.undo:
        fill = withdraw_fluid(options)
        sys.stdout.write(f"{fill.vehicle}: the fill at {fill_words(fill)} is taken back\n")
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
        f"{fill.vehicle}: {fill.product or 'new fluid'} since {fill_words(fill)}; "
        "the next shift after that begins a new baseline, what is known of sensors and lining stays\n"
    )


def report(options: ReportOptions, controls: Controls) -> None:
    """Write the report, and say where and how large it is."""

    def conclude(size_bytes: int) -> None:
        line.clear()
        sys.stdout.write(f"{legible(str(options.output))}: {size_bytes / 1000.0:.0f} kB\n")

    with ReadingLine() as line:
        make_report(options, controls, line, conclude)


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
            words = (for_people(item, 0.0)[0] if isinstance(item, str) else str(item) for item in value)
            yield Text(f"{indent}{name}  {', '.join(words) or NONE}")
        elif (reading := reading_of(table, name)) is not None:
            label, amount, std, unit = reading
            spread = "" if std is None else f" ± {digits(STDS * std)}"
            yield Text(f"{indent}{label}  {digits(amount)}{spread} {unit}".rstrip())
        elif not isinstance(value, float):
            yield Text(f"{indent}{name}  {NONE if value is None else value}")
