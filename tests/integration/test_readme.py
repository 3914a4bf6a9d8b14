"""The commands that README and guides show exist: programs, subcommands, options, make targets and variables."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.patience import HANG_S

ROOT = Path(__file__).parents[2]
MODULES = {"ecu-emulator": "ecu_emulator", "diag-service": "diag_service", "fleet-backend": "fleet_backend"}
DOCUMENTS = ("README.md", "docs/fleet.md")


def shell_lines() -> list[str]:
    """Return every line of the documents' shell blocks, comments cut off."""
    text = "".join((ROOT / name).read_text(encoding="utf-8") for name in DOCUMENTS)
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line.split("#")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


@cache
def help_text(module: str, command: str) -> str:
    answer = subprocess.run(
        [sys.executable, "-m", module, command, "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        timeout=HANG_S,
    )
    return answer.stdout


@pytest.mark.parametrize("line", [line for line in shell_lines() if line.split()[0] in MODULES])
def test_a_shown_command_is_understood(line: str) -> None:
    program, command, *arguments = line.split()
    known = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", help_text(MODULES[program], command)))
    assert {argument for argument in arguments if argument.startswith("-")} - known == set()


def test_the_readme_shows_every_subcommand() -> None:
    shown = {tuple(line.split()[:2]) for line in shell_lines() if line.split()[0] in MODULES}
    fleet = {command for program, command in shown if program == "fleet-backend"}
    assert fleet == {"alarms", "fill", "hash", "ingest", "migrate", "quarantine", "seen", "table", "trend"}
    shown -= {("fleet-backend", command) for command in fleet}
    assert shown == {
        ("ecu-emulator", "run"),
        ("ecu-emulator", "record"),
        ("ecu-emulator", "scenarios"),
        ("diag-service", "run"),
        ("diag-service", "analyze"),
        ("diag-service", "calibrate"),
        ("diag-service", "inspect"),
        ("diag-service", "signals"),
        ("diag-service", "decode"),
    }


def test_every_make_target_and_variable_in_the_documents_exists() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):(?!=)", makefile, re.MULTILINE))
    variables = set(re.findall(r"\$\(?(?:if )?\$?\(?([A-Z]+)\)", makefile))
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        commands = re.findall(r"^make ([a-z-]+)|`make ([a-z-]+)((?: [A-Z]+=\S+?)*)`", text, re.MULTILINE)
        assert {first or second for first, second, _ in commands} - targets == set(), name
        assigned = set(re.findall(r"\b([A-Z]+)=", " ".join(settings for _, _, settings in commands)))
        assert assigned - variables == set(), name
