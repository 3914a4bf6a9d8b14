"""What vehicle and fleet backend agree on: topics, envelope, schemas, receipts. Neither application is known here."""

from fleet_contract.described import ASYNCAPI_PATH, SCHEMA_FOLDER, VSS_OVERLAY_PATH, schema
from fleet_contract.errors import ContractError, IdentityError, MalformedError, SchemaError, TopicError
from fleet_contract.messages import (
    Incoming,
    Outgoing,
    ack_messages,
    clutch_message,
    config_message,
    metrics_message,
    raw_shift_message,
    read_message,
    shift_message,
    status_message,
)
from fleet_contract.receipts import MAX_RECEIPTS, Outcome, Receipt, ResultKey, key_of, receipts_of
from fleet_contract.strict_json import JsonObject, dump, parse_object
from fleet_contract.topics import CLUTCHES, TOPIC_ROOT, Address, Channel, filter_of, is_vehicle, parse_topic, topic_of

__all__ = [
    "ASYNCAPI_PATH",
    "CLUTCHES",
    "MAX_RECEIPTS",
    "SCHEMA_FOLDER",
    "TOPIC_ROOT",
    "VSS_OVERLAY_PATH",
    "Address",
    "Channel",
    "ContractError",
    "IdentityError",
    "Incoming",
    "JsonObject",
    "MalformedError",
    "Outcome",
    "Outgoing",
    "Receipt",
    "ResultKey",
    "SchemaError",
    "TopicError",
    "ack_messages",
    "clutch_message",
    "config_message",
    "dump",
    "filter_of",
    "is_vehicle",
    "key_of",
    "metrics_message",
    "parse_object",
    "parse_topic",
    "raw_shift_message",
    "read_message",
    "receipts_of",
    "schema",
    "shift_message",
    "status_message",
    "topic_of",
]
