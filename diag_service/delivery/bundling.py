"""Whether results that wait together travel together: where the backend takes that, and as long as it works.

The backend says so in its acknowledgements; the store keeps it for the next start. What went in a bundle and is not
acknowledged in time goes alone the next time, so nothing depends on bundles: not on a broker that refuses them or hangs
up, nor on a backend that was set back.
"""

import logging
from collections.abc import Iterable, Sequence
from typing import Final

from diag_service.diagnosis.results import StoredResult
from diag_service.store import ResultStore
from fleet_contract import Outgoing, bundle_messages, raw_shift_message

_MOST_BROKEN: Final = 3  # connections in a row that no bundle survived
_WITHOUT: Final = 10  # connections after these, on which none is sent
_LOG = logging.getLogger(__name__)


class Bundling:
    """What an outbox knows of bundles, from one connection to the next."""

    def __init__(self, store: ResultStore, *, is_allowed: bool) -> None:
        self._store = store
        self._is_allowed = is_allowed  # where the word of a backend counts
        self._is_taken = False  # by the backend, as it said last
        self._is_proven = False  # over this connection: some arrived
        self._has_failed = False  # over this connection
        self._broken_count = 0  # connections in a row
        self._without_count = 0  # connections yet to come without bundles
        self._in_flight: set[int] = set()  # positions that went in bundles

    def begin(self) -> None:
        """Begin with a new connection; reads the store."""
        self._is_taken = self._is_allowed and self._store.takes_bundles()
        self._is_proven = False
        if self._broken_count >= _MOST_BROKEN:
            self._broken_count, self._without_count = 0, _WITHOUT
        self._has_failed = self._without_count > 0
        self._without_count -= self._has_failed
        self._in_flight.clear()

    def packed(self, groups: Iterable[Sequence[StoredResult]]) -> list[Outgoing]:
        """Return the messages of results; those of one group may travel together."""
        is_on = self._is_taken and not self._has_failed
        messages: list[Outgoing] = []
        for group in groups:
            alone = [raw_shift_message(row.key, row.produced_at, row.text) for row in group]
            messages += bundle_messages(alone) if is_on else alone
            note = self._in_flight.update if is_on and len(group) > 1 else self._in_flight.difference_update
            note(row.position for row in group)
        return messages

    def note_word(self, *, is_taken: bool) -> None:
        """Note what the backend says; writes into the store if that is new."""
        if self._is_allowed and is_taken != self._is_taken:
            self._is_taken = is_taken
            self._store.note_takes_bundles(is_taken=is_taken)

    def note_arrived(self, positions: Iterable[int]) -> None:
        """Note that the backend has acknowledged results."""
        arrived = self._in_flight.intersection(positions)
        if arrived:
            self._in_flight -= arrived
            self._is_proven, self._broken_count = True, 0

    def note_astray(self, positions: Iterable[int]) -> None:
        """Note that results were lost on their way; where none in a bundle has arrived, no more go like that."""
        if not self._is_proven and not self._in_flight.isdisjoint(positions):
            self._has_failed = True

    def note_broken(self, positions: Iterable[int], *, refusal: str | None = None) -> bool:
        """Return whether there were bundles among results whose sending failed."""
        lost = self._in_flight.intersection(positions)
        if not lost:
            return False
        self._in_flight -= lost
        self._has_failed = True
        self._broken_count += 1
        if refusal is not None:
            _LOG.warning("results go one by one: %s", refusal)
        return True
