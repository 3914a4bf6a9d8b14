"""``diag-service dtc``: the trouble codes of a controller, with what it kept of the failure; and to clear them."""

from collections.abc import Iterable, Sequence
from types import SimpleNamespace
from typing import Final

from diag_service.commands.asking import ask_one
from diag_service.console.question import is_confirmed
from diag_service.errors import ConfigError
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.clearing import Clearing, parse_group
from diag_service.tester.questions import LARGEST_SESSION, ClearQuestion, TroubleQuestion
from diag_service.tester.report import cleared_lines, cleared_record
from diag_service.tester.trouble import TroubleCode
from diag_service.tester.trouble_report import Record, code_words, trouble_lines, trouble_record

LARGEST_GROUP: Final = 0xFE  # of readiness, and of the records of extended data: FF is all


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read trouble codes and show them, or clear them and show what is left."""
    mask = 0 if options.all else hexadecimal(options.mask, "--mask", 0xFF)
    if options.clear is None:
        group, record = (
            None if text is None else hexadecimal(text, name, LARGEST_GROUP)
            for text, name in ((options.readiness, "--readiness"), (options.record, "--record"))
        )
        question = TroubleQuestion(mask=mask, has_details=not options.brief, group=group, record=record)
        ask_one(options, question, _shown, controls.stop)
    elif (options.readiness, options.record) != (None, None):
        raise ConfigError("--readiness and --record read trouble codes: they do not go with --clear")
    else:
        ask_one(options, _clear_question(options, controls, mask), _cleared, controls.stop)


def _clear_question(options: SimpleNamespace, controls: Controls, mask: int) -> ClearQuestion:
    session = hexadecimal(options.session, "--session", LARGEST_SESSION)
    group = parse_group(options.clear)

    def is_agreed(where: str, codes: Sequence[TroubleCode]) -> bool:
        told = ", ".join(map(code_words, codes)) or "no trouble codes"
        return is_confirmed(f"{where} tells {told}; clear {group.word}?", lambda: not controls.stop.is_set)

    return ClearQuestion(group=group, mask=mask, session=session, is_agreed=is_agreed)


def _shown(codes: Sequence[TroubleCode]) -> tuple[Record, Iterable[str]]:
    return {"codes": [trouble_record(code) for code in codes]}, trouble_lines(codes)


def _cleared(cleared: Clearing) -> tuple[Record, Iterable[str]]:
    codes = [trouble_record(code) for code in cleared.after]
    return {"codes": codes, "cleared": cleared_record(cleared)}, cleared_lines(cleared)
