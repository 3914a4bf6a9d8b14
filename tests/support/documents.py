"""The documents of the project and the commands in them."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "canlog/README.md",
    "fleet/README.md",
    "workshop/README.md",
    *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")),
)
MODULES = {"ecu-emulator": "ecu_emulator", "diag-service": "diag_service", "fleet-backend": "fleet_backend"}
"""Programs by the name that users type, and the module that is run for each."""

_BLOCK = re.compile(r"^( *)```sh\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
_COMMENT = re.compile(r"\s+#.*$")
_SPAN = re.compile(r"`([^`\n]+)`")
_INLINE = ("python -m ", *(f"{program} " for program in MODULES))


@dataclass(frozen=True, slots=True)
class Shown:
    """One command, and the page that shows it."""

    page: str
    line: str


def page_text(page: str) -> str:
    """Return what a page says."""
    return (ROOT / page).read_text(encoding="utf-8")


def block_lines(page: str) -> list[Shown]:
    """Return the lines of a page's shell blocks in their order, comments cut off."""
    lines = (
        _COMMENT.sub("", line).strip() for _, block in _BLOCK.findall(page_text(page)) for line in block.splitlines()
    )
    return [Shown(page, line) for line in lines if line and not line.startswith("#")]


def inline_commands(page: str) -> list[Shown]:
    """Return the commands that stand within a page's sentences and tables."""
    prose = re.sub(r"^ *```.*?^ *```", "", page_text(page), flags=re.MULTILINE | re.DOTALL)
    return [Shown(page, span) for span in _SPAN.findall(prose) if span.startswith(_INLINE)]


def all_commands() -> list[Shown]:
    """Return every command of every page once."""
    found = [one for page in PAGES for one in (*block_lines(page), *inline_commands(page))]
    return list({one.line: one for one in found}.values())
