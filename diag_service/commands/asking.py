"""What the commands that ask controllers have in common: listen first, ask only if that was wanted."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Final

from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.results import dump
from diag_service.errors import ConfigError
from diag_service.service.stopping import Trigger
from diag_service.tester.addresses import CanAddress, hexadecimal, parse_address
from diag_service.tester.description import UNKNOWN, Description
from diag_service.tester.description_file import find_description
from diag_service.tester.dialogue import Dialogue, Manners
from diag_service.tester.listening import Traffic, check_alone, listen
from diag_service.tester.opening import (
    BusName,
    DoipPlace,
    address_for,
    dialogue_on,
    dialogue_over_ip,
    opened_bus,
    parse_doip,
)
from diag_service.tester.recognising import recognised
from diag_service.tester.report import dialogue_record, outcome, traffic_record, would_lines
from diag_service.tester.trouble_report import Record

LONGEST_S: Final = 3600.0
_LARGEST_LOGICAL: Final = 0xFFFF

Answer = tuple[Record, Iterable[str]]  # as JSON, and as lines for people


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a command is about to ask."""

    schema: str
    requests: Sequence[str]  # for people


def ask_one(
    options: SimpleNamespace,
    wish: Callable[[Description], Wish],
    use: Callable[[Dialogue, Description], Answer],
    stop: Trigger,
) -> None:
    """Listen, then let a command ask one controller; without ``--active`` say what it would ask.

    Parameters
    ----------
    wish
        What the command would ask, by what is known of the controller.
    use
        Asks, and returns what was found.
    stop
        Ends it early.

    Raises
    ------
    ConfigError, ExtraMissingError, SourceError, ControllerError
        If something cannot be used, or the controller does not answer or will not.
    StoppedError
        If it was stopped.
    """

    def goes_on() -> bool:
        return not stop.is_set

    manners = manners_of(options)
    description = find_description(options.description)
    wanted = wish(description)
    place = doip_place(options)
    with ExitStack() as stack:
        if place is None:
            traffic, opened = _on_bus(options, description, manners, stack, goes_on)
        else:
            traffic, opened = None, dialogue_over_ip(place, manners, goes_on=goes_on)
        if not options.active:
            tell_wish(wanted, traffic, is_json=options.json)
            return
        tester = stack.enter_context(opened)
        known = recognised(tester) if description is UNKNOWN else description
        record, lines = use(tester, known)
        head: Record = {"controller": tester.where, "description": known.name}
        more: Record = {"dialogue": dialogue_record(tester.counts)}
        write(outcome(wanted.schema, is_asked=True, **head, **record, **more), lines, is_json=options.json)


def _on_bus(
    options: SimpleNamespace, description: Description, manners: Manners, stack: ExitStack, goes_on: Callable[[], bool]
) -> tuple[Traffic, AbstractContextManager[Dialogue]]:
    address = address_for(_address_of(options), description)
    bus = stack.enter_context(opened_bus(bus_name(options)))
    traffic = listen(bus, options.listen)
    if options.active:
        check_alone(traffic, address)
    return traffic, dialogue_on(bus, address, manners, is_fd=options.fd, goes_on=goes_on)


def tell_wish(wanted: Wish, traffic: Traffic | None, *, is_json: bool) -> None:
    """Say what was heard and what would be asked."""
    heard: Record = {} if traffic is None else {"bus": traffic_record(traffic)}
    record = outcome(wanted.schema, is_asked=False, **heard, would_ask=list(wanted.requests))
    write(record, would_lines(traffic, wanted.requests), is_json=is_json)


def write(record: Mapping[str, object], lines: Iterable[str], *, is_json: bool) -> None:
    """Show what was found: one JSON object, or lines for people."""
    if is_json:
        sys.stdout.write(dump(record) + "\n")
        return
    console = PeopleConsole()
    for line in lines:
        console.print(line)


def manners_of(options: SimpleNamespace) -> Manners:
    """Return how patient the tester is to be; raises ConfigError if a time cannot be."""
    patience = {"patience": 0.001} if hasattr(options, "patience") else {}
    for name, least in {"listen": 0.0, "timeout": 0.001, **patience}.items():
        value = getattr(options, name)
        if not least <= value <= LONGEST_S:
            raise ConfigError(f"--{name} must be {least:g} to {LONGEST_S:g} s, got {value:g}")
    patient = Manners(p2_s=options.timeout)
    return replace(patient, longest_s=options.patience) if patience else patient


def bus_name(options: SimpleNamespace) -> BusName:
    """Return which bus to open."""
    return BusName(
        interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=bool(options.fd)
    )


def doip_place(options: SimpleNamespace) -> DoipPlace | None:
    """Return where to ask over IP, None for a bus; raises ConfigError."""
    if options.doip is None:
        if options.doip_authority is not None:
            raise ConfigError("--doip-authority needs --doip")
        return None
    if options.ecu is None:
        raise ConfigError("--doip needs --ecu: the logical address of the controller, such as 1011")
    if options.reply is not None or options.address is not None:
        raise ConfigError("--reply and --address are of a bus, not of --doip")
    logical_address = hexadecimal(options.ecu, "--ecu", _LARGEST_LOGICAL)
    return parse_doip(options.doip, logical_address, options.doip_authority)


def _address_of(options: SimpleNamespace) -> CanAddress | None:
    return parse_address(options.ecu, options.reply, options.address)


def hex_bytes(text: str, what: str) -> bytes:
    """Return bytes that were written in hexadecimal, with or without blanks; raises ConfigError."""
    try:
        return bytes.fromhex(text)
    except ValueError as exc:
        raise ConfigError(f"{what} must be hexadecimal bytes such as '01 0A', got {text!r}") from exc
