"""What the compiled check supports, and that it ignores nothing in silence; the rest is in tests/properties."""

import pytest
from jsonschema import Draft202012Validator

from fleet_contract import SCHEMA_FOLDER, SchemaError, schema
from fleet_contract.schema_check import compile_schema

NAMES = sorted(path.name.removesuffix("-v1.json") for path in SCHEMA_FOLDER.glob("*.json"))


@pytest.mark.parametrize("name", NAMES)
def test_a_schema_of_ours_is_one(name: str) -> None:
    Draft202012Validator.check_schema(schema(name))
    compile_schema(schema(name))
    assert schema(name)["$id"] == f"urn:clutchdiag:{name}:v1"


@pytest.mark.parametrize(
    "broken",
    [
        {"oneOf": []},
        {"properties": {"a": {"if": {}}}},
        {"$ref": "#/$defs/nowhere"},
        {"format": "email"},
        {"type": 7},
        {"minimum": "1"},
        {"items": 1},
    ],
    ids=str,
)
def test_what_is_not_supported_is_said(broken: dict[str, object]) -> None:
    with pytest.raises(SchemaError):
        compile_schema(broken)


def test_the_place_of_a_mistake_is_named() -> None:
    check = compile_schema({"properties": {"a": {"properties": {"b": {"type": "string"}}}}})
    with pytest.raises(SchemaError, match="a: b: must be string, got 1"):
        check({"a": {"b": 1}})
