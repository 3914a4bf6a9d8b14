"""What the pipeline knows about those who hear of results."""

from collections.abc import Callable, Sequence
from typing import Protocol

from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.summary import Summary
from fleet_contract import Outgoing, Receipt

Hear = Callable[[list[Receipt]], None]


class Link(Protocol):
    """An open connection to a broker; the outbox opens one, uses it while it lasts, and opens the next."""

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Deliver messages, several in flight; return when the broker acknowledged all, or raise PublishError."""

    async def listen(self, vehicle: str, hear: Hear) -> None:
        """Call ``hear`` with the receipts of a backend from now on; raises PublishError if that is refused."""

    async def lost(self) -> None:
        """Return when the connection is lost, or when a better one could be had."""


class Reporter(Protocol):
    """Tells the person or program that started the service; may block, so it runs in the worker thread."""

    def listening(self, where: str) -> None:
        """Say that frames are being read."""

    def report(self, result: ShiftResult) -> None:
        """Tell of one shift."""

    def finish(self, summary: Summary) -> None:
        """Tell the numbers of the run."""
