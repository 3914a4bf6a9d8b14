"""Which signals of a database, and which stretch of a log, are asked for."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Final

import numpy as np

from canlog.errors import DefinitionError, SourceError
from canlog.frames import FrameBatch
from canlog.tables.names import Place

JUMP_NS: Final = 60_000_000_000  # so far behind the end a log is read on: its clock may jump back
_NS_PER_S: Final = 1_000_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LEAST, _MOST = -(2**63), 2**63 - 1


def chosen_places(columns: Mapping[Place, str], patterns: Sequence[str]) -> frozenset[Place]:
    """Return the signals that patterns name: ``Message.Signal``, a signal alone, or with ``*``, ``?`` and ``[...]``.

    Raises
    ------
    DefinitionError
        If a pattern names none.
    """
    found: set[Place] = set()
    for pattern in patterns:
        own = {place for place, column in columns.items() if fnmatchcase(column, pattern) or place[1] == pattern}
        own |= {place for place in columns if "." not in pattern and fnmatchcase(place[1], pattern)}
        if not own:
            names = [*columns.values(), *(name for _, name in columns)]
            near = ", ".join(dict.fromkeys(get_close_matches(pattern, names)))
            raise DefinitionError(f"no signal is called {pattern}" + (f"; there is {near}" if near else ""))
        found |= own
    return frozenset(found)


@dataclass(frozen=True, slots=True)
class Moment:
    """A time, or so many seconds behind the first frame."""

    ns: int
    is_elapsed: bool

    @classmethod
    def of(cls, text: str) -> "Moment":
        """Return the moment that a text names: ``12.5`` seconds, or ISO 8601, in UTC unless it says otherwise.

        Raises
        ------
        SourceError
            If it names none.
        """
        try:
            return cls(round(float(text) * _NS_PER_S), is_elapsed=True)
        except (ValueError, OverflowError):
            pass
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise SourceError(
                f"{text!r} is not a time: 12.5 (seconds from the first frame) or 2026-01-01T12:30:00"
            ) from None
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return cls((moment - _EPOCH) // timedelta(microseconds=1) * 1_000, is_elapsed=False)

    def at_ns(self, first_ns: int) -> int:
        """Return when that is in a log with its first frame at ``first_ns``."""
        return self.ns + first_ns if self.is_elapsed else self.ns


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a log: from its begin on, up to its end and without it; None: all that there is."""

    begin: Moment | None = None
    end: Moment | None = None

    @classmethod
    def of(cls, begin: str | float | None, end: str | float | None) -> "Span":
        """Return the stretch between two moments, or without a limit; raises SourceError if one of them is none."""
        ends = [None if one is None else Moment.of(str(one)) for one in (begin, end)]
        return cls(*ends)

    def part(self, batches: Iterable[FrameBatch], left_out: Callable[[int], None]) -> Iterator[FrameBatch]:
        """Yield what of some batches lies inside; ``left_out`` is called with how many frames do not.

        Reading ends with the first batch that lies far behind the end.
        """
        if self.begin is None and self.end is None:
            yield from batches
            return
        begin_ns = end_ns = None
        for batch in batches:
            if begin_ns is None and len(batch):
                first_ns = int(batch.t_ns[0])
                begin_ns = _LEAST if self.begin is None else self.begin.at_ns(first_ns)
                end_ns = _MOST if self.end is None else self.end.at_ns(first_ns)
            if begin_ns is None or end_ns is None:
                continue
            is_inside = (batch.t_ns >= begin_ns) & (batch.t_ns < end_ns)
            kept = batch if is_inside.all() else batch[is_inside]
            left_out(len(batch) - len(kept))
            if len(kept):
                yield kept
            elif int(np.min(batch.t_ns)) - JUMP_NS >= end_ns:
                return


EVERYTHING: Final = Span()
