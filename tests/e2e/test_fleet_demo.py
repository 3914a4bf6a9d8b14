"""The demonstration of a fleet: without a terminal it ends by itself, before one at Ctrl-C; twice in one folder."""

import os
import pty
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from tests.support.patience import HANG_S
from tests.support.service import environment

ROOT = Path(__file__).parents[2]
VEHICLES = ("taxi-3", "taxi-2", "taxi-1")  # the worst first
CTRL_C = b"\x03"

pytestmark = pytest.mark.slow


def command(folder: Path) -> Sequence[str]:
    return (sys.executable, "-m", "demo.fleet", "--cycles", "1", "--output", str(folder))


def assert_all_was_shown(text: str) -> None:
    """Check that the servers are real ones, that the table has the worst vehicle first, and that the page answered."""
    assert "database  PostgreSQL on port " in text
    assert "broker    Mosquitto at mqtt://" in text
    assert "database  30 results of 3 vehicles" in text
    table = text[text.index("Fleet, worst first") :]
    assert tuple(dict.fromkeys(re.findall(r"^ *(taxi-\d) ", table, re.MULTILINE))) == VEHICLES
    assert re.search(r"^page +http://127\.0\.0\.1:\d+/ answered with \d+ kB$", text, re.MULTILINE), text


@contextmanager
def nobody_left(process_id: int) -> Iterator[psutil.Process]:
    """Yield a process; neither it nor its children outlive the block."""
    family = psutil.Process(process_id)
    try:
        yield family
    finally:
        with suppress(psutil.NoSuchProcess):
            for left in (*family.children(recursive=True), family):
                left.kill()


def test_it_ends_by_itself_without_a_terminal(tmp_path: Path) -> None:
    out, err = subprocess.PIPE, subprocess.PIPE
    with (
        subprocess.Popen(
            command(tmp_path), cwd=ROOT, env=environment(), stdin=subprocess.DEVNULL, stdout=out, stderr=err, text=True
        ) as process,
        nobody_left(process.pid),
    ):
        said, complained = process.communicate(timeout=HANG_S)
    assert (process.returncode, complained) == (0, "")
    assert_all_was_shown(said)


def test_it_ends_at_ctrl_c_before_a_terminal(tmp_path: Path) -> None:
    """In a folder where an earlier one left its drives, and below ``make``, as people start it."""
    for vehicle in VEHICLES:
        (tmp_path / vehicle).mkdir()
        (tmp_path / vehicle / "drive.log").write_text("an earlier drive\n", encoding="utf-8")
    makefile = tmp_path / "Makefile"
    makefile.write_text(f".PHONY: fleet\nfleet:\n\t@{shlex.join(command(tmp_path))}\n", encoding="utf-8")
    status, text = before_a_terminal(("make", "--file", str(makefile), "fleet"))
    assert status == 0, text
    assert_all_was_shown(text)
    assert "Ctrl-C ends the page" in text


def before_a_terminal(words: Sequence[str]) -> tuple[int, str]:
    """Run a demonstration before a terminal, press Ctrl-C where it asks for that; return its status and its words."""
    process_id, terminal = pty.fork()
    if process_id == 0:
        os.chdir(ROOT)
        os.execvpe(words[0], [*words], {**environment(), "TERM": "dumb", "COLUMNS": "200"})  # noqa: S606 - words of our own
    children: list[psutil.Process] = []
    text = b""
    with nobody_left(process_id) as family, os.fdopen(terminal, "r+b", buffering=0) as screen:
        try:
            while piece := screen.read(65536):
                text += piece
                if b"Ctrl-C ends" in text and not children:
                    children = family.children(recursive=True)
                    screen.write(CTRL_C)
        except OSError:  # Linux says so that the other end is closed
            pass
        _, status = os.waitpid(process_id, 0)
    assert len(children) >= 5  # broker, database, two workers, page
    assert [child.name() for child in children if child.is_running()] == []
    return os.waitstatus_to_exitcode(status), text.decode().replace("\r\n", "\n")
