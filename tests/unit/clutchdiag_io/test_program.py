"""Programs: their words, their errors and their one thread."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

from clutchdiag_io.command_line import CONTEXT, FILE, record_of, run, together
from clutchdiag_io.program import complain

STATUSES = (((FileNotFoundError, KeyError), 2), (OSError, 3))


@pytest.mark.parametrize(
    ("exc", "status", "line"),
    [
        (FileNotFoundError("no log"), 2, "no log"),
        (PermissionError("not\n  for\tyou"), 3, "not for you"),
        (OSError("log\udce9.log"), 3, "log\\xe9.log"),
        (RuntimeError("wires\ncrossed"), 1, "unexpected RuntimeError: wires crossed (ask)"),
    ],
)
def test_an_error_is_one_line_and_a_status(
    exc: Exception, status: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert complain("oracle", exc, STATUSES, hint=" (ask)") == status
    assert capsys.readouterr() == ("", f"oracle: error: {line}\n")


COUNTED = """
import diag_service.cli, fleet_backend.cli, sys
assert "numpy" not in sys.modules
"""


def test_the_programs_say_so_before_numpy_is_loaded() -> None:
    subprocess.run([sys.executable, "-c", COUNTED], check=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    words: tuple[str, ...]
    output: Path
    pause: int | None = 0


@click.group("oracle", context_settings=CONTEXT, no_args_is_help=False)
def oracle() -> None:
    """Answer questions."""


@oracle.command()
@click.argument("words", nargs=-1, required=True, metavar="WORD...", help="what is asked")
@together(
    click.option("-o", "--output", metavar="FILE", type=FILE, required=True, help="where to"),
    click.option("--colour", type=click.Choice(["red", "blue"]), help="of the ink"),
)
@click.option("--column", metavar="COLUMN", type=float, help="where it begins")
@click.option("--pause", metavar="[S]", type=int, is_flag=False, flag_value=5, help="wait before it")
@click.pass_obj
def answer(heard: list[dict[str, Any]], /, **words: Any) -> None:  # noqa: ANN401 - of all kinds
    """Answer a question."""
    heard.append(words)
    if words["colour"] == "red":
        click.get_current_context().exit(3)


@oracle.group(no_args_is_help=False)
def well() -> None:
    """Look after the well."""


@well.command()
def clean() -> None:
    """Clean it."""


def said(*words: str) -> dict[str, Any]:
    heard: list[dict[str, Any]] = []
    assert run(oracle, ["answer", "why", "-o", "a.txt", *words], heard) == 0
    return heard[0]


def test_words_become_a_record() -> None:
    assert record_of(Question, said("not")) == Question(words=("why", "not"), output=Path("a.txt"), pause=None)


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (("--column", "-.5"), "column", -0.5),
        (("--pause",), "pause", 5),
        (("--pause", "--colour", "blue"), "pause", 5),
        (("--pause", "7"), "pause", 7),
        (("--", "--cou"), "words", ("why", "--cou")),
        (("-o", "-"), "output", Path("-")),
        (("-o", "./-"), "output", Path("-").absolute()),
    ],
)
def test_an_option_is_written_as_users_write_it(words: tuple[str, ...], name: str, value: object) -> None:
    assert said(*words)[name] == value


def test_a_command_says_with_which_status_it_ends() -> None:
    assert run(oracle, ["answer", "why", "-o", "a.txt", "--colour", "red"], []) == 3


@pytest.mark.parametrize(
    ("words", "text", "helper"),
    [
        ((), "missing command", "oracle"),
        (("well", "dig"), "no such command 'dig'", "oracle well"),
        (("well", "clean", "now", "then"), "got unexpected extra arguments (now then)", "oracle well clean"),
        (("answer",), "missing argument 'WORD...'", "oracle answer"),
        (
            ("answer", "-o", "a", "why", "--column", "x"),
            "invalid value for '--column': 'x' is not a valid float",
            "oracle answer",
        ),
        (("answer", "--puase"), "no such option '--puase'. Did you mean '--pause'?", "oracle answer"),
    ],
)
def test_a_complaint_is_one_line_that_names_the_help(
    words: tuple[str, ...], text: str, helper: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(oracle, words) == 2
    assert capsys.readouterr() == ("", f"oracle: error: {text} (see {helper} --help)\n")
