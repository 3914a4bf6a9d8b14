"""Pages of the site that are made, not written: from ``--help``, docstrings, schemas, tables, metrics.

Hooks of mkdocs, which calls them by their names. Links to files that are no pages become their names.
"""

import json
import posixpath
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Final

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT: Final = Path(__file__).parents[1]
PROGRAMS: Final = ("ecu_emulator.cli", "diag_service.cli", "fleet_backend.cli")
PACKAGES: Final = ("diag_service", "canlog", "ecu_emulator", "workshop")
LINK: Final = re.compile(r"\[([^\]]*)\]\((?!\w+:|#)([^)#]+)(#[^)]*)?\)")


# For who reads with a keyboard, a screen reader or weak eyes: what the theme lacks.
STYLE: Final = """.md-typeset p a, .md-typeset li a, .md-typeset td a { text-decoration: underline }
.md-tabs__link { opacity: 1 }
.md-typeset td code { word-break: normal }
"""
SCRIPT: Final = """document$.subscribe(() => setTimeout(() => {
  for (const one of document.querySelectorAll(".md-typeset__scrollwrap, .md-typeset pre")) one.tabIndex = 0;
  document.querySelector(".md-search").ariaLabel = "search";
  document.querySelectorAll("nav.md-code__nav").forEach((one, row) => one.ariaLabel = `block ${row + 1}`);
}));
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the reference, and what the theme lacks."""
    for name, text in {"site.css": STYLE, "site.js": SCRIPT}.items():
        files.append(File.generated(config, f"assets/{name}", content=text))
    pages = {"commands": _commands(), "parameters": _parameters(), "schemas": _schemas(), "tools": _tools()}
    pages |= {"controller": _controller(), "metrics": import_module("tests.tools.metrics_page").page()}
    pages |= {name: f"# {name}\n\n::: {name}\n" for name in PACKAGES}
    for name, text in pages.items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return a page whose links lead to pages."""
    del config

    def named(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), found[2]))
        if files.get_file_from_path(target) is not None:
            return found[0]
        path = posixpath.normpath(posixpath.join("docs", target))
        if not (ROOT / path).exists():
            return found[0]  # mkdocs complains
        return found[1] if path in found[1] else f"{found[1]} (`{path}`)"

    return LINK.sub(named, markdown)


def _parameters() -> str:
    parts = ["# Parameters", "", "Of the six-speed wet DCT and of the prognosis, as the programs read them."]
    for path in (
        "clutch_model/calibrations/nominal.toml", "ecu_emulator/plant/parameters.toml",
        "ecu_emulator/driving/parameters.toml", "clutch_results/prognosis/assumptions.py",
    ):  # fmt: skip
        language = {".toml": "toml", ".py": "python"}[Path(path).suffix]
        parts += ["", f"## {path}", "", f"```{language}", (ROOT / path).read_text(encoding="utf-8").strip(), "```"]
    return "\n".join(parts) + "\n"


def _commands() -> str:
    parts = ["# Commands", "", "What `--help` says, program by program."]
    for module in PROGRAMS:
        program: click.Command = import_module(module).command_line
        for path, text in _helps(program, program.name or "", None):
            parts += ["", f"{'##' if path == program.name else '###'} {path}", "", "```text", text, "```"]
    return "\n".join(parts) + "\n"


def _helps(command: click.Command, name: str, parent: click.Context | None) -> Iterator[tuple[str, str]]:
    context = click.Context(command, info_name=name, parent=parent, terminal_width=110, max_content_width=110)
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for one in command.list_commands(context):
            inner = command.get_command(context, one)
            if inner is not None:
                yield from _helps(inner, one, context)


def _schemas() -> str:
    parts = ["# Schemas", "", "JSON Schemas of the messages and records of version 1."]
    for path in sorted((ROOT / "fleet_contract" / "schemas").glob("*.json")):
        schema = json.loads(path.read_text(encoding="utf-8"))
        about = f"{schema.get('description', '')}"
        rows = [
            f"| `{name}` | {_kind(one)} | {str(one.get('description', '')).replace('|', '/')} |"
            for name, one in schema.get("properties", {}).items()
        ]
        parts += ["", f"## {path.stem}", "", about, "", "| key | type | meaning |", "|---|---|---|", *rows]
    return "\n".join(parts) + "\n"


def _controller() -> str:
    table = import_module("workshop.controller.table").shipped_table()
    return str(import_module("tests.tools.uds_tables").page(table))


def _tools() -> str:
    parts = ["# Commands for contributors", "", "What `python -m tests.tools` lists, with all that each says."]
    for command, said in import_module("tests.tools.__main__").commands().items():
        parts += ["", f"## {command.removeprefix('python -m ')}", "", "```text", said, "```"]
    return "\n".join(parts) + "\n"


def _kind(schema: dict[str, object]) -> str:
    kind = schema.get("type", schema.get("const", schema.get("$ref", "")))
    return " or ".join(map(str, kind)) if isinstance(kind, list) else str(kind)
