"""Golden messages: what version 1 looked like, today's code still writes, and reads."""

import json

import pytest
from jsonschema import Draft202012Validator

from fleet_contract import Channel, parse_topic, read_message, schema
from tests.golden import FOLDER, messages_v1

MESSAGES = messages_v1()


def golden(name: str) -> bytes:
    return (FOLDER / "v1" / f"{name}.json").read_bytes().rstrip(b"\n")


def test_every_kind_of_message_has_a_golden_one() -> None:
    assert {path.stem for path in (FOLDER / "v1").glob("*.json")} == set(MESSAGES)
    assert {parse_topic(message.topic).channel for message in MESSAGES.values()} == set(Channel) - {Channel.BUNDLE}


@pytest.mark.parametrize("name", MESSAGES)
def test_the_code_writes_the_golden_message_to_the_byte(name: str) -> None:
    assert MESSAGES[name].payload == golden(name)


@pytest.mark.parametrize("name", MESSAGES)
def test_the_code_reads_the_golden_message(name: str) -> None:
    event = json.loads(golden(name))
    message = read_message(MESSAGES[name].topic, golden(name))
    assert message.data == event["data"]
    assert (message.event_id, message.source, message.time) == (event["id"], event["source"], event["time"])


@pytest.mark.parametrize("name", MESSAGES)
def test_the_schemas_describe_the_golden_message(name: str) -> None:
    event = json.loads(golden(name))
    Draft202012Validator(schema("event")).validate(event)
    Draft202012Validator(schema(parse_topic(MESSAGES[name].topic).channel.label)).validate(event["data"])
