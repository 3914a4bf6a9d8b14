"""Topics: ``clutchdiag/v1/<vehicle>/<channel>``, and what may be said on each."""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from fleet_contract.errors import TopicError
from fleet_contract.strict_json import shown

TOPIC_ROOT: Final = "clutchdiag/v1"
CLUTCHES: Final = (1, 2)
_VEHICLE: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
_TOPIC: Final = re.compile(rf"{TOPIC_ROOT}/({_VEHICLE.pattern})/([a-z]+)(?:/([12]))?")  # of CLUTCHES
_EVENT_BYTES: Final = 16_384
_LIST_BYTES: Final = 262_144
_BUNDLE_BYTES: Final = 65_536  # packed; brokers that take 128 KiB at most have room for it


class Channel(Enum):
    """What a vehicle and its backend tell each other; values are (name, longest message [bytes], retained).

    Events are not retained: a broker would keep one of them and say it again to everyone. States are.
    """

    SHIFT = ("shift", _EVENT_BYTES, False)
    BUNDLE = ("bundle", _BUNDLE_BYTES, False)  # of what goes to SHIFT, packed
    CLUTCH = ("clutch", _EVENT_BYTES, True)
    STATUS = ("status", _EVENT_BYTES, True)  # birth, farewell and last will
    METRICS = ("metrics", _EVENT_BYTES, True)
    CONFIG = ("config", _LIST_BYTES, True)  # what the service runs with; nothing configures it
    CONTROLLER = ("controller", _LIST_BYTES, True)  # the trouble codes that a controller tells
    FLUID = ("fluid", _LIST_BYTES, True)  # the fluid fills that the vehicle knows
    ACK = ("ack", _LIST_BYTES, False)  # this and the next: from backend to vehicle
    FILLS = ("fills", _LIST_BYTES, True)  # the fluid fills that the fleet knows

    def __init__(self, label: str, max_bytes: int, is_retained: bool) -> None:  # noqa: FBT001 - Enum unpacks a tuple
        self.label = label
        self.max_bytes = max_bytes
        self.is_retained = is_retained
        self.schema_name = f"clutchdiag/{label}/v1"  # what the data say of themselves
        self.schema_id = f"urn:clutchdiag:{label}:v1"  # the $id of the schema of the data
        self.event_type = f"clutchdiag.{label}.v1"  # the type of the CloudEvents envelope

    @property
    def is_to_vehicle(self) -> bool:
        """Whether the backend speaks here and the vehicle listens."""
        return self in {Channel.ACK, Channel.FILLS}


_CHANNELS: Final = {channel.label: channel for channel in Channel}


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """What a topic says."""

    vehicle: str
    channel: Channel
    clutch: int | None = None  # of Channel.CLUTCH only

    @property
    def topic(self) -> str:
        """The topic in MQTT's own form."""
        end = "" if self.clutch is None else f"/{self.clutch}"
        return f"{TOPIC_ROOT}/{self.vehicle}/{self.channel.label}{end}"


def is_vehicle(text: str) -> bool:
    """Return whether a text can be a vehicle id: a level of a topic, a file name, a certificate's common name."""
    return _VEHICLE.fullmatch(text) is not None


def topic_of(vehicle: str, channel: Channel, clutch: int | None = None) -> str:
    """Return the topic of a channel of a vehicle.

    Raises
    ------
    TopicError
        If the vehicle id is none, or a clutch is named where none belongs or missing where one does.
    """
    if not is_vehicle(vehicle) or (clutch in CLUTCHES) is not (channel is Channel.CLUTCH):
        raise TopicError(f"no topic for {shown(vehicle)}, {channel.label}, {clutch}")
    return Address(vehicle=vehicle, channel=channel, clutch=clutch).topic


def parse_topic(topic: str) -> Address:
    """Return what a topic says; raises TopicError if it is not one of this contract."""
    match = _TOPIC.fullmatch(topic)
    channel = None if match is None else _CHANNELS.get(match[2])
    if match is None or channel is None or (match[3] is None) is (channel is Channel.CLUTCH):
        raise TopicError(f"unknown topic {shown(topic)}")
    return Address(vehicle=match[1], channel=channel, clutch=None if match[3] is None else int(match[3]))


def filter_of(channel: Channel, *, group: str | None = None) -> str:
    """Return the subscription to a channel of all vehicles, shared among the members of a ``group`` if one is named."""
    end = "/+" if channel is Channel.CLUTCH else ""
    share = "" if group is None else f"$share/{group}/"
    return f"{share}{TOPIC_ROOT}/+/{channel.label}{end}"
