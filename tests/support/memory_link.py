"""A broker connection in memory: the double of a link."""

import asyncio
from collections.abc import Sequence

from clutch_results.records import FluidFill, ShiftResult, shift_from
from diag_service.delivery.reporters import OnFills, OnReceipts
from diag_service.errors import PublishError
from fleet_contract import (
    Channel,
    JsonObject,
    Outgoing,
    Receipt,
    bundled_events,
    key_of,
    parse_topic,
    read_message,
    topic_of,
)


class MemoryLink:
    """A broker connection in memory, with a backend behind it if it ``is_acknowledging``, which may take bundles."""

    def __init__(self, *, is_acknowledging: bool = False, takes_bundles: bool = False) -> None:
        self.takes_bundles = takes_bundles
        self.bundled: list[int] = []  # how many results each bundle had
        self.results: list[ShiftResult] = []
        self.states: list[JsonObject] = []  # of clutches
        self.others: list[Outgoing] = []
        self.fleet_fills: list[FluidFill] = []  # that a fleet would tell
        self.is_refusing = False
        self.is_acknowledging = is_acknowledging
        self.cut = asyncio.Event()
        self.on_receipts: OnReceipts | None = None

    async def send(self, messages: Sequence[Outgoing]) -> None:
        for message in messages:
            if self.is_refusing or self.cut.is_set():
                raise PublishError("the memory refuses")
            self._keep(message)
        await asyncio.sleep(0)

    async def listen(self, vehicle: str, on_receipts: OnReceipts) -> None:  # noqa: ARG002 - there is one vehicle here
        self.on_receipts = on_receipts

    async def hear_fills(self, vehicle: str, on_fills: OnFills) -> None:  # noqa: ARG002 - there is one vehicle here
        if self.fleet_fills:
            on_fills(self.fleet_fills)

    async def lost(self) -> None:
        """Return when the test cuts the connection."""
        await self.cut.wait()

    def _keep(self, message: Outgoing) -> None:
        address = parse_topic(message.topic)
        if address.channel is Channel.BUNDLE:
            events = bundled_events(message.payload)
            self.bundled.append(len(events))
            topic = topic_of(address.vehicle, Channel.SHIFT)
            for event in events:
                self._keep(Outgoing(topic=topic, payload=event, is_retained=False))
            return
        incoming = read_message(message.topic, message.payload)
        if incoming.address.channel is Channel.SHIFT:
            self.results.append(shift_from(incoming.data))
            if self.is_acknowledging and self.on_receipts is not None:
                self.on_receipts([Receipt(key=key_of(incoming.data))], takes_bundles=self.takes_bundles)
        elif incoming.address.channel is Channel.CLUTCH:
            self.states.append(incoming.data)
        else:
            self.others.append(message)
