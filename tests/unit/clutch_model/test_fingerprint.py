import math
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import date
from itertools import combinations
from typing import Any

import pytest

from clutch_model.calibration import (
    Calibration,
    FrictionCurve,
    SensorNoise,
    calibration_toml,
    nominal_calibration,
    read_calibration,
    shipped_table,
)
from clutch_model.fingerprint import canonical_text, fingerprint
from tests.golden import earlier

NOMINAL = nominal_calibration()
OF_A_VEHICLE = read_calibration(earlier.CALIBRATION)
Path = tuple[str | int, ...]


def leaves(table: object, path: Path = ()) -> Iterator[Path]:
    """Yield where every number and text of nested tables is."""
    entries = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list | tuple) else ()
    for key, value in entries:
        yield from leaves(value, (*path, key))
    if not isinstance(table, dict | list | tuple):
        yield path


def edited(table: Any, path: Path) -> Any:  # noqa: ANN401 - whatever a file holds
    """Return nested tables with the value at a path changed, a float in its last digit."""
    if isinstance(table, float):
        return math.nextafter(table, math.inf)
    if not path:
        return f"{table}x" if isinstance(table, str) else table + 1
    entries = dict(table) if isinstance(table, dict) else list(table)
    entries[path[0]] = edited(table[path[0]], path[1:])  # type: ignore[index]  # by its name or its place
    return entries


def turned(table: object) -> object:
    """Return nested tables with their keys in the opposite order."""
    if isinstance(table, dict):
        return {key: turned(table[key]) for key in reversed(table)}
    return [turned(one) for one in table] if isinstance(table, list) else table


@dataclass(frozen=True, slots=True, kw_only=True)
class Renamed(FrictionCurve):
    """A record that another program calls otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MoreNoise(SensorNoise):
    """A record of a program that knows one number more."""

    a_later_one: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class LaterTable:
    """A table that calibrations of today do not have."""

    share: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class WiderCalibration(Calibration):
    """A calibration of a program that knows one table more."""

    later: LaterTable = field(default_factory=LaterTable)


@pytest.mark.parametrize(
    ("calibration", "known"), [(NOMINAL, "1a23065176df"), (OF_A_VEHICLE, "dc5431dc3a92")], ids=["type", "vehicle"]
)
def test_the_fingerprint_of_an_unchanged_calibration_is_for_ever(calibration: Calibration, known: str) -> None:
    assert fingerprint(calibration) == known


def test_what_the_program_calls_its_records_does_not_count() -> None:
    clutch = NOMINAL.clutches[0]
    other = replace(clutch, friction=Renamed(**asdict(clutch.friction)))
    assert fingerprint(replace(NOMINAL, clutches=(other, NOMINAL.clutches[1]))) == fingerprint(NOMINAL)


@pytest.mark.parametrize("calibration", [NOMINAL, OF_A_VEHICLE], ids=["type", "vehicle"])
def test_every_number_and_text_counts(calibration: Calibration) -> None:
    table = tomllib.loads(calibration_toml(calibration))
    paths = [path for path in leaves(table) if not {"vehicle", "made_on", "correlation"} & set(path)]
    texts = {canonical_text(Calibration.from_mapping(edited(table, path))) for path in paths}
    assert len(texts) == len(paths) > 60
    assert canonical_text(calibration) not in texts


def test_every_correlation_counts() -> None:
    table = tomllib.loads(calibration_toml(OF_A_VEHICLE))
    count = len(table["joint"]["names"])
    texts = set()
    for row, column in combinations(range(count), 2):
        one_way = edited(table, ("joint", "correlation", row, column))
        both_ways = edited(one_way, ("joint", "correlation", column, row))
        texts.add(canonical_text(Calibration.from_mapping(both_ways)))
    assert len(texts) == count * (count - 1) // 2
    assert canonical_text(OF_A_VEHICLE) not in texts


def test_whose_it_is_and_since_when_does_not_count() -> None:
    named = replace(NOMINAL, vehicle="car1", made_on=date(2026, 1, 31))
    assert fingerprint(named) == fingerprint(NOMINAL)


def test_the_order_of_the_file_does_not_count() -> None:
    reordered = Calibration.from_mapping(turned(shipped_table()))  # type: ignore[arg-type]
    assert fingerprint(reordered) == fingerprint(NOMINAL)


def test_a_file_that_was_written_and_read_again_is_the_same() -> None:
    again = Calibration.from_mapping(tomllib.loads(calibration_toml(OF_A_VEHICLE)))
    assert fingerprint(again) == fingerprint(OF_A_VEHICLE)


@pytest.mark.parametrize(("said", "text"), [(0.5, ""), (0.6, ", a_later_one=0.6")])
def test_a_key_that_files_get_later_counts_where_it_is_not_at_its_default(said: float, text: str) -> None:
    wider = replace(NOMINAL, noise=MoreNoise(**asdict(NOMINAL.noise), a_later_one=said))
    assert canonical_text(wider) == canonical_text(NOMINAL).replace("), bias=", f"{text}), bias=")


@pytest.mark.parametrize(("said", "text"), [(0.5, ""), (0.6, ", later=later(share=0.6)")])
def test_a_table_that_files_get_later_counts_where_it_is_not_at_its_defaults(said: float, text: str) -> None:
    members = {one.name: getattr(NOMINAL, one.name) for one in fields(NOMINAL)}
    wider = WiderCalibration(**members, later=LaterTable(share=said))
    assert canonical_text(wider) == canonical_text(NOMINAL).removesuffix(")") + text + ")"
