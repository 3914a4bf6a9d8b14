"""What people read and say: lines, how far a reading is, yes or no."""

import io
import os
import pty
import select
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from canlog.logs import LogReader, read_log
from diag_service.console import ReadingLine, is_confirmed
from tests.support.patience import HANG_S

LINES = "".join(f"({1767225600 + number}.000000) can0 100#00\n" for number in range(90_000))


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def watched(path: Path, stream: io.StringIO, now_s: list[float]) -> tuple[LogReader, ReadingLine]:
    path.write_text(LINES, encoding="ascii")
    line = ReadingLine(stream, now_s=lambda: now_s[0])
    return read_log(path, watch=line.watch), line


def test_a_terminal_sees_the_share_from_the_third_second_on(tmp_path: Path) -> None:
    terminal, now_s = Terminal(), [0.0]
    reader, line = watched(tmp_path / "drive.log", terminal, now_s)
    next(reader)
    assert terminal.getvalue() == ""
    now_s[0] = 2.0
    next(reader)
    assert f"reading {str(reader.name)[-10:]}" in terminal.getvalue() or "reading ..." in terminal.getvalue()
    assert "%, " in terminal.getvalue()
    line.report("a shift")
    assert terminal.getvalue().endswith("\r\x1b[K")
    told = len(terminal.getvalue())
    assert len(list(reader)) == 1  # the last moments of the log, and its end
    assert len(terminal.getvalue()) == told


@contextmanager
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Yield the person's end of a terminal before which the program sits."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as keyboard, os.fdopen(os.dup(theirs), "w") as screen, monkeypatch.context() as patch:
        patch.setattr("sys.stdin", keyboard)
        patch.setattr("sys.stderr", screen)
        yield ours
    os.close(ours)


def assert_shown(end: int, text: bytes) -> None:
    """Read what the person sees until the text is in it; a terminal hands over in pieces of its own."""
    seen = b""
    while text not in seen:
        assert select.select([end], [], [], HANG_S)[0], seen
        seen += os.read(end, 1000)


@pytest.mark.parametrize(("typed", "is_yes"), [("y", True), ("Yes", True), ("", False), ("n", False), ("yep", False)])
def test_only_a_yes_is_one(monkeypatch: pytest.MonkeyPatch, typed: str, is_yes: bool) -> None:
    with person(monkeypatch) as end:
        os.write(end, f"{typed}\n".encode())
        assert is_confirmed("clear?", lambda: True) is is_yes
        assert_shown(end, b"clear? [y/N] ")
