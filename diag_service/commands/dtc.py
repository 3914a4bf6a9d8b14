"""``diag-service dtc``: the trouble codes of a controller, with what it kept of the failure; and to clear them."""

from collections.abc import Sequence
from types import SimpleNamespace

from diag_service.commands.asking import Answer, Wish, ask_one
from diag_service.console.question import is_confirmed
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.answers import SESSION, request_text
from diag_service.tester.clearing import Group, clear_request, clear_troubles, parse_group
from diag_service.tester.description import Description
from diag_service.tester.dialogue import DEFAULT_SESSION, Dialogue
from diag_service.tester.reading import read_troubles, trouble_request
from diag_service.tester.report import cleared_lines, cleared_record
from diag_service.tester.trouble import TroubleCode
from diag_service.tester.trouble_report import (
    code_words,
    trouble_lines,
    trouble_record,
)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read trouble codes and show them, or clear them and show what is left."""
    mask = 0 if options.all else hexadecimal(options.mask, "--mask", 0xFF)
    if options.clear is None:
        _read(options, controls, mask)
    else:
        session = hexadecimal(options.session, "--session", 0x7F)
        _clear(options, controls, mask, parse_group(options.clear), session)


def _read(options: SimpleNamespace, controls: Controls, mask: int) -> None:
    def wish(_: Description) -> Wish:
        details = [] if options.brief else ["19 04 and 19 06: what was kept of each code"]
        return Wish(schema="dtc", requests=[f"{request_text(trouble_request(mask))}: the codes", *details])

    def use(tester: Dialogue, description: Description) -> Answer:
        codes = read_troubles(tester, description, mask, has_details=not options.brief)
        return {"codes": [trouble_record(code) for code in codes]}, trouble_lines(codes)

    ask_one(options, wish, use, controls.stop)


def _clear(options: SimpleNamespace, controls: Controls, mask: int, group: Group, session: int) -> None:
    def wish(_: Description) -> Wish:
        entering = [] if session == DEFAULT_SESSION else [request_text(bytes([SESSION, session]))]
        clearing = f"14: {group.word}" if group.number is None else request_text(clear_request(group.number))
        reading = request_text(trouble_request(mask))
        requests = [f"{reading}: the codes", *entering, f"{clearing}: clear", f"{reading}: what is left"]
        return Wish(schema="dtc", requests=requests)

    def use(tester: Dialogue, description: Description) -> Answer:
        def is_agreed(codes: Sequence[TroubleCode]) -> bool:
            told = ", ".join(map(code_words, codes)) or "no trouble codes"
            question = f"{tester.where} tells {told}; clear {group.word}?"
            return is_confirmed(question, lambda: not controls.stop.is_set)

        cleared = clear_troubles(tester, description, group, mask=mask, session=session, is_agreed=is_agreed)
        codes = [trouble_record(code) for code in cleared.after]
        return {"codes": codes, "cleared": cleared_record(cleared)}, cleared_lines(cleared)

    ask_one(options, wish, use, controls.stop)
