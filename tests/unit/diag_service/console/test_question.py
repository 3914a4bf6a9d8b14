"""A question to whoever sits before the terminal."""

import io
import os
import pty
import select
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from diag_service.console.terminal import is_confirmed
from tests.support.patience import HANG_S


@contextmanager
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Yield the person's end of a terminal before which the program sits."""
    ours, theirs = pty.openpty()
    with (
        os.fdopen(theirs, "r") as keyboard,
        os.fdopen(os.dup(theirs), "w") as screen,
        monkeypatch.context() as patch,
    ):
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


def test_a_program_that_shall_end_takes_it_for_a_no(monkeypatch: pytest.MonkeyPatch) -> None:
    with person(monkeypatch) as end:
        assert not is_confirmed("clear?", lambda: False)
        assert_shown(end, b"clear?")


def test_where_nobody_sits_the_command_line_has_the_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    assert is_confirmed("clear?", lambda: True)
    monkeypatch.setattr("sys.stdin", None)
    assert is_confirmed("clear?", lambda: True)
