"""How much waits in a pipe: who listens to a bus and writes into it loses frames once it is full."""

from contextlib import suppress
from typing import Final

WIDE_BYTES: Final = 1024 * 1024  # as a rule a system lets a pipe grow so far


def widen(descriptor: int) -> None:
    """Let a pipe hold more, and its two ends hand over less often; Linux knows how, anything else stays as it is."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl  # noqa: PLC0415 - of POSIX

        fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, WIDE_BYTES)
