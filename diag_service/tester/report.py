"""What a tester found, as JSON and as lines for people."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

from diag_service.tester.addresses import id_text
from diag_service.tester.asking import Traffic
from diag_service.tester.clearing import Clearing
from diag_service.tester.reading import DataAnswer, RoutineAnswer
from diag_service.tester.scanning import Found
from diag_service.tester.timing import DialogueCounts
from diag_service.tester.trouble_report import Record, code_words, columns, trouble_lines, values_text


def traffic_record(traffic: Traffic) -> Record:
    """Return what was heard before anything was asked."""
    return {
        "duration_s": traffic.duration_s,
        "frames": traffic.frame_count,
        "identifiers": len(traffic.can_ids),
        "error_frames": traffic.error_count,
        "other_testers": [id_text(can_id) for can_id in traffic.other_testers()],
    }


def data_record(answer: DataAnswer) -> Record:
    """Return what a controller said of one datum."""
    return {
        "number": f"{answer.number:04X}",
        "name": answer.name,
        "bytes": answer.data.hex(" ").upper(),
        "values": None if answer.values is None else dict(answer.values),
        "refusal": answer.refusal,
        "refusal_text": answer.refusal_text,
        "fault": answer.fault,
    }


def routine_record(answer: RoutineAnswer) -> Record:
    """Return what a controller said of a routine."""
    return {
        "number": f"{answer.number:04X}",
        "name": answer.name,
        "action": answer.action,
        "bytes": answer.data.hex(" ").upper(),
        "values": dict(answer.values),
    }


def cleared_record(cleared: Clearing) -> Record:
    """Return what was cleared, as JSON; nothing was if no group is there."""
    return {
        "groups": [f"{number:06X}" for number in cleared.groups],
        "before": [f"{code.number:06X}" for code in cleared.before],
        "gone": [f"{code.number:06X}" for code in cleared.gone],
        "left": [f"{code.number:06X}" for code in cleared.after],
    }


def cleared_lines(cleared: Clearing) -> Iterator[str]:
    """Yield what was cleared, and what is left."""
    if not cleared.groups:
        yield "nothing was cleared"
        return
    gone = ", ".join(map(code_words, cleared.gone)) or "no code that was told before"
    yield f"cleared {', '.join(f'{number:06X}' for number in cleared.groups)}: {gone}"
    yield "what is left:"
    yield from trouble_lines(cleared.after)


def found_record(found: Found) -> Record:
    """Return a controller and what it can be asked."""
    return {
        "where": found.where,
        "request_id": None if found.address is None else id_text(found.address.request_id),
        "response_id": None if found.address is None else id_text(found.address.response_id),
        "services": [
            {"number": f"{one.number:02X}", "name": one.name, "there": one.is_there, "remark": one.remark}
            for one in found.services
        ],
        "data": [data_record(one) for one in found.data],
        "trouble_codes": found.code_count,
    }


def dialogue_record(counts: DialogueCounts) -> Record:
    """Return what the dialogue went through."""
    return asdict(counts)


def data_lines(answers: Sequence[DataAnswer]) -> Iterator[str]:
    """Yield a line for each datum."""
    rows = [
        (f"{one.number:04X}", one.name, one.trouble if one.values is None else values_text(one.values))
        for one in answers
    ]
    yield from columns(("data", "name", "value"), rows)


def routine_lines(answer: RoutineAnswer) -> Iterator[str]:
    """Yield what a controller said of a routine."""
    name = f" {answer.name}" if answer.name else ""
    bytes_text = answer.data.hex(" ").upper() or "nothing more"
    yield f"routine {answer.number:04X}{name}, {answer.action}: {bytes_text}"
    if answer.values:
        yield f"  {values_text(answer.values)}"


def found_lines(controllers: Sequence[Found]) -> Iterator[str]:
    """Yield what was found."""
    yield f"{len(controllers)} controllers answer" if len(controllers) != 1 else "1 controller answers"
    for found in controllers:
        codes = "" if found.code_count is None else f", trouble codes: {found.code_count}"
        yield f"{found.where}{codes}"
        rows = [
            (
                f"{one.number:02X}",
                one.name,
                ("yes" if one.is_there else "no") + (f": {one.remark}" if one.remark else ""),
            )
            for one in found.services
        ]
        yield from (f"  {line}" for line in columns(("service", "name", "is there"), rows))
        yield from (f"  {line}" for line in data_lines(found.data) if found.data)


def would_lines(traffic: Traffic | None, wishes: Sequence[str]) -> Iterator[str]:
    """Yield what was heard, and what would be asked."""
    if traffic is not None:
        yield f"listened: {traffic}"
        if others := traffic.other_testers():
            yield f"another tester is at work: requests on {', '.join(map(id_text, others))}"
    yield "nothing was sent; with --active this would be asked:"
    yield from (f"  {wish}" for wish in wishes)


def outcome(schema: str, *, is_asked: bool, **more: object) -> Mapping[str, object]:
    """Return the JSON object of one command."""
    return {"schema": f"clutchdiag/{schema}/v1", "asked": is_asked, **more}
