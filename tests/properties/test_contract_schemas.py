"""The compiled schemas against the jsonschema library: the same yes and no to records changed at random."""

import copy
import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator, FormatChecker

from fleet_contract import Channel, SchemaError, parse_topic, schema
from fleet_contract.schema_check import compile_schema
from tests.golden import messages_v1

NAMES = ("event", *(channel.label for channel in Channel if channel is not Channel.BUNDLE))
CHECKS = {name: compile_schema(schema(name)) for name in NAMES}


def ecma(part: Any) -> Any:  # noqa: ANN401 - JSON
    """Return a schema whose patterns mean in Python what they mean in JSON: ``$`` allows no line end after it."""
    if isinstance(part, dict):
        return {
            key: value.removesuffix("$") + r"\Z" if key == "pattern" and value.endswith("$") else ecma(value)
            for key, value in part.items()
        }
    return [ecma(item) for item in part] if isinstance(part, list) else part


ORACLES = {name: Draft202012Validator(ecma(schema(name)), format_checker=FormatChecker(())) for name in NAMES}
RECORDS = [json.loads(message.payload) for message in messages_v1().values()]
KINDS = [parse_topic(message.topic).channel.label for message in messages_v1().values()]

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**64), 2**64)
    | st.floats(allow_nan=False, allow_infinity=False).filter(lambda number: not number.is_integer())
    | st.sampled_from(["", "good", "car1", "accepted", "valid", "misfit", "1.0", "a\n", "ü", "clutchdiag/shift/v1"])
    | st.sampled_from(["x" * 101, "x" * 129, "x" * 1001])
    | st.text(max_size=5)
)
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner))


def places(value: object, path: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    """Return the path of every value inside a record."""
    children = (
        list(value.items()) if isinstance(value, dict) else list(enumerate(value)) if isinstance(value, list) else []
    )
    return [path, *(place for key, child in children for place in places(child, (*path, key)))]


def is_described(name: str, value: object) -> bool:
    try:
        CHECKS[name](value)
    except SchemaError:
        return False
    return True


@pytest.mark.parametrize(("event", "kind"), list(zip(RECORDS, KINDS, strict=True)), ids=KINDS)
@settings(deadline=None)
@given(data=st.data())
def test_a_record_changed_at_one_place(event: dict[str, object], kind: str, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["event", kind]))
    record: object = copy.deepcopy(event if name == "event" else event["data"])
    path = data.draw(st.sampled_from(places(record)))
    if not path:
        record = data.draw(values)
    else:
        target = record
        for key in path[:-1]:
            target = target[key]  # type: ignore[index]  # a path of this record
        if data.draw(st.booleans()):
            target[path[-1]] = data.draw(values)  # type: ignore[index]
        else:
            del target[path[-1]]  # type: ignore[attr-defined]
    assert is_described(name, record) == ORACLES[name].is_valid(record)
