"""What a run asks of a store, and the store of a run whose results only its listeners get."""

import uuid
from collections.abc import Sequence
from typing import Protocol

from diag_service.diagnosis.records import FluidFill, ShiftResult, StoredResult
from diag_service.store.result_store import VehicleState, Versions


class SessionStore(Protocol):
    """Where the results of a run go, and what earlier runs left there; `ResultStore` says what each method does."""

    stream: str
    keeps_state: bool

    def next_seq(self) -> int:
        """Return the sequence number that the next result of the live stream gets."""

    def add(self, result: ShiftResult, state: VehicleState | None) -> bool:
        """Take a result and the state after it; False if the key is already there."""

    def find(self, vehicle: str, stream: str, seq: int, versions: Versions) -> ShiftResult | None:
        """Return the result stored under a key, if any."""

    def state(self, vehicle: str) -> VehicleState | None:
        """Return the running state of a vehicle, if one was stored."""

    def latest(self, vehicle: str) -> Sequence[StoredResult]:
        """Return the newest result of each clutch."""

    def fluid_at(self, vehicle: str, moment: str) -> FluidFill | None:
        """Return the fill of the fluid that a vehicle had at a moment (ISO 8601 UTC), if it is known."""


class NoStore:
    """Keeps nothing and knows nothing of earlier runs: nobody will ask."""

    keeps_state = False

    def __init__(self) -> None:
        self.stream = str(uuid.uuid4())
        self._last_seq = 0

    def next_seq(self) -> int:
        """Return the sequence number after the last one."""
        return self._last_seq + 1

    def add(self, result: ShiftResult, _: VehicleState | None) -> bool:
        """Note that the sequence number of a result is used."""
        self._last_seq = max(self._last_seq, result.seq)
        return True

    def find(self, *_: object) -> None:
        """Return nothing."""

    def state(self, _: str) -> None:
        """Return nothing."""

    def latest(self, _: str) -> Sequence[StoredResult]:
        """Return nothing."""
        return ()

    def fluid_at(self, *_: object) -> None:
        """Return nothing."""
