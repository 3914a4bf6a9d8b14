"""What the programs say before terminals, in pipes, in pipes that break and on a full disk."""

import re
from pathlib import Path

import pytest

from ecu_emulator.cli import main as emulator
from tests.support.in_process import ended
from tests.support.terminal import before_head, in_broken_pipe, in_terminal, on_full_disk

COMMANDS = (("diag_service", "inspect", "{log}"), ("diag_service", "analyze", "{log}"), ("ecu_emulator", "scenarios"))
FOLDER = ("diag_service", "analyze", "--jobs", "1", "{folder}")


def words(command: tuple[str, ...], log: Path) -> list[str]:
    return [word.format(log=log, folder=log.parent) for word in command]


@pytest.fixture(name="log", scope="session")
def _log(drive_log: Path) -> Path:
    """Return a log with a few shifts, alone in its folder."""
    return drive_log


@pytest.mark.parametrize(("command", "width"), [(COMMANDS[1], 60), (COMMANDS[2], 60)], ids=str)
def test_a_terminal_breaks_no_word_and_loses_none(
    log: Path, command: tuple[str, ...], width: int, capsys: pytest.CaptureFixture[str]
) -> None:
    module, *own = words(command, log)
    shown = in_terminal(width, module, *own)
    whole = ended(*own).out if module == "diag_service" else ""
    if module == "ecu_emulator":
        assert emulator(own) == 0
        whole = capsys.readouterr().out
    assert (shown.status, " ".join(shown.lines).split()) == (0, whole.split())
    assert [line for line in shown.lines if len(line) > width and len(line.split()) > 1] == []


@pytest.mark.parametrize("command", [COMMANDS[1], FOLDER], ids=" ".join)
def test_a_reader_who_hangs_up_is_no_error(log: Path, command: tuple[str, ...]) -> None:
    broken = in_broken_pipe(*words(command, log))
    assert (broken.status, re.findall(rb"Traceback|rror|ignored", broken.err)) == (0, [])


def test_head_gets_its_line(log: Path) -> None:
    told = before_head("diag_service", "inspect", log)
    assert (told.status, told.out.count(b"\n"), told.err) == (0, 1, b"")


@pytest.mark.parametrize("command", [COMMANDS[0], COMMANDS[2]], ids=" ".join)
def test_what_cannot_be_written_is_an_error(log: Path, command: tuple[str, ...]) -> None:
    told = on_full_disk(*words(command, log))
    assert told.status == 1
    assert re.fullmatch(rb"[a-z-]+: error: [^\n]*No space left on device[^\n]*\n", told.err)
