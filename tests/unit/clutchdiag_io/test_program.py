"""Programs: their words, their errors and their one thread."""

import subprocess
import sys
from types import SimpleNamespace

import click
import pytest

from clutchdiag_io.command_line import FILE, FLOAT, INT, VERBOSE, Choice, Command, Group, Option, Program
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


ANSWER = Command(
    "answer",
    "answer a question",
    click.Argument(["words"], nargs=-1, required=True, metavar="WORD...", help="what is asked"),
    Option("-o --output FILE", "where to", FILE, required=True),
    Option("-n --count COUNT", "how often", INT, default=1),
    Option("--colour", "of the ink", Choice(["red", "blue"])),
    Option("--column COLUMN", "where it begins", FLOAT),
    Option("--pause [S]", "wait before it", INT, flag_value=5),
    Option("--note NOTE", "to be remembered"),
    Option("--loud", "in capitals"),
    VERBOSE,
    examples=("oracle answer why -o answer.txt",),
)
ORACLE = Program(
    "oracle",
    "Answers questions.",
    "exit status: 0 answered",
    ANSWER,
    Group("well", "look after the well", Command("clean", "clean it", VERBOSE), metavar="ACTION"),
)


def said(*words: str) -> SimpleNamespace:
    return ORACLE.parse(["answer", "why", "-o", "a.txt", *words])


def test_words_become_values_and_what_was_given_is_known() -> None:
    options = said("--count", "-3", "--loud", "-vv", "not")
    assert (options.command, options.words, str(options.output)) == ("answer", ("why", "not"), "a.txt")
    assert (options.count, options.loud, options.verbose, options.colour) == (-3, True, 2, None)
    assert options.given == {"words", "output", "count", "loud", "verbose"}
    assert ORACLE.parse(["well", "clean"]).command == "well"


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (("-n2",), "count", 2),
        (("--column", "-.5"), "column", -0.5),
        (("--pause",), "pause", 5),
        (("--pause", "--loud"), "pause", 5),
        (("--pause", "7"), "pause", 7),
        (("--", "--cou"), "words", ("why", "--cou")),
        (("--note", "-5 degrees outside"), "note", "-5 degrees outside"),
        (("-o", "-"), "output", FILE.coerce_path_result("-")),
        (("-o", "--", "-x"), None, None),
        (("--output=--loud",), "output", FILE.coerce_path_result("--loud")),
    ],
)
def test_an_option_is_written_as_users_write_it(words: tuple[str, ...], name: str | None, value: object) -> None:
    if name is None:
        with pytest.raises(SystemExit):
            said(*words)
        return
    assert getattr(said(*words), name) == value


@pytest.mark.parametrize(
    ("words", "text", "helper"),
    [
        ((), "missing command", "oracle"),
        (("well", "dig"), "no such command 'dig'", "oracle well"),
        (("well", "clean", "now", "then"), "got unexpected extra arguments (now then)", "oracle well clean"),
        (("answer",), "missing argument 'WORD...'", "oracle answer"),
        (("answer", "why", "-o", "--loud"), "option '-o' requires an argument", "oracle answer"),
        (("answer", "why", "--output", "-v"), "option '--output' requires an argument", "oracle answer"),
        (
            ("answer", "-o", "a", "why", "--column", "x"),
            "invalid value for '--column': 'x' is not a valid float",
            "oracle answer",
        ),
        (("answer", "--verbsoe"), "no such option '--verbsoe'. Did you mean '--verbose'?", "oracle answer"),
    ],
)
def test_a_complaint_is_one_line_that_names_the_help(
    words: tuple[str, ...], text: str, helper: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        ORACLE.parse(words)
    assert ended.value.code == 2
    assert capsys.readouterr() == ("", f"oracle: error: {text} (see {helper} --help)\n")


@pytest.mark.parametrize(
    ("line", "place", "offered"),
    [
        ("oracle ", 1, {"answer", "well"}),
        ("oracle well ", 2, {"clean"}),
        ("oracle answer --co", 2, {"--count", "--colour", "--column"}),
        ("oracle answer --colour ", 3, {"red", "blue"}),
    ],
)
def test_a_shell_completes_words(
    line: str, place: int, offered: set[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_ORACLE_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(place))
    with pytest.raises(SystemExit) as ended:
        ORACLE.parse([])
    assert ended.value.code == 0
    assert {one.partition(",")[2] for one in capsys.readouterr().out.split()} == offered
