"""What a command line says of a controller that answers testers."""

import pytest

from ecu_emulator.answering.answers import Answers, chosen
from ecu_emulator.arguments import COMMAND_LINE
from ecu_emulator.errors import ConfigError


def answers(*words: str) -> Answers | None:
    return chosen(COMMAND_LINE.parse(["run", *words]))


@pytest.mark.parametrize(
    "words",
    [
        ("--doip", "13400"), ("--elm327",), ("--diagnostic-memory", "tcu.json"),
        ("--doip-certificate", "node.crt"), ("--doip-key", "node.key"),
    ],
)  # fmt: skip
def test_nobody_is_there_to_answer_without_diagnostics(words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match=f"{words[0]} needs --diagnostics"):
        answers(*words)


def test_without_any_nobody_answers() -> None:
    assert answers() is None
    assert answers("--diagnostics", "--doip", "13400") == Answers(doip="13400")


def test_an_address_that_is_none_is_told_before_the_drive() -> None:
    with pytest.raises(ConfigError, match="x"):
        Answers(doip="x")
    with pytest.raises(ConfigError, match="--doip-certificate needs --doip"):
        answers("--diagnostics", "--doip-certificate", "node.crt")
