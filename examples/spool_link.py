"""A publisher of one's own: results go to a file, for another program to fetch (CONTRIBUTING.md)."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from diag_service.delivery.reporters import OnFills, OnReceipts
from diag_service.errors import PublishError
from fleet_contract import Outgoing


class SpoolLink:
    """Appends every message to a file, for another program to fetch."""

    def __init__(self, path: Path) -> None:
        self._path = path

    async def send(self, messages: Sequence[Outgoing]) -> None:
        try:
            with self._path.open("ab") as spool:
                spool.writelines(b"%s %s\n" % (one.topic.encode(), one.payload) for one in messages)
        except OSError as exc:
            raise PublishError(f"cannot write {self._path}: {exc.strerror}") from exc

    async def listen(self, vehicle: str, on_receipts: OnReceipts) -> None:
        """Nobody answers: a file gives no receipts."""

    async def hear_fills(self, vehicle: str, on_fills: OnFills) -> None:
        """Nobody tells of fluid fills either."""

    async def lost(self) -> None:
        await asyncio.Event().wait()  # never


@asynccontextmanager
async def connect() -> AsyncIterator[SpoolLink]:
    yield SpoolLink(Path("spool.jsonl"))
