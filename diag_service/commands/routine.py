"""``diag-service routine``: start a routine of a controller, stop it, or ask for its results."""

from types import SimpleNamespace

from diag_service.commands.asking import Answer, Wish, ask_one, hex_bytes
from diag_service.errors import ConfigError
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.answers import ROUTINE, SECURITY, SESSION, request_text
from diag_service.tester.description import UNKNOWN, Description
from diag_service.tester.dialogue import DEFAULT_SESSION, Dialogue
from diag_service.tester.reading import ACTIONS, control_routine
from diag_service.tester.report import routine_lines, routine_record


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Do what was asked, in a session of its own and unlocked if need be."""
    session = hexadecimal(options.session, "--session", 0x7F)
    lock = None if options.unlock is None else _lock(options.unlock)
    given = hex_bytes(options.options, "--options")
    if given and options.action != "start":
        raise ConfigError("--options are for the start of a routine")

    def wish(description: Description) -> Wish:
        entering = [] if session == DEFAULT_SESSION else [request_text(bytes([SESSION, session]))]
        unlocking = [] if lock is None else [request_text(bytes([SECURITY, lock[0]])) + " and the key"]
        asked = bytes([ROUTINE, ACTIONS[options.action]])
        if description is UNKNOWN:
            question = f"{request_text(asked)}: {options.routine} {request_text(given)}".rstrip()
        else:
            number = description.find_routine(options.routine).to_bytes(2, "big")
            question = request_text(asked + number + given)
        return Wish(schema="routine", requests=[*entering, *unlocking, question])

    def use(tester: Dialogue, description: Description) -> Answer:
        number = description.find_routine(options.routine)
        with tester.session(session):
            if lock is not None:
                tester.unlock(*lock)
            answer = control_routine(tester, description, number, options.action, given)
        return {"routine": routine_record(answer)}, routine_lines(answer)

    ask_one(options, wish, use, controls.stop)


def _lock(text: str) -> tuple[int, bytes]:
    """Return the level and the mask that ``LEVEL=MASK`` names."""
    level, equals, mask = text.partition("=")
    number = hexadecimal(level, "--unlock LEVEL", 0x7E)
    if not equals or not mask or number % 2 == 0:
        raise ConfigError(f"--unlock must be LEVEL=MASK, an odd level and a mask in hexadecimal, got {text!r}")
    return number, hex_bytes(mask, "--unlock MASK")
