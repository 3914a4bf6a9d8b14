"""What compiled schemas refuse, and in which words; the rest is in tests/properties."""

from collections.abc import Mapping

import pytest
from jsonschema import Draft202012Validator

from fleet_contract import SchemaError, schema
from fleet_contract.schema_check import SCHEMA_FOLDER, compile_schema

NAMES = sorted(path.name.removesuffix("-v1.json") for path in SCHEMA_FOLDER.glob("*.json"))


@pytest.mark.parametrize("name", NAMES)
def test_a_schema_of_ours_is_one(name: str) -> None:
    Draft202012Validator.check_schema(schema(name))
    compile_schema(schema(name))
    assert schema(name)["$id"] == f"urn:clutchdiag:{name}:v1"


def refusal(schema_part: Mapping[str, object], value: object) -> str:
    """Return what is said of a value; empty if nothing."""
    try:
        compile_schema(schema_part)(value)
    except SchemaError as exc:
        return str(exc)
    return ""


@pytest.mark.parametrize(
    ("part", "value", "said"),
    [
        ({"type": "integer"}, 1.0, "an integer is written without a fraction, got 1.0"),
        ({"enum": [1, 2]}, 2.0, "an integer is written without a fraction, got 2.0"),
        ({"type": "integer"}, True, 'the value is not of type "integer", got True'),
        ({"maximum": 1}, 1.5, "the value is greater than the maximum of 1, got 1.5"),
        ({"pattern": "^a$"}, "a\n", "the value does not match \"^a$\", got 'a\\n'"),
        ({"maxLength": 3}, "x" * 1000, f"the value is longer than 3 characters, got '{'x' * 59}..."),
        ({"required": ["b", "a"]}, {}, '"b" is a required property; "a" is a required property'),
        ({"items": {"type": "null"}}, [1] * 9, "and more"),
        ({"format": "date-time"}, "2026-13-01T00:00:00Z", 'the value is not a "date-time"'),
        ({"format": "date-time"}, "2016-12-31T23:59:60Z", 'the value is not a "date-time"'),  # Python knows none
    ],
    ids=str,
)
def test_a_refusal_says_what_is_wrong(part: Mapping[str, object], value: object, said: str) -> None:
    text = refusal(part, value)
    assert said in text
    assert len(text) < 300
    assert text.isprintable()
