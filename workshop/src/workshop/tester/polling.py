"""Trouble codes of a controller, polled while its bus is diagnosed."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Final

from canlog.errors import NOTICE, CanlogError
from clutch_results.records import dump
from diag_service.delivery import ControllerNews, Outbox, Reporter
from diag_service.errors import DiagServiceError
from diag_service.service.session import utc_now
from diag_service.settings.config import BusConfig, PollConfig
from diag_service.store import ResultStore
from fleet_contract import Channel, Outgoing, controller_message
from fleet_contract.errors import ResultError
from workshop.tester.addresses import parse_address
from workshop.tester.answers import TesterTiming
from workshop.tester.asking import LISTEN_S, AskingThread, BusTarget, address_for, asking, check_libraries
from workshop.tester.description import Description, find_description
from workshop.tester.questions import read_troubles, recognise
from workshop.tester.trouble import Record, TroubleCode, code_words, trouble_record

MOST_CODES: Final = 1024  # limit of the contract
_KEPT: Final = ("snapshots", "extended_data")


LONGEST_BACKOFF: Final = 16.0  # greatest pause after failures, in periods
_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerReport(ControllerNews):
    """The trouble codes of a controller at one time."""

    vehicle: str
    read_at: str  # ISO 8601 UTC
    controller: str  # its address
    description: str  # name of its description
    codes: tuple[TroubleCode, ...]

    def __str__(self) -> str:
        """Return a line with the codes, confirmed ones first."""
        ranked = sorted(self.codes, key=lambda code: not code.is_confirmed)
        return f"controller {self.controller}: {', '.join(map(code_words, ranked)) or 'no trouble codes'}"

    @property
    def record(self) -> Record:
        """The public record for stores and messages."""
        return {
            "schema": "clutchdiag/controller/v1",
            "vehicle": self.vehicle,
            "produced_at": self.read_at,
            "controller": self.controller,
            "description": self.description,
            "codes": [trouble_record(code) for code in self.codes],
        }


def publish_controller(
    report: ControllerReport, store: ResultStore, reporter: Reporter, publish: Callable[[Outgoing], object]
) -> None:
    """Store and publish a report, and show it if it is new; raises StoreFullError, StoreError.

    It is published even if the store has it: a broker may have lost it.
    """
    record = report.record
    content = dump({key: value for key, value in record.items() if key != "produced_at"})
    is_new = store.note_controller(report.vehicle, report.controller, content, dump(record))
    publish(message_of(record))
    if is_new:
        reporter.report(report)


def message_of(record: Mapping[str, object]) -> Outgoing:
    """Return the message of a record; one that is too long loses snapshots and extended data."""
    listed = record["codes"]
    codes = listed[:MOST_CODES] if isinstance(listed, list) else []
    message = controller_message({**record, "codes": codes})
    if len(message.payload) <= Channel.CONTROLLER.max_bytes:
        return message
    short = [{**code, **{name: [] for name in _KEPT}} for code in codes]
    longest = max((len(dump(code)) for code in short), default=1) + 1
    return controller_message({**record, "codes": short[: (Channel.CONTROLLER.max_bytes - 2048) // longest]})


class Poller(AskingThread):
    """Polls in a thread while entered, less and less often after failures.

    Parameters
    ----------
    read
        Reads once; raises SourceError or ControllerError.
    deliver
        Gets each report, in that thread; may raise StoreError.
    period_s
        Pause between two rounds [s].
    """

    def __init__(
        self, read: Callable[[], ControllerReport], deliver: Callable[[ControllerReport], None], period_s: float
    ) -> None:
        super().__init__("poller")
        self._read = read
        self._deliver = deliver
        self._period_s = period_s

    def _run(self) -> None:
        failed_in_a_row = 0
        while not self._is_over.is_set():
            problem = self._round()
            if self._is_over.is_set():
                return
            if problem is None:
                if failed_in_a_row:
                    _LOG.log(NOTICE, "the controller answers again")
                failed_in_a_row = 0
            else:
                if not failed_in_a_row:
                    _LOG.warning("the trouble codes were not read: %s; trying again, less and less often", problem)
                failed_in_a_row += 1
            self._is_over.wait(pause_s(self._period_s, failed_in_a_row))

    def _round(self) -> str | None:
        """Read and deliver once; return an error as text, None if there is none."""
        try:
            report = self._read()
            if not self._is_over.is_set():
                self._deliver(report)
        except (CanlogError, DiagServiceError, ResultError) as exc:  # expected errors do not end the thread
            return str(exc)
        return None


def pause_s(period_s: float, failed_in_a_row: int) -> float:
    """Return the pause before the next round [s]: the period, doubled with each failure in a row, up to a limit."""
    return float(period_s * min(2.0 ** min(failed_in_a_row, 10), LONGEST_BACKOFF))


def read_once(
    vehicle: str,
    target: BusTarget,
    description: Description,
    now: Callable[[], str],
    goes_on: Callable[[], bool] = lambda: True,
) -> ControllerReport:
    """Listen, read the trouble codes of one controller, and return them.

    Raises SourceError, ControllerError if the bus cannot be used, another tester is active, or the controller refuses
    or does not answer, StoppedError if ``goes_on`` returns False.
    """
    with asking(target, TesterTiming(), goes_on=goes_on) as (tester, _):
        known = recognise(tester, description)
        codes = read_troubles(tester, known)
    return ControllerReport(
        vehicle=vehicle, read_at=now(), controller=tester.where, description=known.name, codes=codes
    )


def poller_for(
    vehicle: str, bus: BusConfig, poll: PollConfig, now: Callable[[], str], deliver: Callable[[ControllerReport], None]
) -> Poller:
    """Return a poller by the settings; raises ConfigError, ExtraMissingError if they cannot be used."""
    check_libraries()
    description = find_description(poll.description)
    target = BusTarget(
        bus=poll.bus or bus,
        address=address_for(parse_address(poll.ecu, poll.reply), description),
        is_fd=bus.is_fd,
        listen_s=LISTEN_S,
    )
    poller = Poller(
        lambda: read_once(vehicle, target, description, now, lambda: poller.goes_on), deliver, poll.period_s
    )
    return poller


@asynccontextmanager
async def polling(
    vehicle: str, bus: BusConfig, poll: PollConfig, store: ResultStore, reporter: Reporter, outbox: Outbox | None
) -> AsyncIterator[None]:
    """Poll a controller until the block ends; in the loop that runs the outbox."""
    loop = asyncio.get_running_loop()

    def publish(message: Outgoing) -> None:
        if outbox is not None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(outbox.publish_state, message)

    poller = poller_for(
        vehicle, bus, poll, utc_now, lambda report: publish_controller(report, store, reporter, publish)
    )
    with poller:
        try:
            yield
        finally:
            await asyncio.to_thread(poller.end)  # a request in progress does not block the loop
