"""What the pipeline knows about those who hear of results."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from diag_service.diagnosis.records import FluidFill, ShiftResult
from diag_service.diagnosis.summary import Summary
from fleet_contract import Outgoing, Receipt


class ControllerNews(ABC):
    """What a controller said of itself; ``str`` returns it on a line for people."""

    @property
    @abstractmethod
    def record(self) -> Mapping[str, object]:
        """The public record that stores and messages hold."""


# Where frames are read from; then each shift, and what a controller says that is new; at the end the numbers.
News = str | ShiftResult | ControllerNews | Summary
OnFills = Callable[[list[FluidFill]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeliveryLimits:
    """Times and counts of an outbox; what stands here suits a vehicle on a mobile link."""

    first_pause_s: float = 0.5  # after a connection broke; doubled with each further failure
    longest_pause_s: float = 30.0
    restart_pause_s: float = 1.0  # after the sending itself failed, which it should not
    settled_after_s: float = 5.0  # then a result that a broker acknowledged is taken to be where it belongs
    resend_after_s: float = 5.0  # without a receipt
    longest_resend_s: float = 30.0  # while all is silent a few are sent again, less and less often up to this
    astray_after_s: float = 2.0  # what was sent so long before an acknowledged one was lost on its way, not delayed
    backlog_lag_s: float = 2.0  # so far behind a backend may be before it gets more of the backlog
    window_count: int = 2000  # results in flight: sent, without a receipt
    probe_count: int = 20  # results that ask a silent backend whether it is there; the others wait for its word


class OnReceipts(Protocol):
    """Hears the backend."""

    def __call__(self, receipts: list[Receipt], *, takes_bundles: bool = False) -> None:
        """Take receipts, and whether who gave them takes several results in one message."""


class Link(Protocol):
    """An open connection to a broker; the outbox opens one, uses it while it lasts, and opens the next."""

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Deliver messages, several in flight; return when the broker acknowledged all.

        Raises
        ------
        PublishRefusedError, PublishError
            If the broker takes one of them never; if it cannot be delivered now.
        """

    async def listen(self, vehicle: str, on_receipts: OnReceipts) -> None:
        """Call ``on_receipts`` with the receipts of a backend from now on; raises PublishError if that is refused."""

    async def hear_fills(self, vehicle: str, on_fills: OnFills) -> None:
        """Call ``on_fills`` with the fluid fills that the fleet knows from now on, as far as the broker lets us."""

    async def lost(self) -> None:
        """Return when the connection is lost, or when a better one could be had."""


class Reporter(Protocol):
    """Shows a run to the person or program that started it; may block, so it runs in the worker thread."""

    def report(self, news: News) -> None:
        """Show one of the news; the numbers of the run are the last of them."""
