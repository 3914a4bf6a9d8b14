"""What the pipeline knows about those who hear of results."""

from typing import Protocol

from diag_service.records import ShiftResult
from diag_service.summary import Summary


class Publisher(Protocol):
    """Delivers results to another machine."""

    async def publish(self, result: ShiftResult) -> None:
        """Deliver one result, or raise PublishError if a retry may help."""


class Link(Publisher, Protocol):
    """An open connection to a broker; the outbox opens one, uses it while it lasts, and opens the next."""

    async def refresh(self, result: ShiftResult) -> None:
        """Deliver again the lasting state that a published result left behind; a restarted broker may not know it."""

    async def lost(self) -> None:
        """Return when the connection is lost."""


class Reporter(Protocol):
    """Tells the person or program that started the service; may block, so it runs in the worker thread."""

    def listening(self, where: str) -> None:
        """Say that frames are being read."""

    def report(self, result: ShiftResult) -> None:
        """Tell of one shift."""

    def finish(self, summary: Summary) -> None:
        """Tell the numbers of the run."""
