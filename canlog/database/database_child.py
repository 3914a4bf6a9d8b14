"""Parses a database of unknown origin in a process of its own, whose memory and time are limited.

Run as a module, ``python -P -m ... FORMAT MEMORY_BYTES TIME_S MODE``, with the text on its standard input. On its
standard output it leaves a pickled ``Parsed``. Else it ends with one of the statuses below and says why on its
standard error.
"""

import gc
import pickle
import sys
from contextlib import suppress
from typing import Final

UNREADABLE: Final = 3
OUT_OF_MEMORY: Final = 4
LENIENT: Final = "lenient"
STRICT: Final = "strict"


def main(database_format: str, memory_bytes: int, time_s: int, mode: str) -> int:
    """Parse standard input within the limits, time being that of computing; return the exit status."""
    _limit(memory_bytes, time_s)
    gc.disable()  # what is parsed stays until the end
    try:
        return parse(sys.stdin.buffer.read().decode(), database_format, is_lenient=mode == LENIENT)
    except MemoryError:
        return OUT_OF_MEMORY


def _limit(memory_bytes: int, time_s: int) -> None:
    """Limit this process where the system can; elsewhere its parent waits for so long and no longer."""
    try:
        import resource  # noqa: PLC0415 - of POSIX
    except ImportError:
        return
    limits = {
        resource.RLIMIT_CORE: (0, 0),
        resource.RLIMIT_CPU: (time_s, time_s + 1),
        resource.RLIMIT_AS: (memory_bytes, memory_bytes),
    }
    unknown = () if sys.platform == "linux" else (OSError, ValueError)  # other systems refuse some of them
    for kind, limit in limits.items():
        with suppress(*unknown):
            resource.setrlimit(kind, limit)


def parse(text: str, database_format: str, *, is_lenient: bool) -> int:
    """Parse a text; write what came out."""
    from canlog.database import database_parsing as parsing  # noqa: PLC0415 - within the limits

    try:
        if database_format == "dbc":
            parsed = parsing.parsed_dbc(text, is_lenient=is_lenient)
        else:
            parsed = parsing.checked(text, database_format)
    except parsing.ParseError as error:
        sys.stderr.write(parsing.one_line(error))
        return UNREADABLE
    sys.stdout.buffer.write(pickle.dumps(parsed, protocol=pickle.HIGHEST_PROTOCOL))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]))
