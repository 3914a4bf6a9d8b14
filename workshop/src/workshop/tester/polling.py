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
from diag_service.errors import DiagServiceError, StoppedError
from diag_service.service.session import utc_now
from diag_service.settings.config import BusConfig, PollConfig
from diag_service.store import ResultStore
from fleet_contract import Channel, Outgoing, controller_message
from fleet_contract.errors import ResultError
from workshop.tester.addresses import parse_address
from workshop.tester.answers import TesterTiming
from workshop.tester.asking import AskingThread, BusTarget, address_for, asking, check_libraries
from workshop.tester.description import Description, find_description
from workshop.tester.questions import read_troubles, recognise
from workshop.tester.trouble import Record, TroubleCode, code_words, trouble_record

MOST_CODES: Final = 1024  # limit of the contract
_KEPT: Final = ("snapshots", "extended_data")


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
    """Polls in a thread while entered; a failure does not end it.

    Parameters
    ----------
    vehicle, target, description
        Vehicle of the reports, controller, and its description.
    deliver
        Gets each report, in that thread; may raise StoreError.
    period_s
        Pause between two rounds [s].
    """

    def __init__(
        self,
        vehicle: str,
        target: BusTarget,
        description: Description,
        deliver: Callable[[ControllerReport], None],
        period_s: float,
    ) -> None:
        super().__init__("poller")
        self._vehicle = vehicle
        self._target = target
        self._description = description
        self._deliver = deliver
        self._period_s = period_s

    def _run(self) -> None:
        is_failing = False
        while self.goes_on:
            try:
                report = self._read()
                if not self.goes_on:
                    return
                self._deliver(report)
            except StoppedError:
                return
            except (CanlogError, DiagServiceError, ResultError) as exc:
                if self.goes_on and not is_failing:
                    _LOG.warning("the trouble codes were not read: %s; trying again", exc)
                is_failing = True
            else:
                if is_failing:
                    _LOG.log(NOTICE, "the controller answers again")
                is_failing = False
            self._is_over.wait(self._period_s)

    def _read(self) -> ControllerReport:
        with asking(self._target, TesterTiming(), goes_on=lambda: self.goes_on) as (tester, _):
            known = recognise(tester, self._description)
            codes = read_troubles(tester, known)
        return ControllerReport(
            vehicle=self._vehicle,
            read_at=utc_now(),
            controller=tester.where,
            description=known.name,
            codes=codes,
        )


@asynccontextmanager
async def polling(
    vehicle: str, bus: BusConfig, poll: PollConfig, store: ResultStore, reporter: Reporter, outbox: Outbox | None
) -> AsyncIterator[None]:
    """Poll a controller until the block ends, in the loop that runs the outbox.

    Raises ConfigError, ExtraMissingError if the settings cannot be used.
    """
    check_libraries()
    loop = asyncio.get_running_loop()
    description = find_description(poll.description)
    address = address_for(parse_address(poll.ecu, poll.reply), description)
    target = BusTarget(bus=poll.bus or bus, address=address, is_fd=bus.is_fd)

    def publish(message: Outgoing) -> None:
        if outbox is not None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(outbox.publish_state, message)

    def deliver(report: ControllerReport) -> None:
        publish_controller(report, store, reporter, publish)

    with Poller(vehicle, target, description, deliver, poll.period_s) as poller:
        try:
            yield
        finally:
            await asyncio.to_thread(poller.end)  # a request in progress does not block the loop
