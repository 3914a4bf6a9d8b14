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


@pytest.mark.parametrize(
    "broken",
    [
        {"$ref": "#/$defs/nowhere"},
        {"format": "no format of anyone"},
        {"pattern": "("},
    ],
    ids=str,
)
def test_a_schema_that_is_none_is_refused(broken: dict[str, object]) -> None:
    with pytest.raises(SchemaError, match=r"^no schema: "):
        compile_schema(broken)


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


def test_the_place_of_a_mistake_is_named() -> None:
    nested = {"properties": {"a": {"properties": {"b": {"items": {"type": "string"}}}}}}
    assert refusal(nested, {"a": {"b": ["x", 1]}}) == 'a: b: 1: the value is not of type "string", got 1'


def test_a_property_may_be_called_as_a_keyword_is() -> None:
    part = {"type": "object", "properties": {"type": {"type": "string"}, "enum": {"type": "integer"}}}
    assert refusal(part, {"type": "integer", "enum": 1}) == ""
    assert refusal(part, {"enum": 1.0}) == "enum: an integer is written without a fraction, got 1.0"
