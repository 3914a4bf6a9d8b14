"""Fluid fills over one link: the fleet hears of those that the vehicle knows, and the vehicle of those of the fleet."""

import asyncio
import logging
from datetime import UTC, datetime

from canlog.notice import NOTICE
from diag_service.delivery.base import Link
from diag_service.diagnosis.records import FluidFill
from diag_service.diagnosis.results import fill_record, iso_utc
from diag_service.errors import PublishError
from diag_service.store import ResultStore
from fleet_contract import fluid_message

_LOG = logging.getLogger(__name__)


class FluidExchange:
    """What both sides know, as long as one link lasts; each fill is noted once, so nothing goes in circles."""

    def __init__(self, store: ResultStore, vehicle: str, link: Link, wake: asyncio.Event) -> None:
        self._store = store
        self._vehicle = vehicle
        self._link = link
        self._wake = wake  # set when there is something to note
        self._heard: list[FluidFill] = []
        self._told: list[FluidFill] = []

    async def listen(self) -> None:
        """Begin to hear the fleet."""
        await self._link.hear_fills(self._vehicle, self._hear)

    async def note(self) -> None:
        """Note what the fleet told; the next shift finds it in the store."""
        if not self._heard:
            return
        fills, self._heard = self._heard, []
        count = await asyncio.to_thread(self._store.add_fills, fills)
        if count:
            _LOG.log(NOTICE, "the fleet told of %d change(s) of fluid fills", count)

    async def tell(self) -> None:
        """Tell the fleet what the vehicle knows, unless this link has carried the same before."""
        fills = await asyncio.to_thread(self._store.all_fills, self._vehicle)
        if fills == self._told:
            return
        self._told = fills
        told = [fill_record(fill) for fill in fills]
        try:
            await self._link.send([fluid_message(self._vehicle, iso_utc(datetime.now(UTC)), told, is_to_vehicle=False)])
        except PublishError as exc:  # of a connection that is lost the next message tells
            _LOG.warning("the fleet was not told of fluid fills: %s", exc)

    def _hear(self, fills: list[FluidFill]) -> None:
        self._heard += fills
        self._wake.set()
