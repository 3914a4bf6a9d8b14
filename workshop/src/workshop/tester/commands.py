"""``diag-service dtc``, ``did``, ``routine`` and ``scan``: ask controllers and show the answers."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, TypeVar

import can

from diag_service.console import ReadingLine, is_confirmed, write_record
from diag_service.errors import ConfigError, ControllerError, StoppedError
from diag_service.settings.config import BusConfig
from diag_service.stopping import Controls, Trigger
from workshop.tester import questions, scanning
from workshop.tester.addresses import LARGEST_ID, hexadecimal, id_text, number_of
from workshop.tester.asking import LARGEST_LOGICAL, DoipPlace, listen_at
from workshop.tester.listening import HeardTraffic
from workshop.tester.trouble import (
    Record,
    TroubleCode,
    code_words,
    columns,
    trouble_lines,
    trouble_record,
    values_text,
)
from workshop.tester.uds_tester import UdsTester, place_of

MOST_NAMED: Final = 3  # missing data that an error names
_AnswerT = TypeVar("_AnswerT")


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedOptions:
    """Bus or node, and timeouts."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    fd: bool
    doip: str | None
    ecu: str | None
    reply: str | None = None
    address: str | None = None
    active: bool
    listen: float
    timeout: float
    json: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class OneControllerOptions(AskedOptions):
    """The same for one controller, with its description."""

    description: Path | None
    session: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleOptions(OneControllerOptions):
    """Options of ``dtc``."""

    mask: str
    has_all: bool
    brief: bool
    clear: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions(OneControllerOptions):
    """Options of ``did``."""

    data: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineOptions(OneControllerOptions):
    """Options of ``routine``."""

    routine: str
    action: str
    start_options: str
    unlock: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanOptions(AskedOptions):
    """Options of ``scan``."""

    first: str | None
    last: str | None
    extended: bool
    wait: float
    all_data: bool


def dtc(options: TroubleOptions, controls: Controls) -> None:
    """Read trouble codes, or clear them, and show them; raises ControllerError if details are missing."""
    mask = 0 if options.has_all else hexadecimal(options.mask, "--mask", 0xFF)
    if options.clear is None:
        question = questions.TroubleQuestion(mask=mask, has_details=not options.brief)

        def render(codes: Sequence[TroubleCode]) -> tuple[Record, Iterable[str]]:
            return {"codes": [trouble_record(code) for code in codes]}, trouble_lines(codes)

        codes = ask_one("dtc", options, question, render, controls.stop) or ()
        if faults := [code.fault for code in codes if code.fault]:
            raise ControllerError(f"what was kept of {len(faults)} of {len(codes)} codes was not told: {faults[0]}")
    else:
        ask_one(
            "dtc",
            options,
            _clear_question(options.clear, options.session, controls, mask),
            _shown_clearing,
            controls.stop,
        )


def _clear_question(word: str, session_text: str, controls: Controls, mask: int) -> questions.ClearQuestion:
    session = hexadecimal(session_text, "--session", questions.LARGEST_SESSION)
    group = questions.parse_group(word)

    def is_agreed(where: str, codes: Sequence[TroubleCode]) -> bool:
        listed = ", ".join(map(code_words, codes)) or "no trouble codes"
        return is_confirmed(f"{where} tells {listed}; clear {group.word}?", lambda: not controls.stop.is_set)

    return questions.ClearQuestion(group=group, mask=mask, session=session, is_agreed=is_agreed)


def _shown_clearing(cleared: questions.Clearing) -> tuple[Record, Iterable[str]]:
    """Return the cleared and remaining codes as JSON and lines."""
    numbers = {"before": cleared.before, "gone": cleared.gone, "left": cleared.after}
    hex_numbers: Record = {name: [f"{code.number:06X}" for code in codes] for name, codes in numbers.items()}
    groups = [f"{number:06X}" for number in cleared.groups]
    left = [trouble_record(code) for code in cleared.after]
    return {"codes": left, "cleared": {"groups": groups, **hex_numbers}}, cleared_lines(cleared)


def did(options: DataOptions, controls: Controls) -> None:
    """Read data and show them; raises ControllerError if some are missing."""
    session = hexadecimal(options.session, "--session", questions.LARGEST_SESSION)
    question = questions.DataQuestion(words=tuple(options.data), session=session)

    def render(answers: Sequence[questions.DataAnswer]) -> tuple[Record, Iterable[str]]:
        return {"data": [data_record(answer) for answer in answers]}, data_lines(answers)

    answers = ask_one("did", options, question, render, controls.stop) or ()
    missing = [answer for answer in answers if answer.values is None]
    if any(answer.fault for answer in missing) or (missing and (options.data or len(missing) == len(answers))):
        named = [f"{answer.number:04X}: {answer.trouble}" for answer in missing[:MOST_NAMED]]
        more = [f"and {len(missing) - MOST_NAMED} more"] if len(missing) > MOST_NAMED else []
        raise ControllerError(f"{len(missing)} of {len(answers)} data were not told: {'; '.join(named + more)}")


