"""``diag-service did``: data of a controller by identifier."""

from types import SimpleNamespace

from diag_service.commands.asking import Answer, Wish, ask_one
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.answers import READ_DATA, SESSION, request_text
from diag_service.tester.description import UNKNOWN, Description
from diag_service.tester.dialogue import DEFAULT_SESSION, Dialogue
from diag_service.tester.reading import read_data
from diag_service.tester.report import data_lines, data_record


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read data and show them; without names, all that the description has."""
    session = hexadecimal(options.session, "--session", 0x7F)

    def numbers(description: Description) -> list[int]:
        return [description.find_data(word) for word in options.data] or sorted(description.data)

    def wish(description: Description) -> Wish:
        entering = [] if session == DEFAULT_SESSION else [request_text(bytes([SESSION, session]))]
        if options.data and description is UNKNOWN:
            return Wish(schema="did", requests=[*entering, *(f"22: {word}" for word in options.data)])
        questions = [request_text(bytes([READ_DATA]) + one.to_bytes(2, "big")) for one in numbers(description)]
        return Wish(schema="did", requests=[*entering, *questions])

    def use(tester: Dialogue, description: Description) -> Answer:
        with tester.session(session):
            answers = read_data(tester, description, numbers(description))
        return {"data": [data_record(answer) for answer in answers]}, data_lines(answers)

    ask_one(options, wish, use, controls.stop)
