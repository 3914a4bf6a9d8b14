"""The JSON Schema of a transmission's description takes what the programs take, and refuses what they refuse."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from clutch_model.calibration import SHIPPED, Calibration
from clutch_model.errors import CalibrationError
from tests.tools.description_schema import SCHEMA, schema

VALIDATOR = jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))


def shipped(name: str = "nominal") -> dict[str, Any]:
    """Return a shipped description as it is written, ``like`` included."""
    return tomllib.loads((SCHEMA.parent / f"{name}.toml").read_text(encoding="utf-8"))


def test_the_schema_is_the_one_that_the_records_make() -> None:
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == json.loads(json.dumps(schema()))
    VALIDATOR.check_schema(VALIDATOR.schema)
    assert {path.stem for path in Path(SCHEMA.parent).glob("*.toml")} == set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_descriptions_conform(name: str) -> None:
    VALIDATOR.validate(shipped(name))


MISSING = object()


@pytest.mark.parametrize(
    ("value", "where"),
    [
        (MISSING, ("noise",)),
        (MISSING, ("clutch", "geometry", "piston_area_m2")),
        (1.0, ("pressure",)),
        (1.0, ("clutch", "film", "thickness_m")),
        ("wide", ("clutch", "geometry", "outer_radius_m")),
        (0.0, ("clutch", "geometry", "piston_area_m2")),
        (-1.0, ("noise", "pressure_pa")),
        (2.0, ("clutch", "friction", "mu_c")),
        (1.0, ("elements",)),
        ("guessed", ("torque",)),
        ([], ("clutch",)),
    ],
)
def test_what_the_programs_refuse_the_schema_refuses(value: object, where: tuple[str, ...]) -> None:
    table: Any = shipped()
    part = table
    for key in where[:-1]:
        part = part[key][0] if isinstance(part[key], list) else part[key]
    if value is MISSING:
        del part[where[-1]]
    else:
        part[where[-1]] = value
    assert not VALIDATOR.is_valid(table)
    with pytest.raises(CalibrationError):
        Calibration.from_mapping(table)
