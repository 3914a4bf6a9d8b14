"""Parses a database of unknown origin in a process of its own, whose memory and time are limited.

Run as a script, ``python -P database_child.py FORMAT MEMORY_BYTES TIME_S``, with the text on its standard input. It
imports nothing of this package. On its standard output it leaves a pickle: the database and what the strict check
complained of. Else it ends with one of the statuses below and says why on its standard error.
"""

import gc
import pickle
import resource
import sys
from typing import Final

UNREADABLE: Final = 3
OUT_OF_MEMORY: Final = 4


def main(database_format: str, memory_bytes: int, time_s: int) -> int:
    """Parse standard input within the limits, time being that of computing; return the exit status."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (time_s, time_s + 1))
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    gc.disable()  # what is parsed stays until the end
    try:
        return parse(sys.stdin.buffer.read().decode(), database_format)
    except MemoryError:
        return OUT_OF_MEMORY


def parse(text: str, database_format: str) -> int:
    """Parse strictly, else leniently; write what came out."""
    # python-can would take asammdf along: half a second and a hundred megabytes for nothing.
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # as the import system marks what is not there
    import cantools  # noqa: PLC0415 - within the limits

    complaint = ""
    try:
        database = cantools.database.load_string(text, database_format=database_format, strict=True)
    except cantools.Error as strict_error:
        complaint = one_line(strict_error)
        try:
            database = cantools.database.load_string(text, database_format=database_format, strict=False)
        except cantools.Error as error:
            sys.stderr.write(one_line(error))
            return UNREADABLE
    sys.stdout.buffer.write(pickle.dumps((database, complaint), protocol=pickle.HIGHEST_PROTOCOL))
    return 0


def one_line(error: Exception) -> str:
    """Return the text of a foreign error, on one line of bearable length."""
    cause = error.__cause__ or error
    text = " ".join(str(cause).split()) or type(cause).__name__
    return text if len(text) <= 160 else f"{text[:157]}..."


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
