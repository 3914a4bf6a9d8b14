"""``diag-service did``: data of a controller by identifier."""

from collections.abc import Iterable, Sequence
from types import SimpleNamespace
from typing import Final

from diag_service.commands.asking import ask_one
from diag_service.errors import ControllerError
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.questions import LARGEST_SESSION, DataQuestion
from diag_service.tester.reading import DataAnswer
from diag_service.tester.report import data_lines, data_record
from diag_service.tester.trouble_report import Record

MOST_NAMED: Final = 3  # in the line that says what was not told


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read data and show them; without names, all that the description has. ControllerError: not all was told."""
    session = hexadecimal(options.session, "--session", LARGEST_SESSION)
    answers = ask_one(options, DataQuestion(words=tuple(options.data), session=session), _shown, controls.stop) or ()
    missing = [one for one in answers if one.values is None]
    if any(one.fault for one in missing) or (missing and (options.data or len(missing) == len(answers))):
        named = [f"{one.number:04X}: {one.trouble}" for one in missing[:MOST_NAMED]]
        more = [f"and {len(missing) - MOST_NAMED} more"] if len(missing) > MOST_NAMED else []
        raise ControllerError(f"{len(missing)} of {len(answers)} data were not told: {'; '.join(named + more)}")


def _shown(answers: Sequence[DataAnswer]) -> tuple[Record, Iterable[str]]:
    return {"data": [data_record(answer) for answer in answers]}, data_lines(answers)
