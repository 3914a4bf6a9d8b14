"""The wire contract that emulator and service share: database, timing and end-to-end protection."""

from dbc.contract import DBC_PATH, MessageContract, load_contract, message_contract, message_contracts
from dbc.protection import COUNTER_PERIOD, counter_of, crc_is_valid, protect

__all__ = [
    "COUNTER_PERIOD",
    "DBC_PATH",
    "MessageContract",
    "counter_of",
    "crc_is_valid",
    "load_contract",
    "message_contract",
    "message_contracts",
    "protect",
]
