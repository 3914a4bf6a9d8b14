"""What people say at a keyboard: a key that ends a program which draws on a terminal, and yes or no."""

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from diag_service.console.terminal import CLEAR

LOOK_S: Final = 0.2
YES: Final = frozenset({"y", "yes"})


@contextmanager
def ending_key(key: str, end: Callable[[], None]) -> Iterator[bool]:
    """Call ``end``, from a thread, when a key is pressed; True if there is a keyboard.

    The terminal hands over single keys and shows none of them while this is entered.
    """
    descriptor = _keyboard()
    if descriptor is None:
        yield False
        return
    import termios  # noqa: PLC0415 - of POSIX; where it is missing there is no keyboard
    import tty  # noqa: PLC0415 - likewise

    before = termios.tcgetattr(descriptor)
    is_over = threading.Event()
    listener = threading.Thread(target=_listen, args=(descriptor, key, end, is_over), name="keyboard", daemon=True)
    try:
        tty.setcbreak(descriptor)
        listener.start()
        yield True
    finally:
        is_over.set()
        listener.join()
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _keyboard() -> int | None:
    """Return the descriptor of the terminal that a person types into, if this program may read it."""
    try:
        import termios  # noqa: F401, PLC0415 - of POSIX
    except ImportError:
        return None
    if sys.stdin is None or not sys.stdin.isatty():
        return None
    descriptor = sys.stdin.fileno()
    with suppress(OSError):  # it is not the terminal of this session, which nobody can take away
        if os.tcgetpgrp(descriptor) != os.getpgrp():  # in the background: whoever touches it is stopped
            return None
    return descriptor


def _listen(descriptor: int, key: str, end: Callable[[], None], is_over: threading.Event) -> None:
    while not is_over.is_set():
        if not select.select([descriptor], [], [], LOOK_S)[0]:
            continue
        try:
            typed = os.read(descriptor, 1)
        except OSError:  # the terminal is gone
            return
        if not typed:
            return
        if typed == key.encode():
            end()
            return


def is_person_there() -> bool:
    """Return whether somebody can read a question and answer it."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def is_confirmed(question: str, goes_on: Callable[[], bool]) -> bool:
    """Ask a person on standard error; where nobody sits the command line has the word, which is yes.

    Parameters
    ----------
    question
        What can be answered by yes or no.
    goes_on
        Asked while an answer is waited for; False is a no.
    """
    if not is_person_there():
        return True
    sys.stderr.write(f"{CLEAR}{question} [y/N] ")  # in place of a line that tells how far a program is
    sys.stderr.flush()
    while goes_on():
        if select.select([sys.stdin], [], [], LOOK_S)[0]:
            return sys.stdin.readline().strip().casefold() in YES
    sys.stderr.write("\n")
    return False
