"""A question to the person before the terminal, before something is done that cannot be undone."""

import select
import sys
from collections.abc import Callable
from typing import Final

from diag_service.console.terminal import CLEAR

LOOK_S: Final = 0.2
YES: Final = frozenset({"y", "yes"})


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
