"""Programs: their words, their errors and their one thread."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

from clutchdiag_io.command_line import BROUGHT_BY_ANNEXES, CONTEXT, FILE, record_of, run, together
from clutchdiag_io.program import attached, complain

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
@click.option("--bucket", type=int, help="how many")
def clean(bucket: int | None) -> None:
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
        (("answer", "--puase"), "no such option '--puase'; did you mean '--pause'?", "oracle answer"),
        (("answr",), "no such command 'answr'; did you mean 'answer'?", "oracle"),
        (("answer", "--xyzzy"), "no such option '--xyzzy'", "oracle answer"),
        (("answer", "--bucket", "2"), "no such option '--bucket'; it is one of well clean", "oracle answer"),
        (
            ("well", "clean", "--colur"),
            "no such option '--colur'; did you mean '--colour' of answer?",
            "oracle well clean",
        ),
    ],
)
def test_a_complaint_is_one_line_that_names_the_help(
    words: tuple[str, ...], text: str, helper: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(oracle, words) == 2
    assert capsys.readouterr() == ("", f"oracle: error: {text} (see {helper} --help)\n")


@pytest.mark.parametrize("name", ["diag-service", "ecu-emulator"])
def test_a_command_of_an_annex_that_is_not_installed_says_what_brings_it(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    @click.group(name, context_settings=CONTEXT)
    def core() -> None:
        """Be a program without its annexes."""

    core.command("history")(lambda: None)
    core.command("run")(lambda: None)
    brought = [words.split()[1:] for words in BROUGHT_BY_ANNEXES if words.split()[0] == name]
    assert brought
    for words in brought:
        assert run(core, words) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"{name}: error: {words[-1]} comes with the distribution clutchdiag-workshop: ")
        assert "pip install './workshop[" in err


def test_what_annexes_bring_is_known_by_name() -> None:
    """The table that the core has for those who did not install an annex is what the annex attaches."""
    commands = {f"diag-service {name}" for name in attached("diag_service.commands")}
    function = click.command()(lambda: None)
    for option in attached("ecu_emulator.answers")["options"]:
        function = option(function)
    options = {f"ecu-emulator run {option.opts[0]}" for option in function.params}
    assert commands | options == set(BROUGHT_BY_ANNEXES)
