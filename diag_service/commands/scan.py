"""``diag-service scan``: which controllers answer on a bus, and what they can be asked."""

import logging
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Final

import can

from canlog.notice import NOTICE
from diag_service.commands.asking import LONGEST_S, Wish, bus_name, doip_place, manners_of, tell_wish, write
from diag_service.errors import ConfigError, StoppedError
from diag_service.service.stopping import Controls, Trigger
from diag_service.tester.addresses import CanAddress, hexadecimal, id_text
from diag_service.tester.answers import TESTER_PRESENT, request_text
from diag_service.tester.description import STANDARD_DATA
from diag_service.tester.dialogue import Dialogue, Manners
from diag_service.tester.listening import Traffic, check_alone, listen
from diag_service.tester.opening import DoipPlace, dialogue_on, dialogue_over_ip, opened_bus
from diag_service.tester.recognising import recognised
from diag_service.tester.report import found_lines, found_record, outcome, traffic_record
from diag_service.tester.scanning import PROBES, Found, explore, find_addresses, fixed_requests, standard_requests

_PAGE: Final = range(0xF100, 0xF200)  # ISO 14229-1, annex C: data that identify a controller, makers' own among them
_LOG: Final = logging.getLogger(__name__)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Look for controllers and ask each what it can be asked; raises StoppedError if that was stopped."""
    manners = manners_of(options)
    if not 0.001 <= options.wait <= LONGEST_S:
        raise ConfigError(f"--wait must be 0.001 to {LONGEST_S:g} s, got {options.wait:g}")
    place = doip_place(options)
    if place is not None:
        _scan_ip(place, options, manners, controls.stop)
    else:
        _scan_bus(options, manners, controls.stop)
    if controls.stop.is_set:
        raise StoppedError("stopped early: what was shown is a part of what is there")


def _scan_ip(place: DoipPlace, options: SimpleNamespace, manners: Manners, stop: Trigger) -> None:
    if not options.active:
        tell_wish(Wish(schema="scan", requests=_questions(options)), None, is_json=options.json)
        return
    with dialogue_over_ip(place, manners, goes_on=lambda: not stop.is_set) as tester:
        _tell([_explored(tester, options, None)], None, is_json=options.json)


def _scan_bus(options: SimpleNamespace, manners: Manners, stop: Trigger) -> None:
    request_ids = _request_ids(options)
    with opened_bus(bus_name(options)) as bus:
        traffic = listen(bus, options.listen)
        if not options.active:
            span = f"{request_text(bytes([TESTER_PRESENT, 0]))} to {id_text(request_ids[0])}-{id_text(request_ids[-1])}"
            wishes = [span, *(f"each that answers: {question}" for question in _questions(options))]
            tell_wish(Wish(schema="scan", requests=wishes), traffic, is_json=options.json)
            return
        check_alone(traffic)
        _LOG.log(NOTICE, "listened: %s; asking %d identifiers", traffic, len(request_ids))
        addresses = find_addresses(
            bus, request_ids, traffic.can_ids, wait_s=options.wait, goes_on=lambda: not stop.is_set
        )
        _tell(_controllers(bus, addresses, options, manners, stop), traffic, is_json=options.json)


def _controllers(
    bus: can.BusABC, addresses: Sequence[CanAddress], options: SimpleNamespace, manners: Manners, stop: Trigger
) -> list[Found]:
    found = []
    for address in addresses:
        if stop.is_set:
            break
        with dialogue_on(bus, address, manners, is_fd=options.fd, goes_on=lambda: not stop.is_set) as tester:
            try:
                found.append(_explored(tester, options, address))
            except StoppedError:  # what was found before is shown
                break
    return found


def _explored(tester: Dialogue, options: SimpleNamespace, address: CanAddress | None) -> Found:
    return explore(tester, recognised(tester), _data(options), address=address)


def _tell(controllers: Sequence[Found], traffic: Traffic | None, *, is_json: bool) -> None:
    heard: dict[str, object] = {} if traffic is None else {"bus": traffic_record(traffic)}
    record = outcome("scan", is_asked=True, **heard, controllers=[found_record(one) for one in controllers])
    write(record, found_lines(controllers), is_json=is_json)


def _data(options: SimpleNamespace) -> Sequence[int]:
    return _PAGE if options.all_data else tuple(STANDARD_DATA)


def _questions(options: SimpleNamespace) -> list[str]:
    numbers = _data(options)
    return [*(request_text(request) for _, request in PROBES), f"22 {min(numbers):04X}-{max(numbers):04X}"]


def _request_ids(options: SimpleNamespace) -> list[int]:
    """Return the identifiers to try; raises ConfigError if there is none."""
    names = ("--first", "--last")
    if options.extended:
        first, last = (
            hexadecimal(text or default, name, 0xFF)
            for text, default, name in zip((options.first, options.last), ("0", "FF"), names, strict=True)
        )
        found = fixed_requests(first, last)
    else:
        first, last = (
            hexadecimal(text or default, name, 0x7FF)
            for text, default, name in zip((options.first, options.last), ("700", "7FF"), names, strict=True)
        )
        found = standard_requests(first, last)
    if not found:
        raise ConfigError(f"there is no identifier from {first:X} to {last:X}")
    return found
