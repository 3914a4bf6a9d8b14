"""Writes the JSON Schema of a transmission's description: ``python -m tests.tools.description_schema``.

It is made from the records that read descriptions, for editors that complete and check what somebody types.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from clutch_model.calibration import CLUTCH_COUNT, SHIPPED, Calibration, Ranged

SCHEMA: Final = Path(__file__).parents[2] / "clutch_model/calibrations/schema.json"
_PART: Final = "PartOf"  # where a description is like another one, its tables need not be whole


def schema() -> dict[str, Any]:
    """Return the schema of a description."""
    _, found = msgspec.json.schema_components([Calibration], ref_template="#/$defs/{name}")
    for kind in _kinds(Calibration):
        _bound(found[kind.__name__], kind)
    root = found.pop("Calibration")
    properties = root["properties"]
    properties["clutch"] = properties.pop("clutches")
    properties["clutch"]["minItems"] = 1  # behind a converter there may be one, see below
    properties |= {name: {"type": ["string", "number"]} for name in ("name", "version")}
    properties["transmission"] = {"type": "object", "deprecated": True}  # of older files
    numbers = ["clutch" if name == "clutches" else name for name in root["required"]]
    whole = {"properties": properties, "required": numbers}
    like = {"like": {"enum": list(SHIPPED)}}
    part = {"properties": like | _renamed(properties)}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:clutchdiag:transmission:v1",
        "title": "Description of a transmission",
        "type": "object",
        "if": {"required": ["like"]},
        "then": part,
        "else": whole,
        "anyOf": [{"required": ["converter"]}, {"properties": {"clutch": {"minItems": CLUTCH_COUNT}}}],
        "propertyNames": {"enum": ["like", *properties]},
        "$defs": dict(sorted((found | _parts(found)).items())),
    }


def _kinds(*kinds: Any) -> Iterator[Any]:  # noqa: ANN401 - classes of records
    """Yield records and the records that they hold."""
    for kind in kinds:
        yield kind
        for hint in kind.__annotations__.values():
            members = (hint, *getattr(hint, "__args__", ()))
            yield from _kinds(*(one for one in members if is_dataclass(one)))


def _bound(table: dict[str, Any], kind: Any) -> None:  # noqa: ANN401 - a class of records
    """Add to the schema of a record which keys and which ranges it takes."""
    table["additionalProperties"] = False
    table["description"] = table["description"].partition("\n")[0]
    for name, value in table["properties"].items():
        number = value if value.get("type") in {"number", "integer"} else {}
        if issubclass(kind, Ranged) and kind is not Ranged:
            number |= {"exclusiveMinimum" if name in kind.ABOVE_ZERO else "minimum": 0}
            if name in kind.BOUNDS:
                number["minimum"], number["maximum"] = kind.BOUNDS[name]


def _parts(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return every schema once more, with nothing required."""
    part = {name: {key: value for key, value in one.items() if key != "required"} for name, one in found.items()}
    return {_PART + name: _renamed(one) for name, one in part.items()}


def _renamed(value: Any) -> Any:  # noqa: ANN401 - JSON
    """Return a schema whose references go to parts."""
    text = json.dumps(value)
    return json.loads(text.replace("#/$defs/", f"#/$defs/{_PART}"))


if __name__ == "__main__":
    SCHEMA.write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
