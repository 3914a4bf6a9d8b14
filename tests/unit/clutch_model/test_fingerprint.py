import math
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import pytest

from clutch_model.calibration import (
    Calibration,
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
class MoreNoise(SensorNoise):
    """A record of a program that knows one number more."""

    a_later_one: float = 0.5


@pytest.mark.parametrize(
    ("calibration", "known"), [(NOMINAL, "1a23065176df"), (OF_A_VEHICLE, "dc5431dc3a92")], ids=["type", "vehicle"]
)
def test_the_fingerprint_of_an_unchanged_calibration_is_for_ever(calibration: Calibration, known: str) -> None:
    assert fingerprint(calibration) == known


@pytest.mark.parametrize("calibration", [NOMINAL, OF_A_VEHICLE], ids=["type", "vehicle"])
def test_every_number_and_text_counts(calibration: Calibration) -> None:
    table = tomllib.loads(calibration_toml(calibration))
    paths = [path for path in leaves(table) if not {"vehicle", "made_on", "correlation"} & set(path)]
    texts = {canonical_text(Calibration.from_mapping(edited(table, path))) for path in paths}
    assert len(texts) == len(paths) > 60
    assert canonical_text(calibration) not in texts


def test_the_order_of_the_file_does_not_count() -> None:
    reordered = Calibration.from_mapping(turned(shipped_table()))  # type: ignore[arg-type]
    assert fingerprint(reordered) == fingerprint(NOMINAL)


@pytest.mark.parametrize(("said", "text"), [(0.5, ""), (0.6, ", a_later_one=0.6")])
def test_a_key_that_files_get_later_counts_where_it_is_not_at_its_default(said: float, text: str) -> None:
    wider = replace(NOMINAL, noise=MoreNoise(**asdict(NOMINAL.noise), a_later_one=said))
    assert canonical_text(wider) == canonical_text(NOMINAL).replace("), bias=", f"{text}), bias=")
