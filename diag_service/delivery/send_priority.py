"""In which order results leave a store."""

from collections.abc import Sequence
from typing import Final

from diag_service.diagnosis.results import StoredResult
from diag_service.store import ResultStore

_BACKLOG_SHARE: Final = 4  # one of so many results of a batch is backlog, however much comes in
_NEWEST_SHARE: Final = 4  # and one of so many of the backlog is its newest


class SendPriority:
    """In which order one connection sends what waits; each result is handed out once.

    Results stored since the connection began go first: what happens now is not to wait behind what happened in the
    tunnel. What waited before is the backlog: it is sent from its old end, and a share of each batch from its new end,
    so that the last hour is known long before the last day is through.
    """

    def __init__(self, store: ResultStore, vehicle: str) -> None:
        self._store = store
        self._vehicle = vehicle
        self._began = store.last_position(vehicle)
        self._fresh = self._began  # handed out up to here
        self._old = 0
        self._new = self._fresh + 1  # handed out from here on

    def next(self, limit: int) -> list[StoredResult]:
        """Return what is sent next, ``limit`` results at most; none if nothing is left."""
        reserved = limit // _BACKLOG_SHARE if self._old + 1 < self._new else 0
        fresh = self.next_fresh(limit - reserved)
        return fresh + self._backlog(limit - len(fresh))

    def groups(self, rows: Sequence[StoredResult]) -> list[list[StoredResult]]:
        """Return what may travel together: what happens now does not wait for as long as a backlog takes on air."""
        fresh = [row for row in rows if row.position > self._began]
        return [fresh, [row for row in rows if row.position <= self._began]]

    def next_fresh(self, limit: int) -> list[StoredResult]:
        """Return what came since the connection began, and nothing of the backlog."""
        rows = self._store.waiting(self._vehicle, after=self._fresh, limit=limit)
        if rows:
            self._fresh = rows[-1].position
        return rows

    def _backlog(self, limit: int) -> list[StoredResult]:
        if self._old + 1 >= self._new or limit < 1:
            return []
        oldest = self._store.waiting(self._vehicle, after=self._old, before=self._new, limit=limit)
        if len(oldest) < limit:  # all that is left
            self._new = self._old + 1
            return oldest
        share = limit // _NEWEST_SHARE
        oldest = oldest[: limit - share]
        self._old = oldest[-1].position
        newest = self._store.waiting(self._vehicle, after=self._old, before=self._new, limit=share, newest_first=True)
        if newest:
            self._new = newest[-1].position
        return newest + oldest
