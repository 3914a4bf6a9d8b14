"""Listen first, then ask: what commands, polling and Python do with one controller."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import can

from diag_service.errors import ConfigError
from diag_service.tester.addresses import CanAddress
from diag_service.tester.listening import LISTEN_S, Traffic, check_alone, listen
from diag_service.tester.manners import Manners
from diag_service.tester.opening import BusName, DoipPlace, dialogue_on, dialogue_over_ip, opened_bus

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

LONGEST_S: Final = 3600.0
SHORTEST_ANSWER_S: Final = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class BusTarget:
    """One controller on a bus."""

    bus: BusName | can.BusABC
    address: CanAddress
    is_fd: bool = False  # whether requests go out in CAN FD frames
    listen_s: float = LISTEN_S  # before anything is sent


@contextmanager
def asking(
    target: BusTarget | DoipPlace, manners: Manners, *, goes_on: Callable[[], bool] = lambda: True
) -> "Iterator[tuple[Dialogue, Traffic | None]]":
    """Listen, then be ready to ask for the time of the block; yield the tester, and what it heard on a bus before.

    Parameters
    ----------
    goes_on
        Asked while an answer is waited for; False ends that with StoppedError.

    Raises
    ------
    SourceError, ControllerError
        If the bus cannot be used, another tester is at work, or a node is not there.
    ExtraMissingError
        If a library is missing.
    """
    if isinstance(target, DoipPlace):
        with dialogue_over_ip(target, manners, goes_on=goes_on) as tester:
            yield tester, None
        return
    with opened_bus(target.bus) as bus:
        traffic = listen(bus, target.listen_s, goes_on)
        check_alone(traffic, target.address)
        with dialogue_on(bus, target.address, manners, is_fd=target.is_fd, goes_on=goes_on) as tester:
            yield tester, traffic


def heard(
    place: BusName | can.BusABC | DoipPlace, listen_s: float, goes_on: Callable[[], bool] = lambda: True
) -> Traffic | None:
    """Return what is heard where something would be asked; None: over IP there is nothing to hear.

    Raises
    ------
    SourceError, ControllerError
        If the bus cannot be used.
    """
    if isinstance(place, DoipPlace):
        return None
    with opened_bus(place) as bus:
        return listen(bus, listen_s, goes_on)


def check_time(name: str, value_s: float, *, least_s: float) -> None:
    """Raise ConfigError unless a time is usable [s]."""
    if not least_s <= value_s <= LONGEST_S:
        raise ConfigError(f"{name} must be {least_s:g} to {LONGEST_S:g} s, got {value_s:g}")
