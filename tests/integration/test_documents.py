"""What the documents show exists: programs, commands, options, modules, make targets and variables."""

import importlib
import importlib.util
import io
import re
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import pytest

from tests.support.documents import MODULES, PAGES, ROOT, Shown, all_commands, page_text

OPTION = re.compile(r"(?<![\w-])--?[a-z][a-z-]*")
PROGRAM_COMMANDS = [one for one in all_commands() if one.line.split()[0] in MODULES and len(one.line.split()) > 1]
MODULE_COMMANDS = [one for one in all_commands() if re.search(r"(^|-- )python -m ", one.line)]


GROUPS = {"config", "lake", "cluster"}  # whose commands have options, not they


def options_in(words: list[str]) -> set[str]:
    """Return the options of a command line, without what is handed on behind ``--`` or to the shell."""
    own = words[: next((row for row, word in enumerate(words) if word in {"--", "&", "|", ">"}), len(words))]
    return {word.partition("=")[0] for word in own if OPTION.fullmatch(word.partition("=")[0])}


@cache
def help_text(*words: str) -> str:
    module, *inner = words
    out = io.StringIO()
    with redirect_stdout(out):
        importlib.import_module(f"{module}.cli").main([*inner, "--help"])
    return out.getvalue()


@cache
def subcommands(module: str) -> frozenset[str]:
    """Return the commands that a program's help lists."""
    return frozenset(re.findall(r"^ {2,4}([a-z][a-z-]*)(?= {2,}|$)", help_text(module), re.MULTILINE))


@pytest.mark.parametrize("shown", PROGRAM_COMMANDS, ids=lambda shown: shown.line)
def test_a_shown_command_is_understood(shown: Shown) -> None:
    program, command, *arguments = shown.line.split()
    module = MODULES[program]
    if command.startswith("-"):
        assert options_in([command, *arguments]) <= set(OPTION.findall(help_text(module)))
        return
    assert command in subcommands(module)
    inner = arguments[:1] if command in GROUPS else []
    known = set(OPTION.findall(help_text(module, command, *inner)))
    assert options_in(arguments) <= known, shown.page


@pytest.mark.parametrize("shown", MODULE_COMMANDS, ids=lambda shown: shown.line)
def test_a_shown_module_exists_and_knows_its_options(shown: Shown) -> None:
    for part in re.findall(r"python -m (.*?)(?= -- |$)", shown.line):
        module, *arguments = part.split()
        found = importlib.util.find_spec(module)
        assert found is not None, f"{shown.page}: {module}"
        assert found.origin is not None
        folder = Path(found.origin).parent if found.submodule_search_locations else None
        sources = sorted(folder.glob("*.py")) if folder else [Path(found.origin)]
        sources += [ROOT / "studies/run.py"] if module.startswith("studies.") else []  # what all of them take
        text = "".join(source.read_text(encoding="utf-8") for source in sources)
        if module != "pytest":
            assert {option for option in options_in(arguments) if f'"{option}"' not in text} == set(), shown.page


@pytest.mark.parametrize("program", MODULES)
def test_the_documents_show_every_command_of_a_program(program: str) -> None:
    shown = {one.line.split()[1] for one in PROGRAM_COMMANDS if one.line.split()[0] == program}
    assert subcommands(MODULES[program]) - shown == set()


def test_every_make_target_and_variable_in_the_documents_exists() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):(?!=)", makefile, re.MULTILINE))
    variables = set(re.findall(r"\$\(?(?:if )?\$?\(?([A-Z]+)\)", makefile))
    for page in (*PAGES, "CHANGELOG.md"):
        commands = re.findall(r"^make ([a-z-]+)|`make ([a-z-]+)((?: [A-Z]+=\S+?)*)`", page_text(page), re.MULTILINE)
        assert {first or second for first, second, _ in commands} - targets == set(), page
        assigned = set(re.findall(r"\b([A-Z]+)=", " ".join(settings for _, _, settings in commands)))
        assert assigned - variables == set(), page
