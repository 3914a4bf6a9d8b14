"""``diag-service did``: data of a controller by identifier."""

from collections.abc import Iterable, Sequence
from types import SimpleNamespace

from diag_service.commands.asking import ask_one
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.questions import LARGEST_SESSION, DataQuestion
from diag_service.tester.reading import DataAnswer
from diag_service.tester.report import data_lines, data_record
from diag_service.tester.trouble_report import Record


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read data and show them; without names, all that the description has."""
    session = hexadecimal(options.session, "--session", LARGEST_SESSION)
    ask_one(options, DataQuestion(words=tuple(options.data), session=session), _shown, controls.stop)


def _shown(answers: Sequence[DataAnswer]) -> tuple[Record, Iterable[str]]:
    return {"data": [data_record(answer) for answer in answers]}, data_lines(answers)
