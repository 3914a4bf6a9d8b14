"""The way to a broker, for vehicles and backends: address, certificates, secrets, and one MQTT connection at a time."""

from fleet_link.address import BrokerAddress, TlsFiles, check_secret_mode, parse_broker, read_secret
from fleet_link.arrivals import Message
from fleet_link.connection import Connection, Terms
from fleet_link.errors import AddressError, LinkDownError, LinkError, MessageRefusedError, VersionRefusedError
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
