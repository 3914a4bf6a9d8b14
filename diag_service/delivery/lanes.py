"""In which order results are sent: what happens now is not to wait behind what happened in the tunnel."""

from typing import Final, Protocol

from diag_service.diagnosis.results import StoredResult

_END: Final = 2**63 - 1
_BACKLOG_SHARE: Final = 4  # one of so many results of a batch is backlog, however much comes in
_NEWEST_SHARE: Final = 4  # and one of so many of the backlog is its newest


class WaitingResults(Protocol):
    """The part of the store from which results are taken."""

    def waiting(self, vehicle: str, *, after: int, before: int, limit: int) -> list[StoredResult]:
        """Return the oldest undelivered results between two positions, oldest first."""

    def newest_waiting(self, vehicle: str, *, after: int, before: int, limit: int) -> list[StoredResult]:
        """Return the newest undelivered results between two positions, newest first."""

    def last_position(self, vehicle: str) -> int:
        """Return the position of the newest result."""


class Lanes:
    """What one connection has still to send; each result is handed out once.

    Results stored since the connection began go first. What waited before is the backlog: it is sent from its old end,
    and a share of each batch from its new end, so that the last hour is known long before the last day is through.
    """

    def __init__(self, store: WaitingResults, vehicle: str) -> None:
        self._store = store
        self._vehicle = vehicle
        self._fresh = store.last_position(vehicle)  # handed out up to here
        self._old = 0
        self._new = self._fresh + 1  # handed out from here on

    def next(self, limit: int) -> list[StoredResult]:
        """Return what is sent next, ``limit`` results at most; none if nothing is left."""
        reserved = limit // _BACKLOG_SHARE if self._old + 1 < self._new else 0
        fresh = self._take_fresh(limit - reserved)
        return fresh + self._take_backlog(limit - len(fresh))

    def next_fresh(self, limit: int) -> list[StoredResult]:
        """Return what came since the connection began, and nothing of the backlog."""
        return self._take_fresh(limit)

    def _take_fresh(self, limit: int) -> list[StoredResult]:
        taken = self._store.waiting(self._vehicle, after=self._fresh, before=_END, limit=limit)
        if taken:
            self._fresh = taken[-1].position
        return taken

    def _take_backlog(self, limit: int) -> list[StoredResult]:
        if self._old + 1 >= self._new or limit < 1:
            return []
        oldest = self._store.waiting(self._vehicle, after=self._old, before=self._new, limit=limit)
        if len(oldest) < limit:  # all that is left
            self._new = self._old + 1
            return oldest
        share = limit // _NEWEST_SHARE
        oldest = oldest[: limit - share]
        self._old = oldest[-1].position
        newest = self._store.newest_waiting(self._vehicle, after=self._old, before=self._new, limit=share)
        if newest:
            self._new = newest[-1].position
        return newest + oldest
