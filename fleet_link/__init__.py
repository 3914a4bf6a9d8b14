"""Connections to a broker, for vehicles and backends: address, certificates, secrets, MQTT and JetStream."""

from fleet_link.address import (
    AddressError,
    BrokerAddress,
    LinkDownError,
    LinkError,
    MessageRefusedError,
    TlsFiles,
    VersionRefusedError,
    check_secret_mode,
    parse_broker,
    read_secret,
)
from fleet_link.connection import Connection, Message, Terms
from fleet_link.jetstream import JetStream

__all__ = [
    "AddressError",
    "BrokerAddress",
    "Connection",
    "JetStream",
    "LinkDownError",
    "LinkError",
    "Message",
    "MessageRefusedError",
    "Terms",
    "TlsFiles",
    "VersionRefusedError",
    "check_secret_mode",
    "parse_broker",
    "read_secret",
]
