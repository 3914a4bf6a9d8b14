"""What the service says on standard error: one line per message, with the program's name before it."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

from canlog.errors import NOTICE
from canlog.jit import announce_compiling
from clutchdiag_io.files import legible

_FOUND: ContextVar[list[str] | None] = ContextVar("notices of this run", default=None)


_PROGRAM = "diag-service"
OWN = ("diag_service", "canlog", "fleet_link", "clutchdiag_io")  # whose messages are shown without being asked for
COMPILING = "diag_service.compiling"


class _Collector(logging.Handler):
    """Keeps the messages of the run that they come from; the handlers of the program get them as ever.

    With it a program without any logging of its own has no message on its standard error.
    """

    def emit(self, record: logging.LogRecord) -> None:
        found = _FOUND.get()
        if found is not None:
            found.append(legible(record.getMessage()))


_COLLECTOR: Final = _Collector()


@contextmanager
def collected_notices() -> Iterator[list[str]]:
    """Yield a list that gets what is logged in this context, and in the tasks that it starts with their threads."""
    for name in OWN:
        logging.getLogger(name).addHandler(_COLLECTOR)  # once, however often it is asked for
    found: list[str] = []
    token = _FOUND.set(found)
    try:
        yield found
    finally:
        _FOUND.reset(token)


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
    for name in OWN:
        own = logging.getLogger(name)
        own.handlers = [handler]
        own.propagate = False
        own.setLevel(level)
    compiling = logging.getLogger(COMPILING)
    compiling.setLevel(level)  # a level of its own: workers that leave other notices to their parent tell of this
    announce_compiling(lambda line: compiling.log(NOTICE, "%s", line))
    logging.getLogger("can").setLevel(logging.CRITICAL)  # python-can logs what it raises, and more
    logging.getLogger().handlers = [handler] if verbosity > 1 else [logging.NullHandler()]
