"""The result store: an SQLite file that holds every result, the running state and what has not been delivered yet."""

from diag_service.store.file import APPLICATION_ID, SCHEMA_VERSION, remove_store
from diag_service.store.kept_events import KeptEvents, kept_event
from diag_service.store.reading import Row, StoreReader, is_store, note_fill, withdraw_fill
from diag_service.store.result_store import ResultStore, VehicleState, Versions

__all__ = [
    "APPLICATION_ID",
    "SCHEMA_VERSION",
    "KeptEvents",
    "ResultStore",
    "Row",
    "StoreReader",
    "VehicleState",
    "Versions",
    "is_store",
    "kept_event",
    "note_fill",
    "remove_store",
    "withdraw_fill",
]
