"""Standard error: notices, the progress of reading, a question with yes or no."""

import logging
import select
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from io import StringIO
from typing import Final, Self, TextIO

from rich.text import Text

from canlog.errors import NOTICE
from canlog.jit import announce_compiling
from canlog.logs import LogReader
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.program import legible

CLEAR: Final = "\r\x1b[K"  # takes away what stands on the last line
PATIENCE_S: Final = 2.0  # so long nobody asks
PERIOD_S: Final = 0.2
_LONGEST_NAME: Final = 40


class ReadingLine:
    """A progress line of reading logs on a terminal; shows nothing elsewhere.

    Parameters
    ----------
    stream :
        Where people look; None: standard error.
    now_s :
        The clock [s].
    """

    def __init__(self, stream: TextIO | None = None, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._now_s = now_s
        self._due_s = now_s() + PATIENCE_S
        self._is_shown = False
        self._is_watched = self._stream is not None and self._stream.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def watch(self, reader: LogReader) -> None:
        """Tell how far a log has been read; called after each of its batches, and at its end."""
        if reader.has_ended:
            self.clear()
        elif self._is_due():
            self.show(reading_text(reader))

    def tell(self, text: str) -> None:
        """Show a text after ``PATIENCE_S``, once per ``PERIOD_S`` at most."""
        if self._is_due():
            self.show(text)

    def report(self, news: object) -> None:
        """Clear the line before other reporters print: this is a reporter of the run."""
        del news
        self.clear()

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        if self._is_watched:
            self._stream.write(f"{CLEAR}{text}")
            self._stream.flush()
            self._is_shown = True
            self._due_s = self._now_s() + PERIOD_S

    def clear(self) -> None:
        if self._is_shown:
            self._stream.write(CLEAR)
            self._stream.flush()
            self._is_shown = False

    def _is_due(self) -> bool:
        return self._is_watched and self._now_s() >= self._due_s


SILENT: Final = ReadingLine(StringIO())  # of a caller in Python: nobody watches


def reading_text(reader: LogReader) -> str:
    """Return how far a log has been read: its share where its size is known, and the frames or values in any case."""
    name = legible(reader.name)
    short = name if len(name) <= _LONGEST_NAME else f"...{name[3 - _LONGEST_NAME :]}"
    share = f"{min(99, 100 * reader.read_bytes // reader.size_bytes)} %, " if reader.size_bytes else ""
    return f"reading {short}: {share}{reader.counts.frames} {reader.format.content}"


LOOK_S: Final = 0.2
YES: Final = frozenset({"y", "yes"})


def is_confirmed(question: str, goes_on: Callable[[], bool]) -> bool:
    """Ask a person on standard error; without a terminal the answer is yes, as the command line says.

    Parameters
    ----------
    question
        What can be answered by yes or no.
    goes_on
        Asked while an answer is waited for; False is a no.
    """
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):
        return True
    sys.stderr.write(f"{CLEAR}{question} [y/N] ")  # in place of a line that tells how far a program is
    sys.stderr.flush()
    while goes_on():
        if select.select([sys.stdin], [], [], LOOK_S)[0]:
            return sys.stdin.readline().strip().casefold() in YES
    sys.stderr.write("\n")
    return False


_NOTICES: ContextVar[list[str] | None] = ContextVar("notices of this run", default=None)


_PROGRAM = "diag-service"
# Whose messages are shown unasked.
LOGGERS = ("diag_service", "workshop", "canlog", "can_silkit", "fleet_link", "clutchdiag_io")
COMPILING = "diag_service.compiling"


class _Collector(logging.Handler):
    """Appends log messages to the list of the run that logs them; other handlers get them, too.

    With it a program without any logging of its own has no message on its standard error.
    """

    def emit(self, record: logging.LogRecord) -> None:
        notices = _NOTICES.get()
        if notices is not None:
            notices.append(legible(record.getMessage()))


_COLLECTOR: Final = _Collector()


@contextmanager
def collected_notices() -> Iterator[list[str]]:
    """Yield a list that gets what is logged in this context, and in the tasks that it starts with their threads."""
    for name in LOGGERS:
        logging.getLogger(name).addHandler(_COLLECTOR)  # once, however often it is asked for
    notices: list[str] = []
    token = _NOTICES.set(notices)
    try:
        yield notices
    finally:
        _NOTICES.reset(token)


class _OneLine(logging.Formatter):
    """``diag-service: warning: text``; no level where nothing is wrong, a traceback only if one is attached."""

    def format(self, record: logging.LogRecord) -> str:
        level = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        line = f"{_PROGRAM}: {level}{legible(record.getMessage())}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


def set_up_notices(verbosity: int) -> None:
    """Show what the service itself says; with ``verbosity`` 1 more of it, with 2 also what its libraries say."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine())
    level = (NOTICE, logging.INFO, logging.DEBUG)[min(verbosity, 2)]
    for name in LOGGERS:
        logger = logging.getLogger(name)
        logger.handlers = [handler]
        logger.propagate = False
        logger.setLevel(level)
    compiling = logging.getLogger(COMPILING)
    compiling.setLevel(level)  # a level of its own: workers that leave other notices to their parent tell of this
    announce_compiling(lambda line: compiling.log(NOTICE, "%s", line))
    logging.getLogger("can").setLevel(logging.CRITICAL)  # python-can logs what it raises, and more
    logging.getLogger().handlers = [handler] if verbosity > 1 else [logging.NullHandler()]


def write_record(record: Mapping[str, object], lines: Iterable[str | Text], *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(dump(record) + "\n")
    else:
        PeopleConsole().print_all(lines)
