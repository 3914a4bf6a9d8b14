"""Identifiers of requests and answers, as a command line says them."""

from typing import Final

from canlog.frames import EXTENDED_FLAG
from diag_service.errors import ConfigError

STANDARD_DIGITS: Final = 3
HIGHEST_STANDARD: Final = 0x7FF
HIGHEST_EXTENDED: Final = 0x1FFF_FFFF


def pairs_of(text: str) -> tuple[tuple[int, int], ...]:
    """Return ``79B:7BB,18DA10F1:18DAF110`` as identifiers with flags; raises ConfigError."""
    found = []
    for part in filter(None, (one.strip() for one in text.split(","))):
        request, _, answer = part.partition(":")
        try:
            found.append((_flagged(request), _flagged(answer)))
        except ValueError:
            raise ConfigError(f"--pairs {part!r}: say REQUEST:ANSWER in hexadecimal, as in 79B:7BB") from None
    return tuple(found)


def _flagged(text: str) -> int:
    """Return an identifier with its flags; more than three digits make it an extended one."""
    value, is_extended = int(text, 16), len(text.strip().removeprefix("0x")) > STANDARD_DIGITS
    if not 0 <= value <= (HIGHEST_EXTENDED if is_extended else HIGHEST_STANDARD):
        raise ValueError(text)
    return value | EXTENDED_FLAG if is_extended else value
