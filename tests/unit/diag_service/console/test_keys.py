"""A key that ends a program: only where there is a keyboard, which is as before afterwards."""

import os
import pty
import termios
import threading
from collections.abc import Iterator

import pytest

from diag_service.console.terminal import ending_key
from tests.support.patience import HANG_S


@pytest.fixture(name="keyboard")
def _keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return where a test types; standard input is the terminal that hears it."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal, os.fdopen(ours, "wb", buffering=0):
        monkeypatch.setattr("sys.stdin", terminal)
        yield ours


def test_the_key_ends_it_and_no_other_does(keyboard: int) -> None:
    ended = threading.Event()
    with ending_key("q", ended.set) as has_keyboard:
        assert has_keyboard
        os.write(keyboard, b"x")
        assert not ended.is_set()
        os.write(keyboard, b"q")
        assert ended.wait(HANG_S)


def test_the_terminal_is_as_before(keyboard: int) -> None:
    before = termios.tcgetattr(keyboard)
    with ending_key("q", lambda: None):
        assert termios.tcgetattr(keyboard) != before
    assert termios.tcgetattr(keyboard) == before


def test_without_a_keyboard_nothing_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    for stdin in (None, open(os.devnull, encoding="utf-8")):  # noqa: SIM115, PTH123 - closed below
        monkeypatch.setattr("sys.stdin", stdin)
        with ending_key("q", lambda: None) as has_keyboard:
            assert not has_keyboard
        if stdin is not None:
            stdin.close()
