"""Outboxes at work for tests with a real broker: what they send, and waiting for what comes of it."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from typing import Final

from clutch_results.records import ServiceStatus
from diag_service.delivery import Outbox
from diag_service.store import ResultStore, VehicleState, Versions
from tests.support.builders import shift_result
from tests.support.patience import HANG_S

NOW: Final = "2026-01-01T00:00:00.000000Z"
STATE: Final = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
STATUS: Final = ServiceStatus(
    vehicle="car1",
    is_online=True,
    connected_at="",
    service_version="0.1.0",
    algorithm_version="algorithm-1",
    calibration_version="1+0123456789ab",
)


def put(store: ResultStore, seqs: Iterable[int], *, vehicle: str = "car1") -> None:
    """Store results, of both clutches in turn."""
    for seq in seqs:
        store.add(shift_result(seq, vehicle=vehicle, to_gear=2 + seq % 5), STATE)


@asynccontextmanager
async def sending(outbox: Outbox) -> AsyncIterator[asyncio.Task[None]]:
    """Run an outbox for as long as the block lasts; its end is that of a process: no farewell, no last word."""
    sender = asyncio.create_task(outbox.run())
    try:
        yield sender
    finally:
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


async def until(condition: Callable[[], bool], timeout_s: float = HANG_S) -> None:
    """Return when a condition holds that lives in another thread or process; fail the test if it never does."""
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - nobody tells when it does
            await asyncio.sleep(0.01)
