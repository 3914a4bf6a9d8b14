"""What a program says of an error: one line, and a status by which scripts tell errors apart."""

import sys
from collections.abc import Sequence
from typing import Final

from clutchdiag_io.files import legible

EXIT_UNEXPECTED: Final = 1
Kinds = type[Exception] | tuple[type[Exception], ...]


def complain(
    program: str,
    exc: Exception,
    statuses: Sequence[tuple[Kinds, int]],
    *,
    is_verbose: bool = False,
    hint: str = "",
) -> int:
    """Write one line about an error, if asked for also where it came from, and return the exit status.

    Parameters
    ----------
    statuses :
        The errors that may be expected, each with its status; the first that fits holds.
    hint :
        How the user learns more of an unexpected error.
    """
    status = next((code for kinds, code in statuses if isinstance(exc, kinds)), EXIT_UNEXPECTED)
    text = legible(" ".join(str(exc).split()))
    if status == EXIT_UNEXPECTED:
        text = f"unexpected {type(exc).__name__}: {text}{'' if is_verbose else hint}"
    if is_verbose:
        import traceback  # noqa: PLC0415 - needed here only

        traceback.print_exception(exc)
    sys.stderr.write(f"{program}: error: {text}\n")
    return status
