"""The test double of every publisher: keeps what it is given, fails when it is told to."""

import asyncio

from diag_service.errors import PublishError
from diag_service.records import ShiftResult
from diag_service.summary import Summary


class MemoryLink:
    """A broker connection in memory."""

    def __init__(self) -> None:
        self.results: list[ShiftResult] = []
        self.refreshed: list[ShiftResult] = []
        self.is_refusing = False
        self.cut = asyncio.Event()

    async def publish(self, result: ShiftResult) -> None:
        """Keep a result, or refuse it."""
        if self.is_refusing or self.cut.is_set():
            raise PublishError("the memory refuses")
        self.results.append(result)

    async def refresh(self, result: ShiftResult) -> None:
        """Keep the state apart from the results."""
        self.refreshed.append(result)

    async def lost(self) -> None:
        """Return when the test cuts the connection."""
        await self.cut.wait()


class MemoryReporter:
    """A listener in memory."""

    def __init__(self) -> None:
        self.places: list[str] = []
        self.results: list[ShiftResult] = []
        self.summaries: list[Summary] = []

    def listening(self, where: str) -> None:
        """Keep the place."""
        self.places.append(where)

    def report(self, result: ShiftResult) -> None:
        """Keep the result."""
        self.results.append(result)

    def finish(self, summary: Summary) -> None:
        """Keep the numbers."""
        self.summaries.append(summary)
