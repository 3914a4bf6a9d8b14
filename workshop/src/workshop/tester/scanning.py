"""Controllers on a bus and the services and data of each, found by requests that change nothing."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import can

from canlog.errors import NOTICE
from diag_service import errors
from diag_service.settings.config import BusConfig
from workshop.tester import asking, listening
from workshop.tester.addresses import (
    FIXED_PHYSICAL,
    FUNCTIONAL_ID,
    LARGEST_STANDARD_ID,
    TESTER_ADDRESS,
    CanAddress,
    check_number,
    id_text,
    is_extended,
    is_request,
)
from workshop.tester.answers import (
    COUNT_BY_MASK,
    NEGATIVE,
    NOT_SUPPORTED,
    ONLY_ELSEWHERE,
    POSITIVE,
    READ_DATA,
    READ_TROUBLE,
    SERVICE_NAMES,
    TESTER_PRESENT,
    TesterTiming,
    refusal_text,
    request_text,
)
from workshop.tester.description import STANDARD_DATA, UNKNOWN, Description
from workshop.tester.questions import FAILED_MASK, DataAnswer, read_datum, recognise

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue

SHORTEST_WAIT_S: Final = 0.001
FIRST_STANDARD_ID: Final = 0x700
LARGEST_TARGET: Final = 0xFF  # of normal fixed addressing
STANDARD_NUMBERS: Final = tuple(STANDARD_DATA)
ALL_NUMBERS: Final = range(0xF100, 0xF200)  # ISO 14229-1, annex C: identification, by the standard and by makers
_LOG: Final = logging.getLogger(__name__)


WAIT_S: Final = 0.06  # P2 of a controller, and a little for the bus
SUSPECTS: Final = 4  # last requests to which a late answer may belong
MOST_SILENT: Final = 3  # unanswered requests after which no more data are read
_PRESENT: Final = bytes([0x02, TESTER_PRESENT, 0x00])  # a single frame: TesterPresent
_FRAME: Final = _PRESENT.ljust(listening.CLASSIC_BYTES, bytes([listening.PADDING]))
_ANSWERS: Final = (bytes([0x02, TESTER_PRESENT + POSITIVE, 0x00]), bytes([0x03, NEGATIVE, TESTER_PRESENT]))
PROBES: Final = (  # reading services only, which change neither session nor memory
    (TESTER_PRESENT, bytes([TESTER_PRESENT, 0x00])),
    (READ_DATA, bytes([READ_DATA, 0xF1, 0x90])),
    (READ_TROUBLE, bytes([READ_TROUBLE, COUNT_BY_MASK, FAILED_MASK])),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceAnswer:
    """The answer of a controller to one service."""

    number: int
    is_there: bool
    remark: str  # refusal, silence or a malformed answer

    @property
    def name(self) -> str:
        return SERVICE_NAMES.get(self.number, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundController:
    """A controller with its services and data."""

    where: str
    address: CanAddress | None  # None: over IP
    services: tuple[ServiceAnswer, ...]
    data: tuple[DataAnswer, ...]  # without refused ones
    code_count: int | None  # trouble codes that have failed; None: not answered


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPlan:
    """Where to look for controllers, and what to ask each."""

    place: BusConfig | can.BusABC | asking.DoipPlace
    first: int | None = None  # identifier on a bus, or address with 29 bits; None: the lowest
    last: int | None = None  # None: the highest
    is_extended: bool = False
    has_all_data: bool = False  # whether to try F100 to F1FF, not the standard ones alone
    is_fd: bool = False
    listen_s: float
    timeout_s: float
    wait_s: float  # time for an answer of each identifier

    def __post_init__(self) -> None:
        asking.check_time("wait", self.wait_s, least_s=SHORTEST_WAIT_S)
        asking.timing_of(self.listen_s, self.timeout_s)
        for name, value in (("first", self.first), ("last", self.last)):
            if value is not None:
                check_number(name, value, self._largest)
        if not self.request_ids and not isinstance(self.place, asking.DoipPlace):
            raise errors.ConfigError(f"there is no identifier from {self.first or 0:X} to {self.last or 0:X}")

    @property
    def _largest(self) -> int:
        return LARGEST_TARGET if self.is_extended else LARGEST_STANDARD_ID

    @property
    def request_ids(self) -> list[int]:
        """Identifiers to try on a bus, without the functional one; of 29 bits those of normal fixed addressing."""
        if isinstance(self.place, asking.DoipPlace):
            return []
        lowest = 0 if self.is_extended else FIRST_STANDARD_ID
        numbers = range(
            lowest if self.first is None else self.first, 1 + (self._largest if self.last is None else self.last)
        )
        if self.is_extended:
            return [FIXED_PHYSICAL | target << 8 | TESTER_ADDRESS for target in numbers]
        return [can_id for can_id in numbers if can_id != FUNCTIONAL_ID]

    @property
    def data(self) -> Sequence[int]:
        """Numbers to try on each controller."""
        return ALL_NUMBERS if self.has_all_data else STANDARD_NUMBERS

    @property
    def timing(self) -> TesterTiming:
        return asking.timing_of(self.listen_s, self.timeout_s)

    @property
    def requests(self) -> list[str]:
        """The requests, for people."""
        asked = [*(request_text(request) for _, request in PROBES), f"22 {min(self.data):04X}-{max(self.data):04X}"]
        if isinstance(self.place, asking.DoipPlace):
            return asked
        span = f"{id_text(self.request_ids[0])}-{id_text(self.request_ids[-1])}"
        return [
            f"{request_text(bytes([TESTER_PRESENT, 0]))} to {span}",
            *(f"each that answers: {question}" for question in asked),
        ]


def find_addresses(
    bus: can.BusABC,
    request_ids: Iterable[int],
    busy_ids: frozenset[int],
    *,
    wait_s: float = WAIT_S,
    goes_on: Callable[[], bool] = lambda: True,
) -> list[CanAddress]:
    """Return the addresses that answer TesterPresent, sorted by the identifier of the request.

    Raises ControllerError if the bus cannot be used, or another tester begins to ask.

    Parameters
    ----------
    busy_ids
        Identifiers of earlier traffic: they are neither asked nor taken for answers.
    wait_s
        Time for each answer [s].
    goes_on
        Asked before each request; False ends the search.
    """
    by_response: dict[int, CanAddress] = {}  # by the identifier of the answers
    recent: deque[int] = deque(maxlen=SUSPECTS)
    for request_id in request_ids:
        if not goes_on():
            break
        if request_id in busy_ids or request_id in by_response:
            continue
        recent.appendleft(request_id)
        for response_id in _probe(bus, request_id, wait_s) - busy_ids - by_response.keys():
            asked = _confirm_request(bus, recent, response_id, wait_s)
            if asked is not None:
                by_response[response_id] = CanAddress(request_id=asked, response_id=response_id)
    return sorted(by_response.values(), key=lambda address: address.request_id)


def _confirm_request(bus: can.BusABC, suspects: Iterable[int], response_id: int, wait_s: float) -> int | None:
    """Repeat the last requests with more time; return the one that this identifier answers."""
    for request_id in suspects:
        if request_id != response_id and is_extended(request_id) == is_extended(response_id):
            _probe(bus, None, wait_s)  # late answers
            if response_id in _probe(bus, request_id, SUSPECTS * wait_s, response_id):
                return request_id
    return None


def _probe(bus: can.BusABC, request_id: int | None, wait_s: float, wanted: int | None = None) -> frozenset[int]:
    """Ask once and return the identifiers of answers in time; stop at the wanted one."""
    if request_id is not None:
        listening.send(bus, can.Message(arbitration_id=request_id, is_extended_id=is_extended(request_id), data=_FRAME))
    until_s = time.monotonic() + wait_s
    response_ids = set[int]()
    while (left_s := until_s - time.monotonic()) > 0.0 and (wanted is None or wanted not in response_ids):
        message = listening.receive(bus, left_s)
        if message is None or message.is_error_frame:
            continue
        if is_request(message.arbitration_id) and bytes(message.data) != _FRAME:  # own frames may be echoed
            asked = id_text(message.arbitration_id)
            raise errors.ControllerError(
                f"another tester began to ask on this bus (requests on {asked}): the scan gave way to it"
            )
        if bytes(message.data[:3]) in _ANSWERS:
            response_ids.add(message.arbitration_id)
    return frozenset(response_ids)


def _explore(tester: "Dialogue", plan: ScanPlan, address: CanAddress | None) -> FoundController:
    """Return one controller with its services and data."""
    try:
        known = recognise(tester)
    except errors.PendingError:
        known = UNKNOWN
    services = tuple(_try_service(tester, number, request) for number, request in PROBES)
    answered = {service.number for service in services if service.is_there and not service.remark}
    data = tuple(_read_data(tester, known, plan.data)) if READ_DATA in answered else ()
    code_count = None
    if READ_TROUBLE in answered:
        with suppress(errors.ControllerError):
            response = tester.ask(bytes([READ_TROUBLE, COUNT_BY_MASK, FAILED_MASK]))
            code_count = int.from_bytes(response[4:6], "big")
    return FoundController(
        where=tester.where,
        address=address,
        services=services,
        data=data,
        code_count=code_count,
    )


def _try_service(tester: "Dialogue", number: int, request: bytes) -> ServiceAnswer:
    try:
        tester.ask(request)
    except errors.RefusedError as exc:
        is_there = exc.code not in NOT_SUPPORTED
        remark = refusal_text(exc.code) if exc.code in NOT_SUPPORTED | ONLY_ELSEWHERE else ""
        return ServiceAnswer(number=number, is_there=is_there, remark=remark)
    except errors.SilentError as exc:
        return ServiceAnswer(number=number, is_there=isinstance(exc, errors.PendingError), remark=str(exc))
    except errors.MalformedAnswerError as exc:
        return ServiceAnswer(number=number, is_there=True, remark=str(exc))
    return ServiceAnswer(number=number, is_there=True, remark="")


def _read_data(tester: "Dialogue", description: Description, numbers: Iterable[int]) -> Iterable[DataAnswer]:
    silent = 0
    for number in numbers:
        try:
            answer = read_datum(tester, description, number)
        except errors.SilentError as exc:
            silent += 1
            if silent >= MOST_SILENT or isinstance(exc, errors.PendingError):
                return
            continue
        if answer.refusal is None:
            yield answer


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """The result of a scan."""

    traffic: listening.HeardTraffic | None  # before the first request; None over IP
    controllers: tuple[FoundController, ...]


def scan(plan: ScanPlan, *, goes_on: Callable[[], bool] = lambda: True) -> Scan:
    """Listen, look for controllers and explore each; if it is stopped, return those found until then.

    Raises SourceError, ControllerError if the bus cannot be used, another tester is active, or a node is missing,
    ExtraMissingError if a library is missing.
    """
    if isinstance(plan.place, asking.DoipPlace):
        with asking.dialogue_over_ip(plan.place, plan.timing, goes_on=goes_on) as tester:
            return Scan(traffic=None, controllers=(_explore(tester, plan, None),))
    with asking.opened_bus(plan.place) as bus:
        traffic = listening.listen(bus, plan.listen_s, goes_on)
        listening.check_alone(traffic)
        _LOG.log(NOTICE, "listened: %s; asking %d identifiers", traffic, len(plan.request_ids))
        addresses = find_addresses(bus, plan.request_ids, traffic.can_ids, wait_s=plan.wait_s, goes_on=goes_on)
        return Scan(traffic=traffic, controllers=tuple(_controllers(bus, addresses, plan, goes_on)))


def _controllers(
    bus: can.BusABC, addresses: Sequence[CanAddress], plan: ScanPlan, goes_on: Callable[[], bool]
) -> Iterator[FoundController]:
    for address in addresses:
        if not goes_on():
            return
        with asking.dialogue_on(bus, address, plan.timing, is_fd=plan.is_fd, goes_on=goes_on) as tester:
            try:
                controller = _explore(tester, plan, address)
            except errors.StoppedError:  # earlier controllers are returned
                return
        yield controller
