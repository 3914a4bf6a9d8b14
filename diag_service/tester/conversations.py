"""``inspect --conversations``: messages longer than a frame, and what testers asked and controllers answered."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

from cantools.database.can import Message

from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.transport import Exchange, Exchanges, LongMessage, LongMessages, Protocol, Transfer
from diag_service.commands.talks import pairs_of
from diag_service.diagnosis.records import utc_from_bus_ns
from diag_service.tester.answers import NEGATIVE, SERVICE_NAMES, refusal_text
from fleet_contract import JsonObject

SHOWN_EXCHANGES: Final = 200
SHOWN_BYTES: Final = 16
MOST_DECODED: Final = 10_000  # long messages whose values are kept
NS_PER_MS: Final = 1e6
_ID_MASK: Final = 0x1FFF_FFFF

# SAE J1979, two of KWP 2000, and the services of ISO 14229-1 that no command of ours asks.
_NAMES: Final[Mapping[int, str]] = {
    0x01: "current data",
    0x02: "freeze frame",
    0x03: "trouble codes",
    0x04: "clear trouble codes",
    0x05: "oxygen sensor tests",
    0x06: "monitor results",
    0x07: "pending trouble codes",
    0x08: "control of a system",
    0x09: "vehicle information",
    0x0A: "permanent trouble codes",
    0x11: "ECUReset",
    0x1A: "ReadEcuIdentification",
    0x21: "ReadDataByLocalIdentifier",
    0x23: "ReadMemoryByAddress",
    0x24: "ReadScalingDataByIdentifier",
    0x28: "CommunicationControl",
    0x29: "Authentication",
    0x2A: "ReadDataByPeriodicIdentifier",
    0x2C: "DynamicallyDefineDataIdentifier",
    0x2E: "WriteDataByIdentifier",
    0x2F: "InputOutputControlByIdentifier",
    0x34: "RequestDownload",
    0x35: "RequestUpload",
    0x36: "TransferData",
    0x37: "RequestTransferExit",
    0x38: "RequestFileTransfer",
    0x3D: "WriteMemoryByAddress",
    0x83: "AccessTimingParameter",
    0x84: "SecuredDataTransmission",
    0x85: "ControlDTCSetting",
    0x86: "ResponseOnEvent",
    0x87: "LinkControl",
    **SERVICE_NAMES,
}


class Conversations:
    """What was said in messages longer than a frame, of one log."""

    def __init__(self, messages: Sequence[Message], pairs: str = "") -> None:
        identifiers = pairs_of(pairs)
        self._long = LongMessages(messages, identifiers)
        self._exchanges = Exchanges(pairs=identifiers)
        self._decoded: list[LongMessage] = []
        self._by_name: Counter[str] = Counter()
        self._told = self._told_unanswered = 0  # of requests
        self._show: Callable[[str], object] | None = None

    def show_at_once(self, show: Callable[[str], object]) -> None:
        self._show = show

    def add(self, batch: FrameBatch) -> None:
        self._take(self._long.feed(batch))
        if self._show is not None:
            for line in self.news(int(batch.t_ns[-1])):
                self._show(line)

    def close(self) -> None:
        self._take(self._long.close())

    def news(self, now_ns: int) -> Iterator[str]:
        for one in self._exchanges.settled(now_ns):
            self._told += 1
            self._told_unanswered += not one.answers
            yield exchange_line(one)

    def lines(self) -> Iterator[str]:
        counts = self._long.counts.in_words()
        yield from counts or ["no message longer than a frame and no conversation of a tester"]
        for name, count in self._by_name.most_common():
            yield f"  {name}: {count}"
        found = self._exchanges.found
        unanswered = self._told_unanswered + sum(not one.answers for one in found)
        if found or self._told or self._exchanges.unasked:
            more = f", {self._exchanges.more} more are not kept" if self._exchanges.more else ""
            yield (
                f"{self._told + len(found)} requests, {unanswered} without an answer, "
                f"{self._exchanges.unasked} answers without a request in the log{more}"
            )
        yield from (f"  {exchange_line(one)}" for one in found[:SHOWN_EXCHANGES])
        if len(found) > SHOWN_EXCHANGES:
            yield f"  and {len(found) - SHOWN_EXCHANGES} more requests; --json tells all"

    def record(self) -> JsonObject:
        counts = self._long.counts
        return {
            "whole": {protocol.value: count for protocol, count in counts.whole.items()},
            "incomplete": {
                protocol.value: {
                    fault.value: count for (one, fault), count in counts.incomplete.items() if one is protocol
                }
                for protocol in Protocol
                if any(one is protocol for one, _ in counts.incomplete)
            },
            "messages": [_long_record(one) for one in self._decoded],
            "exchanges": [_exchange_record(one) for one in self._exchanges.found],
            "exchanges_not_kept": self._exchanges.more,
            "answers_unasked": self._exchanges.unasked,
        }

    def _take(self, found: Iterable[LongMessage]) -> None:
        for one in found:
            self._exchanges.feed([one.transfer])
            if one.name:
                self._by_name[f"{one.name} ({one.fault})" if one.fault else one.name] += 1
            if one.transfer.protocol is not Protocol.ISO_TP or one.name:
                self._by_name[f"group of {_id_text(one.transfer)}, not in the database"] += not one.name
                if len(self._decoded) < MOST_DECODED:
                    self._decoded.append(one)
        self._by_name += Counter()  # without those that are zero


def exchange_line(exchange: Exchange) -> str:
    """Return a request and its answers on one line."""
    request = exchange.request
    name = _NAMES.get(request.data[0], f"service {request.data[0]:02X}")
    patience = f", response pending {exchange.pending} times" if exchange.pending else ""
    head = f"{utc_from_bus_ns(request.first_ns)} {_id_text(request)} {name}: {bytes_text(request.data)}"
    if not exchange.answers:
        return f"{head} -> no answer{patience}"
    told = [
        f"{_id_text(one)} {answer_text(one.data)} after {(one.first_ns - request.last_ns) / NS_PER_MS:.1f} ms"
        for one in exchange.answers
    ]
    return f"{head} -> {'; '.join(told)}{patience}"


def answer_text(data: bytes) -> str:
    """Return an answer in words if it refuses, else its bytes."""
    return f"refused: {refusal_text(data[2])}" if data[0] == NEGATIVE and len(data) > 2 else bytes_text(data)


def bytes_text(data: bytes) -> str:
    """Return the first bytes of a message, and how many there are of a long one."""
    shown = data[:SHOWN_BYTES].hex(" ").upper()
    return f"{shown} ... ({len(data)} bytes)" if len(data) > SHOWN_BYTES else shown


def _id_text(transfer: Transfer) -> str:
    return f"{transfer.can_id & _ID_MASK:0{8 if transfer.can_id & EXTENDED_FLAG else 3}X}"


def _transfer_record(one: Transfer) -> JsonObject:
    return {
        "at": utc_from_bus_ns(one.first_ns),
        "channel": one.channel,
        "id": _id_text(one),
        "frames": one.frames,
        "data": one.data.hex(),
    }


def _long_record(one: LongMessage) -> JsonObject:
    transfer = {**_transfer_record(one.transfer), "protocol": one.transfer.protocol.value}
    return {**transfer, "message": one.name or None, "values": one.values, "fault": one.fault or None}


def _exchange_record(one: Exchange) -> JsonObject:
    refused = [answer.data[2] for answer in one.answers if answer.data[0] == NEGATIVE and len(answer.data) > 2]
    return {
        "request": _transfer_record(one.request),
        "service": _NAMES.get(one.request.data[0]),
        "answers": [_transfer_record(answer) for answer in one.answers],
        "refusals": [refusal_text(code) for code in refused],
        "pending": one.pending,
        "latency_ms": None if one.latency_ns is None else one.latency_ns / NS_PER_MS,
    }
