"""Command lines by click: complaints in one line, help with examples and exit statuses, completion by the shell.

A program parses first and works afterwards: ``Program.parse`` returns a namespace and calls nothing, so that signals,
exit statuses and the loading of libraries stay with the program.
"""

import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, TypeVar

import click

DISTRIBUTION: Final = "clutchdiag"
EXIT_USAGE: Final = 2
STANDARD_STREAM: Final = Path("-")  # standard input or output
_LOOKS_LIKE_OPTION: Final = re.compile(r"-(?!\d*\.?\d+$)\S+$")  # neither a negative number does nor a sentence
_CONTEXT: Final = {"help_option_names": ["-h", "--help"], "max_content_width": 120}


class FileName(click.Path[Path]):
    """The name of a file; ``-`` alone stands for standard input or output, ``./-`` for a file of that name."""

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = super().convert(value, param, ctx)
        return path.absolute() if path == STANDARD_STREAM and os.fspath(value) != str(path) else path


FILE: Final = FileName(readable=False, path_type=Path)  # whether it can be read is found out by reading it


class FileOrStore(click.ParamType["Path | str"]):
    """The name of a file, or the address of something in a store, ``SCHEME://...``, which stays a text."""

    name = "path"

    def convert(
        self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> Path | str:
        return value if isinstance(value, str) and "://" in value else FILE.convert(value, param, ctx)


FILE_OR_STORE: Final = FileOrStore()
_Word = TypeVar("_Word", int, str)


class Number(click.ParamType[float]):
    """A number; what is none is told as ``invalid int value: 'x'``."""

    def __init__(self, kind: type[int] | type[float]) -> None:
        self.name = kind.__name__
        self._kind = kind

    def convert(self, value: str | float, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return self._kind(value)
        except ValueError:
            self.fail(f"invalid {self.name} value: {value!r}", param, ctx)


class Choice(click.Choice[_Word]):
    """One of a few words; another one is told as ``invalid choice``."""

    def get_invalid_choice_message(self, value: object, ctx: click.Context | None) -> str:
        del ctx
        return _invalid_choice(value, self.choices)


INT: Final = Number(int)
FLOAT: Final = Number(float)


class Option(click.Option):
    """An option, written as the help shows it: ``-b --bitrate BITRATE`` takes a value, ``--fd`` takes none.

    Parameters
    ----------
    words, text, kind :
        Names and what stands for the value, the help, and what the value is: a text if nothing is said.
    attributes :
        As click has them. With a ``flag_value`` the option may stand without its value, too.
    """

    can_be_set = False  # by a variable of the environment that bears its name

    def __init__(
        self,
        words: str,
        text: str,
        kind: click.ParamType[Any] | Callable[[str], object] | None = None,
        **attributes: Any,  # noqa: ANN401 - click's own, many of them
    ) -> None:
        names = [word for word in words.split() if word.startswith("-")]
        metavar = words.split()[len(names)] if len(names) < len(words.split()) else None
        attributes["allow_from_autoenv"] = self.can_be_set
        if "flag_value" in attributes:
            attributes["is_flag"] = False
        elif metavar is None and kind is None and not attributes.get("count"):
            attributes["is_flag"] = True
        super().__init__(names, type=kind, metavar=metavar, help=text, **attributes)
        self.needs_value = not (self.is_flag or self.count or "flag_value" in attributes)


FORCE: Final = Option("--force", "write over a file that is there already")


VERBOSE: Final = Option("-v --verbose", "print more; twice: of libraries, too", count=True)


class _Page(click.Command):
    """How the help of everything looks."""

    examples: tuple[str, ...] = ()

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the line that begins with ``usage:``."""
        formatter.write_usage(ctx.command_path, " ".join(self.collect_usage_pieces(ctx)), prefix="usage: ")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, and what the exit status of the program means."""
        if self.examples:
            with formatter.section("Examples"):
                formatter.write("".join(f"  {line}\n" for line in self.examples))
        formatter.write_paragraph()
        formatter.write_text(ctx.find_root().command.epilog or "")


class Command(_Page):
    """A command that, called, returns its words: ``command``, its options and ``given``, those of the command line.

    Of a command in a group ``command`` is the group and ``action`` the command.

    Parameters
    ----------
    text, description :
        What the program's help says of it, and what its own help says, if that is more.
    examples :
        Whole command lines, shown in the help.
    variables :
        Prefix, without ``_``, of the environment variables that stand for options that ``can_be_set``.
    """

    def __init__(
        self,
        name: str,
        text: str,
        *params: click.Parameter,
        examples: Sequence[str] = (),
        description: str = "",
        variables: str | None = None,
    ) -> None:
        super().__init__(
            name,
            params=list(params),
            help=description or text,
            short_help=text,
            context_settings={**_CONTEXT, "allow_extra_args": True, "auto_envvar_prefix": variables},
        )
        self.examples = tuple(examples)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words, of which an option may be abbreviated."""
        try:
            rest = super().parse_args(ctx, args if ctx.resilient_parsing else self._in_full(ctx, args))
            if rest and not ctx.resilient_parsing:
                ctx.fail(f"unrecognized arguments: {' '.join(rest)}")
        except click.UsageError as exc:
            exc.ctx = exc.ctx or ctx  # whose help is to be seen
            raise
        return rest

    def invoke(self, ctx: click.Context) -> SimpleNamespace:
        command = ctx.command_path.split()[1]
        given = {name for name in ctx.params if ctx.get_parameter_source(name) is click.ParameterSource.COMMANDLINE}
        return SimpleNamespace(**{"command": command, "action": self.name, "given": frozenset(given), **ctx.params})

    def _in_full(self, ctx: click.Context, words: Sequence[str]) -> list[str]:
        """Return the words with ``--veh`` as ``--vehicle``; complain of an option where a value belongs."""
        end = words.index("--") if "--" in words else len(words)
        options = {name: one for one in self.get_params(ctx) if isinstance(one, click.Option) for name in one.opts}
        full = [_unabbreviated(word, list(options)) for word in words[:end]]
        for word, following in pairwise([*full, "--"]):
            option = options.get(word)
            if isinstance(option, Option) and option.needs_value and _LOOKS_LIKE_OPTION.match(following):
                ctx.fail(f"argument {'/'.join(option.opts)}: expected one argument")
        return [*full, *words[end:]]


class Group(_Page, click.Group):
    """Commands under one word.

    Parameters
    ----------
    name, text :
        The word, and what the help says of it.
    metavar :
        What stands for a command in the help.
    """

    def __init__(self, name: str, text: str, *commands: click.Command, metavar: str = "COMMAND") -> None:
        super().__init__(
            name,
            commands=list(commands),
            help=text,
            short_help=text,
            subcommand_metavar=f"{metavar} ...",
            invoke_without_command=True,  # and say ourselves which word is missing
            callback=self._require_command,
            context_settings=_CONTEXT,
        )
        self.metavar = metavar

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order in which they were declared."""
        del ctx
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that the first word names."""
        if args[0] not in self.commands and not ctx.resilient_parsing:
            ctx.fail(f"argument {self.metavar}: {_invalid_choice(args[0], self.commands)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, each with its whole text."""
        with formatter.section("Commands"), formatter.indentation():
            formatter.write_dl([(name, self.commands[name].short_help or "") for name in self.list_commands(ctx)])

    def _require_command(self) -> None:
        ctx = click.get_current_context()
        if ctx.invoked_subcommand is None:
            ctx.fail(f"the following arguments are required: {self.metavar}")


class Program(Group):
    """A whole program, with ``--version`` and with what its exit status means."""

    def __init__(self, name: str, text: str, exit_text: str, *commands: click.Command) -> None:
        super().__init__(name, text, *commands)
        self.epilog = exit_text
        click.version_option(package_name=DISTRIBUTION, prog_name=name, message="%(prog)s %(version)s")(self)

    def parse(self, words: Sequence[str] | None) -> SimpleNamespace:
        """Return what a command line says; ``None`` stands for the command line of this process.

        Raises
        ------
        SystemExit
            After help, version, or the words that a shell may complete; and with status 2 after a complaint.
        """
        name = self.name or ""
        try:
            outcome = self.main(words, name, standalone_mode=False)
        except click.UsageError as exc:
            path = name if exc.ctx is None else exc.ctx.command_path
            text = " ".join(_complaint(exc).split()).removesuffix(".")
            sys.stderr.write(f"{name}: error: {text} (see {path} --help)\n")
            raise SystemExit(EXIT_USAGE) from None
        if isinstance(outcome, SimpleNamespace):
            return outcome
        raise SystemExit(outcome)


def _invalid_choice(word: object, choices: Iterable[object]) -> str:
    return f"invalid choice: {word!r} (choose from {', '.join(map(repr, choices))})"


def _complaint(exc: click.UsageError) -> str:
    """Return what is wrong, beginning with the option or the argument."""
    if isinstance(exc, click.BadParameter) and exc.param is not None:
        is_option = isinstance(exc.param, click.Option)
        name = "/".join(exc.param.opts) if is_option else exc.param.human_readable_name.rstrip(".")
        is_missing = isinstance(exc, click.MissingParameter)
        return f"the following arguments are required: {name}" if is_missing else f"argument {name}: {exc.message}"
    text = exc.format_message()
    if isinstance(exc, click.NoSuchOption):
        text = text.replace(exc.message, f"unrecognized arguments: {exc.option_name}.")
    return text[:1].lower() + text[1:]


def _unabbreviated(word: str, names: Sequence[str]) -> str:
    """Return a long option in full, if what there is of it is the beginning of one only."""
    begin, equals, value = word.partition("=")
    full = [name for name in names if name.startswith(begin)]
    return f"{full[0]}{equals}{value}" if begin.startswith("--") and begin not in names and len(full) == 1 else word
