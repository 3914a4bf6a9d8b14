"""What a connection to a broker is made on, and paho-mqtt's client for it."""

import logging
from dataclasses import dataclass
from typing import Final

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from fleet_contract import Outgoing
from fleet_link.address import BrokerAddress

AT_MOST_ONCE: Final = 0
AT_LEAST_ONCE: Final = 1
_MOST_WAITING: Final = 1_000  # of what wants an answer: a broker that gives none must not fill our memory
_PAHO_LOG: Final = logging.getLogger("mqtt")
_PAHO_LOG.setLevel(logging.WARNING)  # it would tell of every packet


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """What a connection is made on."""

    is_version_5: bool = True  # else 3.1.1
    identifier: str | None = None  # None: the broker gives one
    timeout_s: float = 5.0  # for a connection or an acknowledgement
    stall_s: float = (
        60.0  # for taking more of what we send; a broker in a storm may look at one vehicle after the other
    )
    keepalive_s: int = 20  # a dead peer is known after 1.5 times this
    will: Outgoing | None = None  # what the broker says for us when we vanish
    session_s: int = 0  # how long the broker keeps what is for us while we are away
    max_in_flight: int = 20  # messages of ours without an answer, unless the broker takes fewer
    max_unsettled: int | None = None  # messages that we hold and have not settled; None: settled as they come
    max_unsettled_bytes: int | None = None  # of them; half of it is a batch, whatever its count
    max_packet_bytes: int | None = None  # the broker keeps longer ones from us
    is_key_private: bool = True  # a key that others may read is refused


def make_client(address: BrokerAddress, terms: Terms) -> Client:
    """Return a client that has not connected yet; raises AddressError if a certificate cannot be used."""
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=terms.identifier,
        clean_session=None if terms.is_version_5 else not terms.session_s,
        protocol=MQTTProtocolVersion.MQTTv5 if terms.is_version_5 else MQTTProtocolVersion.MQTTv311,
        reconnect_on_failure=False,
        manual_ack=terms.max_unsettled is not None,
    )
    client.enable_logger(_PAHO_LOG)
    client.max_inflight_messages_set(terms.max_in_flight)
    client.max_queued_messages_set(_MOST_WAITING)
    if address.username is not None:
        client.username_pw_set(address.username, address.password)
    if address.tls is not None:
        client.tls_set_context(address.tls.context(is_key_private=terms.is_key_private))
    if terms.will is not None:
        client.will_set(terms.will.topic, terms.will.payload, AT_LEAST_ONCE, terms.will.is_retained)
    return client


def connect(client: Client, address: BrokerAddress, terms: Terms) -> None:
    """Open the socket of a client and ask for a connection; blocks; raises OSError."""
    if not terms.is_version_5:
        client.connect(address.host, address.port, terms.keepalive_s)
        return
    properties, clean_start = _connect_properties(terms), not terms.session_s
    client.connect(address.host, address.port, terms.keepalive_s, clean_start=clean_start, properties=properties)


def _connect_properties(terms: Terms) -> Properties:
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho-mqtt's
    if terms.session_s:
        properties.SessionExpiryInterval = terms.session_s
    if terms.max_unsettled is not None:
        properties.ReceiveMaximum = terms.max_unsettled
    if terms.max_packet_bytes is not None:
        properties.MaximumPacketSize = terms.max_packet_bytes
    return properties
