"""What the service says of itself, collected for a program that uses it as a library."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

from clutchdiag_io.legible import legible
from diag_service.console.notices import OWN

_FOUND: ContextVar[list[str] | None] = ContextVar("notices of this run", default=None)


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