def routine(options: RoutineOptions, controls: Controls) -> None:
    """Start or stop a routine, or read its results, and show the answer."""
    question = questions.RoutineQuestion(
        routine=options.routine,
        action=options.action,
        options=hex_bytes(options.start_options, "--options"),
        session=hexadecimal(options.session, "--session", questions.LARGEST_SESSION),
        lock=None if options.unlock is None else _lock(options.unlock),
    )
    ask_one(
        "routine",
        options,
        question,
        lambda answer: ({"routine": routine_record(answer)}, routine_lines(answer)),
        controls.stop,
    )


def _lock(text: str) -> questions.Lock:
    """Return the level and the mask that ``LEVEL=MASK`` names."""
    level, equals, mask = text.partition("=")
    number = hexadecimal(level, "--unlock LEVEL", questions.LARGEST_LEVEL)
    if not equals or not mask or number % 2 == 0:
        raise ConfigError(f"--unlock must be LEVEL=MASK, an odd level and a mask in hexadecimal, got {text!r}")
    return questions.Lock(level=number, mask=hex_bytes(mask, "--unlock MASK"))


def scan(options: ScanOptions, controls: Controls) -> None:
    """Scan and show the controllers; raises StoppedError if it was stopped."""
    plan = scanning.ScanPlan(
        place=_place(options),
        first=number_of(options.first, "--first", LARGEST_ID),
        last=number_of(options.last, "--last", LARGEST_ID),
        is_extended=options.extended,
        has_all_data=options.all_data,
        is_fd=options.fd,
        listen_s=options.listen,
        timeout_s=options.timeout,
        wait_s=options.wait,
    )
    stop = controls.stop
    if not options.active:
        show_requests(
            "scan", plan.requests, listen_at(plan.place, plan.listen_s, lambda: not stop.is_set), is_json=options.json
        )
    else:
        count = len(plan.request_ids)
        text = f"asking {count} identifiers, which takes {count * plan.wait_s:.0f} s or more" if count else "asking"
        with ReadingLine() as line:
            result = scanning.scan(plan, goes_on=waiting(line, text, stop))
        traffic = {} if result.traffic is None else {"bus": traffic_record(result.traffic)}
        record = outcome(
            "scan",
            is_asked=True,
            **traffic,
            controllers=[controller_record(controller) for controller in result.controllers],
        )
        write_record(record, controller_lines(result.controllers), as_json=options.json)
    if stop.is_set:
        raise StoppedError("stopped early: what was shown is a part of what is there")


def _place(options: AskedOptions) -> BusConfig | can.BusABC | DoipPlace:
    ecu = None if options.doip is None else number_of(options.ecu, "--ecu", LARGEST_LOGICAL)
    return place_of(
        None, options.interface, options.channel, options.bitrate, options.doip, ecu,
        is_fd=options.fd,
    )  # fmt: skip


def ask_one(
    command: str,
    options: OneControllerOptions,
    question: questions.Question[_AnswerT],
    render: Callable[[_AnswerT], tuple[Record, Iterable[str]]],
    stop: Trigger,
) -> _AnswerT | None:
    """Listen, ask one controller, show and return the answer; without ``--active`` show the requests only.

    Raises ConfigError, ExtraMissingError, SourceError, ControllerError if something is invalid or missing, or the
    controller refuses or does not answer, StoppedError if it was stopped.

    Parameters
    ----------
    command
        Name, part of the schema of the outcome.
    render
        Returns an answer as JSON, and as lines for people.
    stop
        Ends it early.
    """
    tester = UdsTester(
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        doip=options.doip,
        ecu=number_of(options.ecu, "--ecu", LARGEST_ID if options.doip is None else LARGEST_LOGICAL),
        reply=number_of(options.reply, "--reply", LARGEST_ID),
        address=number_of(options.address, "--address", 0xFF),
        description=options.description,
        is_active=options.active,
        listen_s=options.listen,
        timeout_s=options.timeout,
    )
    requests = question.requests(tester.described)
    tester.goes_on = lambda: not stop.is_set
    if not options.active:
        with tester:
            show_requests(command, requests, tester.traffic, is_json=options.json)
        return None
    with ReadingLine() as line:
        tester.goes_on = waiting(line, "waiting for the controller", stop)
        with tester:
            answer = tester.ask(question)
            record, lines = render(answer)
            line.clear()
            head: Record = {"controller": tester.controller, "description": tester.description}
            more: Record = {"dialogue": asdict(tester.counts)}
            write_record(outcome(command, is_asked=True, **head, **record, **more), lines, as_json=options.json)
            return answer


def waiting(line: ReadingLine, what: str, stop: Trigger) -> Callable[[], bool]:
    """Return a function for waits: it shows the elapsed time and returns whether to go on."""
    began_s = time.monotonic()

    def goes_on() -> bool:
        line.tell(f"{what}, {time.monotonic() - began_s:.0f} s")
        return not stop.is_set

    return goes_on


