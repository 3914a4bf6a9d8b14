"""Command line and Python offer the same: both are held against the tables of docs/python.md, option by option."""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, get_args, is_typeddict

import click
import pytest

import diag_service
import ecu_emulator
from clutchdiag_io.command_line import Program
from diag_service.commands.arguments import COMMAND_LINE as DIAG_SERVICE
from ecu_emulator.arguments import COMMAND_LINE as ECU_EMULATOR
from tests.support.documents import page_text

SECTION = page_text("docs/python.md").partition("## Command by command\n")[2].partition("\n## ")[0]
SPAN = re.compile(r"`([^`]+)`")
OPTION = re.compile(r"--[a-z0-9-]+$|\[?[A-Z]{3,}[\]A-Z.|]*$")
PACKAGES = {"diag-service": diag_service, "ecu-emulator": ecu_emulator}
CHOICES = {"Delivery", "Poll", "Answers"}  # that stand for an argument called like them


def table(head: str) -> list[tuple[str, str]]:
    """Return the rows of the table whose head begins with this word."""
    text = SECTION.partition(f"\n| {head} |")[2].partition("\n\n")[0]
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines()[2:]]
    assert len(rows) >= 2, head
    return [(left.strip().replace("\\|", "|"), right.strip()) for left, right in rows]


def spans(cell: str) -> list[str]:
    return SPAN.findall(cell)


def parameters_of(function: Callable[..., Any]) -> set[str]:
    """Return the names that a function takes, those of its record of options too."""
    found = inspect.signature(function).parameters
    options = [key for one in found.values() for kind in get_args(one.annotation) for key in options_in(kind)]
    return {one.name for one in found.values() if one.kind is not one.VAR_KEYWORD and one.name != "self"} | set(options)


def options_in(kind: object) -> Iterable[str]:
    return kind.__annotations__ if is_typeddict(kind) else ()


@dataclass(frozen=True, slots=True)
class Offer:
    """What Python has for a command."""

    package: ModuleType
    functions: dict[str, Callable[..., Any]]

    @property
    def parameters(self) -> set[str]:
        return {name for function in self.functions.values() for name in parameters_of(function)}

    def has(self, word: str) -> bool:
        """Return whether a word of the second column is something that belongs to these functions."""
        root, _, member = word.partition(".")
        if root in CHOICES:
            return root.lower() in self.parameters and (not member or is_member(getattr(self.package, root), member))
        if member:
            return root in self.functions and is_member(self.functions[root], member)
        return word in self.parameters or word in self.functions


def is_member(kind: object, name: str) -> bool:
    return hasattr(kind, name)


@cache
def offers() -> dict[str, Offer]:
    """Return what Python has for each command, by the program and the command."""
    found = {}
    for left, right in table("command"):
        for command in spans(left):
            package = PACKAGES[command.split()[0]]
            functions: dict[str, Callable[..., Any]] = {}
            for name in spans(right.partition(";")[0]):
                owner = package if name in package.__all__ else next(iter(functions.values()))
                functions[name] = getattr(owner, name)
            found[command] = Offer(package, functions)
    return found


@cache
def arguments() -> dict[str, list[str]]:
    """Return what may stand for each option."""
    found: dict[str, list[str]] = {}
    for left, right in table("options"):
        options = [span for span in spans(left) if OPTION.match(span)]
        words = spans(right)
        assert len(options) == len(words), left
        for option, word in zip(options, words, strict=True):
            found.setdefault(option, []).append(word)
    return found


def words_for(option: str) -> list[str]:
    """Return what may stand for an option: what the table says, or by the page's rule its own name."""
    name = option.removeprefix("--").replace("-", "_")
    return [*arguments().get(option, []), name, f"is_{name}"]


def at_a_terminal() -> set[str]:
    return {span for left, _ in table("only at a terminal") for span in spans(left)}


def commands(program: Program) -> Iterator[tuple[str, click.Command]]:
    """Yield every command of a program, those in groups as well, with its whole name."""

    def walk(group: click.Group, name: str) -> Iterator[tuple[str, click.Command]]:
        for word, command in group.commands.items():
            if isinstance(command, click.Group):
                yield from walk(command, f"{name} {word}")
            else:
                yield f"{name} {word}", command

    return walk(program, str(program.name))


def options_of(command: click.Command) -> list[str]:
    """Return the long names of its options, and how its arguments are called in its help."""
    return [
        max(param.opts, key=len) if isinstance(param, click.Option) else param.make_metavar(click.Context(command))
        for param in command.params
    ]


ALL = [(name, command) for program in (DIAG_SERVICE, ECU_EMULATOR) for name, command in commands(program)]


@pytest.mark.parametrize(("name", "command"), ALL, ids=[name for name, _ in ALL])
def test_every_option_is_an_argument_or_belongs_to_a_terminal(name: str, command: click.Command) -> None:
    if name in at_a_terminal():
        return
    offer = offers()[name]
    missing = [
        option
        for option in options_of(command)
        if option not in at_a_terminal() and not any(offer.has(word) for word in words_for(option))
    ]
    assert missing == [], f"docs/python.md has nothing of {name} for these options"


def test_every_argument_is_an_option_or_belongs_to_python() -> None:
    own = {span for left, _ in table("only in Python") for span in spans(left)}
    reached: dict[Callable[..., Any], set[str]] = {}
    for name, command in ALL:
        if name not in at_a_terminal():
            words = {word.partition(".")[0] for option in options_of(command) for word in words_for(option)}
            for function in offers()[name].functions.values():
                reached.setdefault(function, set()).update(one.lower() if one in CHOICES else one for one in words)
    for function, words in reached.items():
        assert parameters_of(function) - words - own == set(), function


def test_the_tables_name_nothing_that_is_not_there() -> None:
    known = {option for _, command in ALL for option in options_of(command)}
    assert set(arguments()) - known == set()
    assert at_a_terminal() - known - {name for name, _ in ALL} == set()
    assert set(offers()) <= {name for name, _ in ALL}
    words = {word for found in arguments().values() for word in found}
    unknown = [word for word in words if not any(offer.has(word) for offer in offers().values())]
    assert unknown == []
