"""How messages are sent and protected, as their database says."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from cantools.database.can import Database, Message

DATA_ID_ATTRIBUTE: Final = "E2EDataId"
START_DELAY_ATTRIBUTE: Final = "GenMsgStartDelayTime"


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageContract:
    """When a message is sent and how it is protected; what its signals mean stays in the database."""

    name: str
    can_id: int
    sender: str  # network node, empty if the database names none
    cycle_ms: int  # 0: not cyclic or unknown
    phase_ms: int  # of the first transmission within the cycle
    data_id: int | None  # of AUTOSAR E2E profile 1; None: the message is not protected
    signals: tuple[str, ...]  # without checksum and counter if the message is protected


PROTECTION_SIGNALS: Final = frozenset({"Crc8", "AliveCounter"})


def message_contract(message: Message) -> MessageContract:
    """Return the contract of one message of any database; what the database does not say is 0 or None."""
    data_id = _attribute(message, DATA_ID_ATTRIBUTE) or None
    hidden = PROTECTION_SIGNALS if data_id is not None else frozenset()
    return MessageContract(
        name=message.name,
        can_id=message.frame_id,
        sender=message.senders[0] if message.senders else "",
        cycle_ms=message.cycle_time or 0,
        phase_ms=_attribute(message, START_DELAY_ATTRIBUTE),
        data_id=data_id,
        signals=tuple(signal.name for signal in message.signals if signal.name not in hidden),
    )


def message_contracts(database: Database) -> Mapping[str, MessageContract]:
    """Return the contracts of all messages by name, in the order of the database."""
    return {message.name: message_contract(message) for message in database.messages}


def _attribute(message: Message, name: str) -> int:
    """Return an integer attribute of a message; 0 if it has none."""
    attributes = message.dbc.attributes if message.dbc is not None else {}
    attribute = attributes.get(name)
    return int(attribute.value) if attribute is not None else 0
