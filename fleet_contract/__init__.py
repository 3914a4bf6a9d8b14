"""What vehicle and fleet backend agree on: topics, envelope, schemas, receipts. Neither application is known here."""

from fleet_contract.broker_url import BrokerUrl, exposure, is_this_machine, parse_broker_url
from fleet_contract.described import ASYNCAPI_PATH, SCHEMA_FOLDER, VSS_OVERLAY_PATH, schema
from fleet_contract.errors import (
    BrokerUrlError,
    ContractError,
    IdentityError,
    MalformedError,
    SchemaError,
    TopicError,
    VariableError,
)
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
from fleet_contract.variables import BACKEND_VARIABLES, PREFIX, SERVICE_VARIABLES, check_variables

__all__ = [
    "ASYNCAPI_PATH",
    "BACKEND_VARIABLES",
    "CLUTCHES",
    "MAX_RECEIPTS",
    "PREFIX",
    "SCHEMA_FOLDER",
    "SERVICE_VARIABLES",
    "TOPIC_ROOT",
    "VSS_OVERLAY_PATH",
    "Address",
    "BrokerUrl",
    "BrokerUrlError",
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
    "VariableError",
    "ack_messages",
    "check_variables",
    "clutch_message",
    "config_message",
    "dump",
    "exposure",
    "filter_of",
    "is_this_machine",
    "is_vehicle",
    "key_of",
    "metrics_message",
    "parse_broker_url",
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
