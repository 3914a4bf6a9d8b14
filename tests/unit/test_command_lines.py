"""The command lines of all programs: every example in their help is understood, every command and option explained."""

import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from clutchdiag_io.command_line import run
from diag_service.cli import command_line as diag_service
from ecu_emulator.cli import command_line as ecu_emulator
from fleet_backend.cli import command_line as fleet_backend

PROGRAMS = {str(program.name): program for program in (diag_service, ecu_emulator, fleet_backend)}


def commands_of(group: click.Group) -> Iterator[click.Command]:
    for command in group.commands.values():
        if isinstance(command, click.Group):
            yield from commands_of(command)
        else:
            yield command


def examples_of(command: click.Command) -> list[str]:
    return [line.strip() for line in str(command.epilog).splitlines() if line.startswith("  ")]


EXAMPLES = [line for program in PROGRAMS.values() for command in commands_of(program) for line in examples_of(command)]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car1.toml").touch()


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_understood(example: str) -> None:
    (program, *words), *_ = (
        stage for one in example.split("|") if (stage := shlex.split(one.partition(">")[0]))[0] in PROGRAMS
    )
    command: click.Command = PROGRAMS[program]
    while isinstance(command, click.Group):
        command = command.commands[words.pop(0)]
    assert command.make_context(command.name, words).params


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_every_command_has_an_example_and_every_option_a_text(program: click.Group) -> None:
    for command in commands_of(program):
        assert examples_of(command), command.name
        for option in command.params:
            assert getattr(option, "help", None), (command.name, option.name)


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_the_exit_status_of_every_program_is_in_its_help(
    program: click.Group, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(program, ["--help"]) == 0
    assert "exit status: 0 " in capsys.readouterr().out
