"""``diag-service routine``: start a routine of a controller, stop it, or ask for its results."""

from collections.abc import Iterable
from types import SimpleNamespace

from diag_service.commands.asking import ask_one, hex_bytes
from diag_service.errors import ConfigError
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.asking import SHORTEST_ANSWER_S, check_time
from diag_service.tester.questions import LARGEST_LEVEL, LARGEST_SESSION, Lock, RoutineQuestion
from diag_service.tester.reading import RoutineAnswer
from diag_service.tester.report import routine_lines, routine_record
from diag_service.tester.trouble_report import Record


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Do what was asked, in a session of its own and unlocked if need be."""
    check_time("--patience", options.patience, least_s=SHORTEST_ANSWER_S)
    question = RoutineQuestion(
        routine=options.routine,
        action=options.action,
        options=hex_bytes(options.options, "--options"),
        session=hexadecimal(options.session, "--session", LARGEST_SESSION),
        lock=None if options.unlock is None else _lock(options.unlock),
        patience_s=options.patience,
    )
    ask_one(options, question, _shown, controls.stop)


def _shown(answer: RoutineAnswer) -> tuple[Record, Iterable[str]]:
    return {"routine": routine_record(answer)}, routine_lines(answer)


def _lock(text: str) -> Lock:
    """Return the level and the mask that ``LEVEL=MASK`` names."""
    level, equals, mask = text.partition("=")
    number = hexadecimal(level, "--unlock LEVEL", LARGEST_LEVEL)
    if not equals or not mask or number % 2 == 0:
        raise ConfigError(f"--unlock must be LEVEL=MASK, an odd level and a mask in hexadecimal, got {text!r}")
    return Lock(level=number, mask=hex_bytes(mask, "--unlock MASK"))