def show_requests(schema: str, requests: Sequence[str], traffic: HeardTraffic | None, *, is_json: bool) -> None:
    """Show the traffic and the requests that would be sent."""
    before: Record = {} if traffic is None else {"bus": traffic_record(traffic)}
    record = outcome(schema, is_asked=False, **before, would_ask=list(requests))
    write_record(record, request_lines(traffic, requests), as_json=is_json)


def hex_bytes(text: str, what: str) -> bytes:
    """Return bytes that were written in hexadecimal, with or without blanks; raises ConfigError."""
    try:
        return bytes.fromhex(text)
    except ValueError as exc:
        raise ConfigError(f"{what} must be hexadecimal bytes such as '01 0A', got {text!r}") from exc


def traffic_record(traffic: HeardTraffic) -> Record:
    """Return the traffic before the first request as JSON."""
    return {
        "duration_s": traffic.duration_s,
        "frames": traffic.frame_count,
        "identifiers": len(traffic.can_ids),
        "error_frames": traffic.error_count,
        "other_testers": [id_text(can_id) for can_id in traffic.other_testers()],
    }


def data_record(answer: questions.DataAnswer) -> Record:
    """Return one datum as JSON."""
    return {
        "number": f"{answer.number:04X}",
        "name": answer.name,
        "bytes": answer.data.hex(" ").upper(),
        "values": None if answer.values is None else dict(answer.values),
        "refusal": answer.refusal,
        "refusal_text": answer.refusal_text,
        "fault": answer.fault,
    }


def routine_record(answer: questions.RoutineAnswer) -> Record:
    return {
        "number": f"{answer.number:04X}",
        "name": answer.name,
        "action": answer.action,
        "bytes": answer.data.hex(" ").upper(),
        "values": dict(answer.values),
    }


def cleared_lines(cleared: questions.Clearing) -> Iterator[str]:
    if not cleared.groups:
        yield "nothing was cleared"
        return
    gone = ", ".join(map(code_words, cleared.gone)) or "no code that was told before"
    yield f"cleared {', '.join(f'{number:06X}' for number in cleared.groups)}: {gone}"
    yield "what is left:"
    yield from trouble_lines(cleared.after)


def controller_record(controller: scanning.FoundController) -> Record:
    """Return a controller as JSON."""
    return {
        "where": controller.where,
        "request_id": None if controller.address is None else id_text(controller.address.request_id),
        "response_id": None if controller.address is None else id_text(controller.address.response_id),
        "services": [
            {
                "number": f"{service.number:02X}",
                "name": service.name,
                "there": service.is_there,
                "remark": service.remark,
            }
            for service in controller.services
        ],
        "data": [data_record(answer) for answer in controller.data],
        "trouble_codes": controller.code_count,
    }


def data_lines(answers: Sequence[questions.DataAnswer]) -> Iterator[str]:
    rows = [
        (f"{answer.number:04X}", answer.name, answer.trouble if answer.values is None else values_text(answer.values))
        for answer in answers
    ]
    yield from columns(("data", "name", "value"), rows)


def routine_lines(answer: questions.RoutineAnswer) -> Iterator[str]:
    name = f" {answer.name}" if answer.name else ""
    bytes_text = answer.data.hex(" ").upper() or "nothing more"
    yield f"routine {answer.number:04X}{name}, {answer.action}: {bytes_text}"
    if answer.values:
        yield f"  {values_text(answer.values)}"


def controller_lines(controllers: Sequence[scanning.FoundController]) -> Iterator[str]:
    yield f"{len(controllers)} controllers answer" if len(controllers) != 1 else "1 controller answers"
    for controller in controllers:
        codes = "" if controller.code_count is None else f", trouble codes: {controller.code_count}"
        yield f"{controller.where}{codes}"
        rows = [
            (
                f"{service.number:02X}",
                service.name,
                ("yes" if service.is_there else "no") + (f": {service.remark}" if service.remark else ""),
            )
            for service in controller.services
        ]
        yield from (f"  {line}" for line in columns(("service", "name", "is there"), rows))
        yield from (f"  {line}" for line in data_lines(controller.data) if controller.data)


def request_lines(traffic: HeardTraffic | None, requests: Sequence[str]) -> Iterator[str]:
    """Yield the traffic and the requests that would be sent."""
    if traffic is not None:
        yield f"listened: {traffic}"
        if others := traffic.other_testers():
            yield f"another tester is at work: requests on {', '.join(map(id_text, others))}"
    yield "nothing was sent; with --active this would be asked:"
    yield from (f"  {request}" for request in requests)


def outcome(schema: str, *, is_asked: bool, **more: object) -> Mapping[str, object]:
    return {"schema": f"clutchdiag/{schema}/v1", "asked": is_asked, **more}
