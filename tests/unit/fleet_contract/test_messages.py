"""Messages are what they say they are, or they are refused with a reason."""

import json
from typing import Any

import pytest

from diag_service.diagnosis.records import clutch_record, shift_record
from fleet_contract import (
    ContractError,
    IdentityError,
    MalformedError,
    SchemaError,
    TopicError,
    clutch_message,
    key_of,
    raw_shift_message,
    read_message,
    shift_message,
)
from tests.support.builders import shift_result

SHIFT = shift_message(shift_record(shift_result()))
CLUTCH = clutch_message(clutch_record(shift_record(shift_result())))


def changed(payload: bytes, *path: str, value: object) -> bytes:
    """Return a payload with one value replaced."""
    event: dict[str, Any] = json.loads(payload)
    target = event
    for name in path[:-1]:
        target = target[name]
    target[path[-1]] = value
    return json.dumps(event).encode()


def test_a_text_that_exists_already_makes_the_same_message() -> None:
    record = shift_record(shift_result())
    text = json.dumps(record, separators=(",", ":"))
    assert raw_shift_message(key_of(record), str(record["produced_at"]), text) == SHIFT


def test_unknown_keys_are_ignored() -> None:
    payload = changed(changed(SHIFT.payload, "traceparent", value="00-1"), "data", "colour", value="amber")
    assert read_message(SHIFT.topic, payload).data["colour"] == "amber"


@pytest.mark.parametrize(
    ("path", "value", "kind"),
    [
        (("data", "vehicle"), "car2", IdentityError),
        (("id",), "car1/another/1/a/b", IdentityError),
        (("data", "stream"), "another", IdentityError),
        (("data", "seq"), 2, IdentityError),
        (("data", "algorithm_version"), "algorithm-2", IdentityError),
        (("type",), "clutchdiag.clutch.v1", IdentityError),
        (("dataschema",), "urn:clutchdiag:clutch:v1", IdentityError),
        (("specversion",), "0.3", SchemaError),
        (("datacontenttype",), "text/plain", SchemaError),
        (("time",), "2026-13-01T00:00:00.000000Z", SchemaError),
        (("data",), [], SchemaError),
        (("data", "seq"), 0, SchemaError),
        (("data", "seq"), True, SchemaError),
        (("data", "seq"), 1.0, SchemaError),
        (("data", "quality"), 1.5, SchemaError),
        (("data", "friction", "mu_c"), "0.1", SchemaError),
        (("data", "verdict", "condition"), "splendid", SchemaError),
        (("data", "reasons"), ["misfit", "misfit"], SchemaError),
        (("data", "vehicle"), "car1\n", SchemaError),
        (("data", "stream"), "s" * 129, SchemaError),
        (("data", "verdict", "reason"), "x" * 17_000, MalformedError),
    ],
)
def test_a_message_that_lies_or_errs_is_refused(path: tuple[str, ...], value: object, kind: type) -> None:
    with pytest.raises(ContractError) as caught:
        read_message(SHIFT.topic, changed(SHIFT.payload, *path, value=value))
    assert type(caught.value) is kind
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("clutchdiag/v1/car2/shift", IdentityError),
        ("clutchdiag/v1/car1/clutch/2", SchemaError),
        ("clutchdiag/v1/car1/nothing", TopicError),
    ],
)
def test_a_message_on_another_topic_is_refused(topic: str, kind: type) -> None:
    with pytest.raises(kind):
        read_message(topic, SHIFT.payload)


def test_a_clutch_state_belongs_to_its_clutch() -> None:
    with pytest.raises(IdentityError, match="clutch is 2 where 1 belongs"):
        read_message("clutchdiag/v1/car1/clutch/1", CLUTCH.payload)
