"""Messages longer than a frame, put together from recorded or live frames: ISO-TP and J1939 transport."""

from canlog.transport.reassembly import Reassembler
from canlog.transport.transfers import Fault, Protocol, Transfer, TransferCounts

__all__ = [
    "Fault",
    "Protocol",
    "Reassembler",
    "Transfer",
    "TransferCounts",
]
