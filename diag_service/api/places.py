"""Where controllers are asked, as Python values: checked as the options of the command line are."""

from typing import TYPE_CHECKING, Final

from diag_service.api.choices import AnyPath, check_one_bus, optional_path
from diag_service.errors import ConfigError
from diag_service.tester.addresses import CanAddress, usual_response_id
from diag_service.tester.asking import SHORTEST_ANSWER_S, check_time
from diag_service.tester.manners import Manners
from diag_service.tester.opening import LARGEST_LOGICAL, BusName, DoipPlace, parse_doip
from diag_service.tester.questions import check_number

if TYPE_CHECKING:
    import can

ANSWER_S: Final = 1.0  # until an answer begins


def manners_of(listen_s: float, timeout_s: float) -> Manners:
    """Return how patient the tester is; raises ConfigError if a time cannot be."""
    check_time("listen_s", listen_s, least_s=0.0)
    check_time("timeout_s", timeout_s, least_s=SHORTEST_ANSWER_S)
    return Manners(p2_s=timeout_s)


def place_of(
    bus: "can.BusABC | None",
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    doip: str | None,
    ecu: int | None,
    *,
    is_fd: bool,
    doip_authority: AnyPath | None = None,
) -> "BusName | can.BusABC | DoipPlace":
    """Return where to ask; raises ConfigError."""
    check_one_bus(bus, interface, channel, bitrate, doip)
    if doip is not None:
        if ecu is None:
            raise ConfigError("doip needs ecu: the logical address of the controller, such as 0x1011")
        check_number("ecu", ecu, LARGEST_LOGICAL)
        return parse_doip(doip, ecu, optional_path(doip_authority))
    if doip_authority is not None:
        raise ConfigError("doip_authority needs doip")
    return bus if bus is not None else BusName(interface=interface, channel=channel, bitrate=bitrate, is_fd=is_fd)


def address_of(ecu: int | None, reply: int | None, address: int | None) -> CanAddress | None:
    """Return who is asked on a bus, None if that was not said; raises ConfigError."""
    if ecu is None:
        if reply is not None or address is not None:
            raise ConfigError("reply and address need ecu")
        return None
    if address is not None:
        check_number("address", address, 0xFF)
    response_id = usual_response_id(ecu) if reply is None else reply
    return CanAddress(request_id=ecu, response_id=response_id, target_byte=address)
