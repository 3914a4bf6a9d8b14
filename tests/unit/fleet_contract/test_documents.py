"""The documents, the schemas and the golden messages of the contract agree."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from ruamel.yaml import YAML
from vss_tools.main import get_trees
from vss_tools.model import VSSDataDatatype

from fleet_contract import CLUTCHES, MAX_BUNDLED, Channel, SchemaError, parse_topic, read_message, schema, topic_of
from fleet_contract.messages import MAX_BUNDLE_BYTES
from fleet_contract.schema_check import ENVELOPE, SCHEMA_FOLDER, compile_schema
from tests.golden import FOLDER, messages_v1

ASYNCAPI_PATH = SCHEMA_FOLDER.with_name("asyncapi.yaml")
VSS_OVERLAY_PATH = SCHEMA_FOLDER.with_name("vss") / "clutches.vspec"

ALONE = [channel for channel in Channel if channel is not Channel.BUNDLE]
QUANTITIES = "relation:\n  definition: A ratio of two quantities of one kind\n"
UNIT = "{0}:\n  definition: A relation\n  unit: {0}\n  quantity: relation\n  allowed-datatypes: [numeric]\n"
BASE = "".join(
    f"{name}:\n  type: branch\n  description: A branch of VSS.\n"
    for name in ("Vehicle", "Vehicle.Powertrain", "Vehicle.Powertrain.Transmission")
)


@pytest.fixture(scope="module", name="document")
def _document() -> dict[str, Any]:
    table: dict[str, Any] = YAML(typ="safe").load(ASYNCAPI_PATH)
    return table


def test_the_document_knows_every_channel_and_no_other(document: dict[str, Any]) -> None:
    assert document["asyncapi"].startswith("3.")
    described = {name: channel["address"] for name, channel in document["channels"].items()}
    assert described == {channel.label: template(channel) for channel in Channel}
    for channel in Channel:
        entry = document["channels"][channel.label]
        assert entry["messages"] == {channel.label: {"$ref": f"#/components/messages/{channel.label}"}}
        assert set(entry["parameters"]) == {"vehicle", *(["clutch"] if channel is Channel.CLUTCH else [])}
    assert document["components"]["parameters"]["clutch"]["enum"] == [str(clutch) for clutch in CLUTCHES]


def template(channel: Channel) -> str:
    clutch = CLUTCHES[0] if channel is Channel.CLUTCH else None
    topic = topic_of("VEHICLE", channel, clutch).replace("VEHICLE", "{vehicle}")
    return topic if clutch is None else topic.removesuffix(str(clutch)) + "{clutch}"


def test_every_operation_is_what_the_code_does(document: dict[str, Any]) -> None:
    operations = {entry["channel"]["$ref"]: entry for entry in document["operations"].values()}
    assert set(operations) == {f"#/channels/{channel.label}" for channel in Channel}
    for channel in Channel:
        entry = operations[f"#/channels/{channel.label}"]
        assert entry["action"] == ("receive" if channel.is_to_vehicle else "send")
        assert (entry["bindings"]["mqtt"]["qos"], entry["bindings"]["mqtt"]["retain"]) == (1, channel.is_retained)


def test_every_message_names_its_type_and_its_schema(document: dict[str, Any]) -> None:
    messages = document["components"]["messages"]
    assert set(messages) == {channel.label for channel in Channel}
    for channel in ALONE:
        envelope, own = messages[channel.label]["payload"]["allOf"]
        assert envelope == {"$ref": f"schemas/{ENVELOPE}-v1.json"}
        assert own["properties"] == {
            "type": {"const": channel.event_type},
            "dataschema": {"const": channel.schema_id},
            "data": {"$ref": f"schemas/{channel.label}-v1.json"},
        }


def test_a_bundle_is_described_with_its_bounds(document: dict[str, Any]) -> None:
    bundle = document["components"]["messages"]["bundle"]
    assert (bundle["payload"]["minItems"], bundle["payload"]["maxItems"]) == (1, MAX_BUNDLED)
    assert bundle["payload"]["items"] == {"$ref": "#/components/messages/shift/payload"}
    for number in (Channel.BUNDLE.max_bytes, MAX_BUNDLE_BYTES):
        assert f"{number:,} bytes at most" in bundle["description"]


def test_every_schema_is_used() -> None:
    used = {f"{name}-v1.json" for name in (ENVELOPE, *(channel.label for channel in ALONE))}
    assert {path.name for path in SCHEMA_FOLDER.iterdir()} == used
    assert all((ASYNCAPI_PATH.parent / "schemas" / name).is_file() for name in used)


@pytest.fixture(name="clutches")
def _clutches(tmp_path: Path) -> dict[str, VSSDataDatatype]:
    """Return the signals of the overlay on the branches of VSS, as vss-tools resolves them."""
    logging.getLogger("vss_tools").setLevel(logging.ERROR)
    (tmp_path / "quantities.yaml").write_text(QUANTITIES, encoding="utf-8")
    (tmp_path / "units.yaml").write_text(UNIT.format("percent") + UNIT.format("ratio"), encoding="utf-8")
    (tmp_path / "base.vspec").write_text(BASE, encoding="utf-8")
    root, _ = get_trees(tmp_path / "base.vspec", overlays=(VSS_OVERLAY_PATH,), strict=True)
    leaves = {leaf.get_fqn(): leaf.get_vss_data() for leaf in root.leaves}
    return {name: data for name, data in leaves.items() if isinstance(data, VSSDataDatatype)}


def test_the_overlay_says_which_key_fills_a_signal(clutches: dict[str, VSSDataDatatype]) -> None:
    state: Any = schema("clutch")
    friction = state["$defs"]["friction"]["properties"]
    for data in clutches.values():
        key = str(data.description).rpartition("From ")[2].split(",")[0].rstrip(".")
        head, _, tail = key.partition(".")
        assert head in state["properties"], key
        assert not tail or tail in friction, key


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
