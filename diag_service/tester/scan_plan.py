"""A scan from its plan to what it found: listen, find who answers, ask each what it can be asked."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import can

from canlog.notice import NOTICE
from diag_service.errors import ConfigError, PendingError, StoppedError
from diag_service.tester.addresses import LARGEST_STANDARD_ID, CanAddress, id_text
from diag_service.tester.answers import TESTER_PRESENT, request_text
from diag_service.tester.description import STANDARD_DATA, UNKNOWN
from diag_service.tester.listening import LISTEN_S, Traffic, check_alone, listen
from diag_service.tester.manners import Manners
from diag_service.tester.opening import BusName, DoipPlace, dialogue_on, dialogue_over_ip, opened_bus
from diag_service.tester.recognising import recognised
from diag_service.tester.scanning import (
    PROBES,
    WAIT_S,
    Found,
    explore,
    find_addresses,
    fixed_requests,
    standard_requests,
)

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

SHORTEST_WAIT_S: Final = 0.001
FIRST_STANDARD_ID: Final = 0x700
LARGEST_TARGET: Final = 0xFF  # of normal fixed addressing
STANDARD_NUMBERS: Final = tuple(STANDARD_DATA)
ALL_NUMBERS: Final = range(0xF100, 0xF200)  # ISO 14229-1, annex C: data that identify a controller, makers' own too
_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPlan:
    """Where controllers are looked for, and what each is asked."""

    place: BusName | can.BusABC | DoipPlace
    request_ids: Sequence[int] = ()  # to try on a bus
    data: Sequence[int] = STANDARD_NUMBERS  # to try on each controller
    is_fd: bool = False
    manners: Manners = field(default_factory=Manners)
    listen_s: float = LISTEN_S
    wait_s: float = WAIT_S  # how long each identifier may take to answer

    @property
    def requests(self) -> list[str]:
        """What would be sent, for people."""
        asked = [*(request_text(request) for _, request in PROBES), f"22 {min(self.data):04X}-{max(self.data):04X}"]
        if isinstance(self.place, DoipPlace):
            return asked
        span = f"{id_text(self.request_ids[0])}-{id_text(self.request_ids[-1])}"
        return [
            f"{request_text(bytes([TESTER_PRESENT, 0]))} to {span}",
            *(f"each that answers: {question}" for question in asked),
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """What a scan heard and found."""

    traffic: Traffic | None  # before anything was sent; None: over IP there is nothing to hear
    controllers: tuple[Found, ...]


def request_ids(first: int | None, last: int | None, *, is_extended: bool) -> list[int]:
    """Return the identifiers to try, or of 29 bits those of the addresses; None: from the first one, to the last.

    Raises
    ------
    ConfigError
        If there is none.
    """
    low = (0 if is_extended else FIRST_STANDARD_ID) if first is None else first
    high = largest_id(is_extended=is_extended) if last is None else last
    found = fixed_requests(low, high) if is_extended else standard_requests(low, high)
    if not found:
        raise ConfigError(f"there is no identifier from {low:X} to {high:X}")
    return found


def largest_id(*, is_extended: bool) -> int:
    """Return the largest identifier of 11 bits, or the largest address of a controller."""
    return LARGEST_TARGET if is_extended else LARGEST_STANDARD_ID


def scan(plan: ScanPlan, *, goes_on: Callable[[], bool] = lambda: True) -> Scan:
    """Listen, look for controllers and ask each what it can be asked; what was found until it was stopped is returned.

    Raises
    ------
    SourceError, ControllerError
        If the bus cannot be used, another tester is at work, or a node is not there.
    ExtraMissingError
        If a library is missing.
    """
    if isinstance(plan.place, DoipPlace):
        with dialogue_over_ip(plan.place, plan.manners, goes_on=goes_on) as tester:
            return Scan(traffic=None, controllers=(_explored(tester, plan, None),))
    with opened_bus(plan.place) as bus:
        traffic = listen(bus, plan.listen_s, goes_on)
        check_alone(traffic)
        _LOG.log(NOTICE, "listened: %s; asking %d identifiers", traffic, len(plan.request_ids))
        addresses = find_addresses(bus, plan.request_ids, traffic.can_ids, wait_s=plan.wait_s, goes_on=goes_on)
        return Scan(traffic=traffic, controllers=tuple(_controllers(bus, addresses, plan, goes_on)))


def _controllers(
    bus: can.BusABC, addresses: Sequence[CanAddress], plan: ScanPlan, goes_on: Callable[[], bool]
) -> Iterator[Found]:
    for address in addresses:
        if not goes_on():
            return
        with dialogue_on(bus, address, plan.manners, is_fd=plan.is_fd, goes_on=goes_on) as tester:
            try:
                found = _explored(tester, plan, address)
            except StoppedError:  # what was found before is shown
                return
        yield found


def _explored(tester: "Dialogue", plan: ScanPlan, address: CanAddress | None) -> Found:
    try:
        known = recognised(tester)
    except PendingError:
        known = UNKNOWN
    return explore(tester, known, plan.data, address=address)
