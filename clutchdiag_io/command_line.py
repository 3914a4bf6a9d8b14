"""Command lines by click: complaints in one line, help with examples and exit statuses, completion by the shell.

A program parses first and works afterwards: ``Program.parse`` returns a namespace and calls nothing, so that signals,
exit statuses and the loading of libraries stay with the program.
"""

import os
import re
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

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
INT, FLOAT, Choice = click.INT, click.FLOAT, click.Choice


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
    execute :
        What it does, given by another distribution, which attaches the command to a program.
    """

    def __init__(
        self,
        name: str,
        text: str,
        *params: click.Parameter,
        examples: Sequence[str] = (),
        description: str = "",
        variables: str | None = None,
        execute: Callable[..., None] | None = None,
    ) -> None:
        super().__init__(
            name,
            params=list(params),
            help=description or text,
            short_help=text,
            context_settings={**_CONTEXT, "auto_envvar_prefix": variables},
        )
        self.examples = tuple(examples)
        self.execute = execute

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words; complain of an option where a value belongs, which click would take for the value."""
        options = {name: one for one in self.get_params(ctx) if isinstance(one, click.Option) for name in one.opts}
        end = args.index("--") if "--" in args else len(args)
        for word, following in pairwise([] if ctx.resilient_parsing else [*args[:end], "--"]):
            option = options.get(word)
            if isinstance(option, Option) and option.needs_value and _LOOKS_LIKE_OPTION.match(following):
                raise click.BadOptionUsage(word, f"Option {word!r} requires an argument.", ctx)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> SimpleNamespace:
        command = ctx.command_path.split()[1]
        given = {name for name in ctx.params if ctx.get_parameter_source(name) is click.ParameterSource.COMMANDLINE}
        return SimpleNamespace(**{"command": command, "action": self.name, "given": frozenset(given), **ctx.params})


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
            no_args_is_help=False,  # but a complaint
            context_settings=_CONTEXT,
        )

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order in which they were declared."""
        del ctx
        return list(self.commands)


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
            text = " ".join(exc.format_message().split()).removesuffix(".")
            sys.stderr.write(f"{name}: error: {text[:1].lower()}{text[1:]} (see {path} --help)\n")
            raise SystemExit(EXIT_USAGE) from None
        if isinstance(outcome, SimpleNamespace):
            return outcome
        raise SystemExit(outcome)
