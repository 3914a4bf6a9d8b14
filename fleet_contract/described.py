"""The JSON Schemas of the contract: where they are, and the check of a record against its own."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

from fleet_contract.strict_json import JsonObject
from fleet_contract.topics import Channel

SCHEMA_FOLDER: Final = Path(__file__).with_name("schemas")
ASYNCAPI_PATH: Final = Path(__file__).with_name("asyncapi.yaml")
VSS_OVERLAY_PATH: Final = Path(__file__).with_name("vss") / "clutches.vspec"
ENVELOPE: Final = "event"


def schema(name: str) -> JsonObject:
    """Return the JSON Schema of a channel's data by its label, or of the envelope."""
    table: JsonObject = json.loads((SCHEMA_FOLDER / f"{name}-v1.json").read_text(encoding="utf-8"))
    return table


def check_data(channel: Channel, data: JsonObject) -> None:
    """Raise SchemaError if a record is not what its channel carries."""
    _check_of(channel.label)(data)


def check_envelope(event: JsonObject) -> None:
    """Raise SchemaError if a message is no CloudEvent of this contract."""
    _check_of(ENVELOPE)(event)


@cache
def _check_of(name: str) -> Callable[[object], None]:
    from fleet_contract.schema_check import compile_schema  # noqa: PLC0415 - who only sends needs no library for it

    return compile_schema(schema(name))
