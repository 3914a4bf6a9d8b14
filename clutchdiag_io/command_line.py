"""What the command lines of all programs share, on click: files, groups of options, complaints in one line."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

DISTRIBUTION: Final = "clutchdiag"
# What annexes attach to the programs of the core, and with which extra it works: for those who did not install them.
BROUGHT_BY_ANNEXES: Final[Mapping[str, str]] = {
    **{f"diag-service {name}": "workshop[uds]" for name in ("did", "dtc", "routine", "scan", "try")},
    **{
        f"ecu-emulator run {name}": "workshop[diagnostics]"
        for name in ("--workshop", "--diagnostics", "--answers-like", "--doip", "--diagnostic-memory", "--elm327")
    },
}
SIMILAR_RATIO: Final = 0.8  # of two words: one letter in five is wrong
EXIT_USAGE: Final = 2
STANDARD_STREAM: Final = Path("-")  # standard input or output
CONTEXT: Final = {"help_option_names": ["-h", "--help"], "max_content_width": 120, "show_default": True}
FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])
RecordT = TypeVar("RecordT", bound="DataclassInstance")


class FileName(click.Path[Path]):
    """The name of a file; ``-`` alone stands for standard input or output, ``./-`` for a file of that name."""

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = super().convert(value, param, ctx)
        return path.absolute() if path == STANDARD_STREAM and os.fspath(value) != str(path) else path


FILE: Final = FileName(readable=False, path_type=Path)  # whether it can be read is found out by reading it


class FileOrStore(click.ParamType["Path | str"]):
    """The name of a file, or the address of something in a store, ``SCHEME://...``, which stays a text."""

    name = "place"

    def convert(
        self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> Path | str:
        return value if isinstance(value, str) and "://" in value else FILE.convert(value, param, ctx)


FILE_OR_STORE: Final = FileOrStore()


def together(*options: Callable[[FunctionT], FunctionT]) -> Callable[[FunctionT], FunctionT]:
    """Return options as one decorator; help shows them in this order."""

    def decorate(function: FunctionT) -> FunctionT:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


force_option = click.option("--force", is_flag=True, help="write over a file that is there already")


def examples(*lines: str) -> str:
    """Return the epilog of a command: whole command lines, which click does not wrap."""
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines)))


def record_of(kind: type[RecordT], words: Mapping[str, Any]) -> RecordT:
    """Return a record whose fields have the values of the command's words of the same names."""
    return kind(**{field.name: words[field.name] for field in fields(kind) if field.name in words})


def run(program: click.Group, words: Sequence[str] | None, state: object = None) -> int:
    """Run what a command line asks for and return the exit status; ``None`` is the command line of this process.

    What is wrong with the words is one line on standard error, and status 2. What a command raises passes.
    """
    name = program.name or ""
    try:
        return program.main(words, name, standalone_mode=False, obj=state) or 0
    except click.UsageError as exc:
        text = " ".join(_message(exc).split()).removesuffix(".")
        path = name if exc.ctx is None else exc.ctx.command_path
        sys.stderr.write(f"{name}: error: {text[:1].lower()}{text[1:]} (see {path} --help)\n")
    except click.ClickException as exc:
        sys.stderr.write(f"{name}: error: {exc.format_message()}\n")
    return EXIT_USAGE


def _message(error: click.UsageError) -> str:
    """Return what is wrong, without a value that the environment or a file set: it may be a misplaced secret."""
    if isinstance(error, click.exceptions.NoSuchCommand) and error.ctx is not None:
        return _unknown(error.ctx, "command", error.command_name)
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        return _unknown(error.ctx, "option", error.option_name)
    if not isinstance(error, click.BadParameter) or error.ctx is None or error.param is None:
        return error.format_message()
    name = error.param.name or ""
    source = error.ctx.get_parameter_source(name)
    if source not in {ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP}:
        return error.format_message()
    place = "the environment" if source is ParameterSource.ENVIRONMENT else "the settings file"
    return f"{name}: what {place} says is not a valid {error.param.type.name}"


def _unknown(context: click.Context, kind: str, word: str) -> str:
    """Return what to do about a word that is none of this command: install, correct it, or take another command."""
    if folder := BROUGHT_BY_ANNEXES.get(f"{context.command_path} {word}"):
        annex = folder.partition("[")[0]
        return f"{word} comes with the distribution {DISTRIBUTION}-{annex}: pip install './{folder}' in the checkout"
    text, command = f"no such {kind} {word!r}", context.command
    known = command.commands if isinstance(command, click.Group) and kind == "command" else _options(command)
    if near := get_close_matches(word, known, 1, SIMILAR_RATIO):
        return f"{text}; did you mean {near[0]!r}?"
    options: dict[str, list[str]] = {}
    for path, other in _commands(context.find_root().command):
        for option in _options(other) if kind == "option" else ():
            options.setdefault(option, []).append(path)
    near = get_close_matches(word, options, 1, SIMILAR_RATIO)
    if not near:
        return text
    first, *others = options[near[0]]
    places = " and ".join((first, *(others if len(others) < 2 else ("others",))))
    return f"{text}; it is one of {places}" if near[0] == word else f"{text}; did you mean {near[0]!r} of {places}?"


def _options(command: click.Command) -> list[str]:
    return [name for option in command.params if isinstance(option, click.Option) for name in option.opts]


def _commands(command: click.Command, path: str = "") -> Iterator[tuple[str, click.Command]]:
    """Yield all commands below one, each with the words behind the program's name."""
    for name, inner in command.commands.items() if isinstance(command, click.Group) else ():
        yield f"{path}{name}", inner
        yield from _commands(inner, f"{path}{name} ")
