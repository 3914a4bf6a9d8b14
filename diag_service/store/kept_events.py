"""Events over which the program failed, kept beside the store: whoever sends one in lets others see the fault."""

import json
import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Final

import numpy as np

from canlog.arrays import Series
from canlog.e2e.e2e_state import E2eState
from clutch_results.event_kinds import EndReason, EventKind
from clutchdiag_io.files import create_private
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event

MOST_FILES: Final = 20  # one is some 40 kB; a fault that comes again and again shows itself in a few
MOST_BYTES: Final = 20 * 2**20
SUFFIX: Final = ".event.npz"
_ABOUT: Final = "event"
_PARTS: Final = ("t_ns", "sequence", "value")
_LOG = logging.getLogger(__name__)


class KeptEvents:
    """A folder of events, each with its columns and what went wrong; the oldest leave as new ones come.

    Parameters
    ----------
    folder
        Made with the first event; None: nothing is kept.
    most_files, most_bytes
        What the folder may hold.
    """

    def __init__(self, folder: Path | None, *, most_files: int = MOST_FILES, most_bytes: int = MOST_BYTES) -> None:
        self._folder = folder
        self._most_files, self._most_bytes = most_files, most_bytes

    @classmethod
    def beside(cls, store: Path | None) -> "KeptEvents":
        """Return those of a store; one in memory has none."""
        return cls(None if store is None else store.with_name(f"{store.name}.events"))

    def keep(self, event: Event, fault: str) -> Path | None:
        """Write an event; return where it is, None if it could not be kept: the run goes on all the same."""
        if self._folder is None:
            return None
        path = self._folder / f"{event.end_ns}-{event.number}{SUFFIX}"
        try:
            self._folder.mkdir(exist_ok=True)
            create_private(path)
            with path.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **_arrays(event, fault))
            self._make_room(path)
        except OSError as exc:
            _LOG.warning("the event cannot be kept in %s: %s", self._folder, exc.strerror or exc)
            return None
        return path if path.exists() else None

    def _make_room(self, newest: Path) -> None:
        """Remove the oldest files that are too many, or too large together."""
        paths = [path for path in self._folder.glob(f"*{SUFFIX}") if path != newest] if self._folder else []
        paths.sort(key=lambda path: path.stat().st_mtime_ns, reverse=True)
        sizes = np.cumsum([path.stat().st_size for path in (newest, *paths)])
        kept = min(self._most_files, int(np.searchsorted(sizes, self._most_bytes, "right")))
        for path in (newest, *paths)[kept:]:
            with suppress(FileNotFoundError):
                path.unlink()


def _arrays(event: Event, fault: str) -> dict[str, np.ndarray]:
    about = asdict(event) | {"columns": {name: series.period_ns for name, series in event.columns.items()}}
    texts = {_ABOUT: np.array(json.dumps(about)), "fault": np.array(fault)}
    parts = [(signal, part) for signal in event.columns for part in _PARTS]
    return texts | {f"{signal}.{part}": getattr(event.columns[signal], part) for signal, part in parts}


def kept_event(path: Path) -> tuple[Event, str]:
    """Return an event that was kept, and what went wrong; raises OSError, ValueError or KeyError if it is none."""
    with np.load(path, allow_pickle=False) as arrays:
        about = json.loads(str(arrays[_ABOUT]))
        columns = {
            Signal(name): Series(**dict(zip(_PARTS, _of_signal(arrays, name), strict=True)), period_ns=period_ns)
            for name, period_ns in about.pop("columns").items()
        }
        fault = str(arrays["fault"])
    about["kind"], about["end_reason"] = EventKind(about["kind"]), EndReason(about["end_reason"])
    about["e2e"] = {message: E2eState(state) for message, state in about["e2e"].items()}
    return Event(**about, columns=columns), fault


def _of_signal(arrays: "np.lib.npyio.NpzFile", name: str) -> Sequence[np.ndarray]:
    return [arrays[f"{name}.{part}"] for part in _PARTS]
