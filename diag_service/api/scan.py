"""Controllers on a bus from Python: ``scan_controllers`` finds them; it listens before it asks."""

from typing import TYPE_CHECKING

from diag_service.api.choices import AnyPath
from diag_service.api.places import ANSWER_S, manners_of, place_of
from diag_service.errors import ConfigError
from diag_service.tester.asking import check_time
from diag_service.tester.listening import LISTEN_S
from diag_service.tester.opening import DoipPlace
from diag_service.tester.questions import check_number
from diag_service.tester.scan_plan import (
    ALL_NUMBERS,
    SHORTEST_WAIT_S,
    STANDARD_NUMBERS,
    Scan,
    ScanPlan,
    largest_id,
    request_ids,
    scan,
)
from diag_service.tester.scanning import WAIT_S

if TYPE_CHECKING:
    import can


def scan_controllers(
    bus: "can.BusABC | None" = None,
    *,
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    is_fd: bool = False,
    doip: str | None = None,
    doip_authority: AnyPath | None = None,
    ecu: int | None = None,
    first: int | None = None,
    last: int | None = None,
    is_extended: bool = False,
    has_all_data: bool = False,
    is_active: bool = False,
    listen_s: float = LISTEN_S,
    timeout_s: float = ANSWER_S,
    wait_s: float = WAIT_S,
) -> Scan:
    """Find controllers and what each can be asked, by questions that change nothing: ``diag-service scan``.

    Parameters
    ----------
    bus, interface, channel, bitrate, is_fd, doip, doip_authority, ecu, listen_s, timeout_s
        As of ``UdsTester``.
    first, last
        Identifiers from which and up to which to try, by default 700 to 7FF; with ``is_extended`` addresses, 00 to FF.
    is_extended
        Whether to try identifiers of 29 bits, 18DAxxF1.
    has_all_data
        Whether to try all data F100 to F1FF, not only those that the standard names.
    is_active
        Whether requests are sent; without, ConfigError says what would be.
    wait_s
        How long each identifier may take to answer [s].

    Returns
    -------
    Scan
        ``.controllers``, each with its services and data; ``.traffic`` is what was heard before.

    Raises
    ------
    ConfigError, SourceError, ControllerError
        If an argument or the bus cannot be used, another tester is at work, or a node is not there.
    """
    check_time("wait_s", wait_s, least_s=SHORTEST_WAIT_S)
    most = largest_id(is_extended=is_extended)
    for name, value in (("first", first), ("last", last)):
        if value is not None:
            check_number(name, value, most)
    place = place_of(bus, interface, channel, bitrate, doip, ecu, is_fd=is_fd, doip_authority=doip_authority)
    plan = ScanPlan(
        place=place,
        request_ids=() if isinstance(place, DoipPlace) else request_ids(first, last, is_extended=is_extended),
        data=ALL_NUMBERS if has_all_data else STANDARD_NUMBERS,
        is_fd=is_fd,
        manners=manners_of(listen_s, timeout_s),
        listen_s=listen_s,
        wait_s=wait_s,
    )
    if not is_active:
        raise ConfigError(f"nothing was sent; with is_active=True this would be asked: {'; '.join(plan.requests)}")
    return scan(plan)
