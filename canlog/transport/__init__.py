"""Messages longer than a frame, put together from recorded or live frames: ISO-TP, J1939 transport, fast packet."""

from canlog.transport.reassembly import Exchange, Exchanges, LongMessage, LongMessages, Reassembler
from canlog.transport.transfers import Fault, Protocol, Transfer, TransferCounts

__all__ = [
    "Exchange",
    "Exchanges",
    "Fault",
    "LongMessage",
    "LongMessages",
    "Protocol",
    "Reassembler",
    "Transfer",
    "TransferCounts",
]
