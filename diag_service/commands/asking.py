"""What the commands that ask controllers have in common: their options, and how what was found is shown."""

import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import TypeVar

from diag_service.console.reading import ReadingLine
from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.results import dump
from diag_service.errors import ConfigError
from diag_service.service.stopping import Trigger
from diag_service.tester.addresses import hexadecimal, parse_address
from diag_service.tester.asking import (
    LARGEST_LOGICAL,
    SHORTEST_ANSWER_S,
    BusName,
    BusTarget,
    DoipPlace,
    Traffic,
    address_for,
    asking,
    check_time,
    heard,
    parse_doip,
)
from diag_service.tester.description import Description
from diag_service.tester.description_file import find_description, recognised
from diag_service.tester.questions import Question
from diag_service.tester.report import dialogue_record, outcome, traffic_record, would_lines
from diag_service.tester.timing import Timing
from diag_service.tester.trouble_report import Record

_AnswerT = TypeVar("_AnswerT")


def ask_one(
    options: SimpleNamespace,
    question: Question[_AnswerT],
    show: Callable[[_AnswerT], tuple[Record, Iterable[str]]],
    stop: Trigger,
) -> _AnswerT | None:
    """Listen, ask one controller, show and return the answer; without ``--active`` say what it would be asked.

    Parameters
    ----------
    show
        Returns an answer as JSON, and as lines for people.
    stop
        Ends it early.

    Raises
    ------
    ConfigError, ExtraMissingError, SourceError, ControllerError
        If something cannot be used, or the controller does not answer or will not.
    StoppedError
        If it was stopped.
    """
    timing = timing_of(options)
    description = find_description(options.description)
    wanted = question.requests(description)
    target = _target(options, description)
    if not options.active:
        place = target if isinstance(target, DoipPlace) else target.bus
        tell_wish(options.command, wanted, heard(place, options.listen, lambda: not stop.is_set), is_json=options.json)
        return None
    with (
        ReadingLine() as line,
        asking(target, timing, goes_on=waiting(line, "waiting for the controller", stop)) as (tester, _),
    ):
        known = recognised(tester, description)
        answer = question.ask(tester, known)
        record, lines = show(answer)
        line.clear()
        head: Record = {"controller": tester.where, "description": known.name}
        more: Record = {"dialogue": dialogue_record(tester.counts)}
        write(outcome(options.command, is_asked=True, **head, **record, **more), lines, is_json=options.json)
        return answer


def waiting(line: ReadingLine, what: str, stop: Trigger) -> Callable[[], bool]:
    """Return what is called while answers are waited for: it tells whoever watches, and returns whether to go on."""
    began_s = time.monotonic()

    def goes_on() -> bool:
        line.tell(f"{what}, {time.monotonic() - began_s:.0f} s")
        return not stop.is_set

    return goes_on


def _target(options: SimpleNamespace, description: Description) -> BusTarget | DoipPlace:
    place = doip_place(options)
    if place is not None:
        return place
    return BusTarget(
        bus=bus_name(options),
        address=address_for(parse_address(options.ecu, options.reply, options.address), description),
        is_fd=options.fd,
        listen_s=options.listen,
    )


def tell_wish(schema: str, wanted: Sequence[str], traffic: Traffic | None, *, is_json: bool) -> None:
    """Say what was heard and what would be asked."""
    before: Record = {} if traffic is None else {"bus": traffic_record(traffic)}
    record = outcome(schema, is_asked=False, **before, would_ask=list(wanted))
    write(record, would_lines(traffic, wanted), is_json=is_json)


def write(record: Mapping[str, object], lines: Iterable[str], *, is_json: bool) -> None:
    """Show what was found: one JSON object, or lines for people."""
    if is_json:
        sys.stdout.write(dump(record) + "\n")
        return
    console = PeopleConsole()
    for line in lines:
        console.print(line)


def timing_of(options: SimpleNamespace) -> Timing:
    """Return how patient the tester is to be; raises ConfigError if a time cannot be."""
    check_time("--listen", options.listen, least_s=0.0)
    check_time("--timeout", options.timeout, least_s=SHORTEST_ANSWER_S)
    return Timing(p2_s=options.timeout)


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
    if getattr(options, "reply", None) is not None or getattr(options, "address", None) is not None:
        raise ConfigError("--reply and --address are of a bus, not of --doip")
    logical_address = hexadecimal(options.ecu, "--ecu", LARGEST_LOGICAL)
    return parse_doip(options.doip, logical_address, options.doip_authority)


def hex_bytes(text: str, what: str) -> bytes:
    """Return bytes that were written in hexadecimal, with or without blanks; raises ConfigError."""
    try:
        return bytes.fromhex(text)
    except ValueError as exc:
        raise ConfigError(f"{what} must be hexadecimal bytes such as '01 0A', got {text!r}") from exc
