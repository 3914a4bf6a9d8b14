"""The command lines of all programs: every example in their help is understood, every command and option explained."""

import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from clutchdiag_io.command_line import Command, Program
from diag_service.commands.arguments import COMMAND_LINE as DIAG_SERVICE
from ecu_emulator.arguments import COMMAND_LINE as ECU_EMULATOR
from fleet_backend.arguments import COMMAND_LINE as FLEET_BACKEND

PROGRAMS = {str(program.name): program for program in (DIAG_SERVICE, ECU_EMULATOR, FLEET_BACKEND)}


def commands_of(group: click.Group) -> Iterator[Command]:
    for command in group.commands.values():
        if isinstance(command, click.Group):
            yield from commands_of(command)
        else:
            assert isinstance(command, Command)
            yield command


EXAMPLES = [
    example for program in PROGRAMS.values() for command in commands_of(program) for example in command.examples
]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car1.toml").touch()


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_understood(example: str) -> None:
    (program, *words), *_ = (
        stage for one in example.split("|") if (stage := shlex.split(one.partition(">")[0]))[0] in PROGRAMS
    )
    assert PROGRAMS[program].parse(words).command == words[0]


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_every_command_has_an_example_and_every_option_a_text(program: Program) -> None:
    for command in commands_of(program):
        assert command.examples, command.name
        for option in command.params:
            assert getattr(option, "help", None), (command.name, option.name)


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_the_exit_status_of_every_program_is_in_its_help(program: Program, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        program.parse(["--help"])
    assert ended.value.code == 0
    assert "exit status: 0 " in capsys.readouterr().out
