"""Who takes part in a simulation and in which state: SIL Kit's system monitor, which its Python binding does not have.

It is read by the C interface of the library that the binding brings, as a participant of its own that only looks on.
"""

import ctypes
import logging
import re
import threading
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Any, Final

QUIET: Final = "{Logging: {Sinks: []}}"
REPLY_S: Final = 2  # of this machine's time, in which a participant that works greets a new one
SILENT: Final = re.compile(r"(?:: |; )([^;:()]+) \([^)]*\) is waiting for reply")

_LOG = logging.getLogger(__name__)


class ParticipantState(IntEnum):
    """States of participants and of the whole system, as SIL Kit numbers them."""

    INVALID = 0
    SERVICES_CREATED = 10
    COMMUNICATION_INITIALIZING = 20
    COMMUNICATION_INITIALIZED = 30
    READY_TO_RUN = 40
    RUNNING = 50
    PAUSED = 60
    STOPPING = 70
    STOPPED = 80
    ERROR = 90
    SHUTTING_DOWN = 100
    SHUTDOWN = 110
    ABORTING = 120


GATHERING: Final = frozenset({ParticipantState.SERVICES_CREATED, ParticipantState.COMMUNICATION_INITIALIZING})
BUSY: Final = frozenset(
    {ParticipantState.READY_TO_RUN, ParticipantState.RUNNING, ParticipantState.PAUSED, ParticipantState.STOPPING}
)


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint64), ("reserved", ctypes.c_uint64 * 3))


class _Status(ctypes.Structure):
    _fields_ = (
        ("header", _Header),
        ("name", ctypes.c_char_p),
        ("state", ctypes.c_int16),
        ("reason", ctypes.c_char_p),
        ("entered_ns", ctypes.c_uint64),
        ("refreshed_ns", ctypes.c_uint64),
    )


class _Connection(ctypes.Structure):
    _fields_ = (("header", _Header), ("name", ctypes.c_char_p))


_OnStatus = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(_Status))
_OnState = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int16)
_OnLeft = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(_Connection))


class Observer:
    """Follows the states of all participants until it is closed.

    Parameters
    ----------
    library
        SIL Kit itself, ``libSilKit.so``, which the binding brings.
    name, registry
        Its own name in the simulation, and where the registry listens.
    on_change
        Called in a thread of SIL Kit whenever something has changed.

    Raises RuntimeError if no registry answers or the name is taken.
    """

    def __init__(self, library: ctypes.CDLL, name: str, registry: str, on_change: Callable[[], None]) -> None:
        self._call = partial(_call, library)
        self._on_change = on_change
        self._states: dict[str, ParticipantState] = {}
        self._reasons: dict[str, str] = {}  # of errors
        self._system = ParticipantState.INVALID
        self._was_aborted = False
        self._lock = threading.Lock()
        monitor, self._participant = ctypes.c_void_p(), _joined(library, QUIET, name, registry)
        self._handlers = _OnStatus(self._note_status), _OnState(self._note_system), _OnLeft(self._note_left)  # kept
        on_status, on_system, on_left = self._handlers
        handler_id = ctypes.c_uint64()
        self._call("SystemMonitor_Create", ctypes.byref(monitor), self._participant)
        self._call("SystemMonitor_SetParticipantDisconnectedHandler", monitor, None, on_left)
        self._call("SystemMonitor_AddParticipantStatusHandler", monitor, None, on_status, ctypes.byref(handler_id))
        self._call("SystemMonitor_AddSystemStateHandler", monitor, None, on_system, ctypes.byref(handler_id))

    @property
    def failure(self) -> str | None:
        """Why the simulation cannot go on; None: nothing is known."""
        with self._lock:
            if self._system is not ParticipantState.ERROR and not self._was_aborted:
                return None
        return "; ".join(sorted(self.errors())) or "it was aborted"

    def errors(self) -> set[str]:
        """Return what went wrong with participants, also with those that the simulation does not need."""
        with self._lock:
            return {f"{name} {reason}" for name, reason in self._reasons.items()}

    @property
    def is_joinable(self) -> bool:
        """Whether to join holds nobody up: others gather for a simulation, or none of an earlier one still runs."""
        with self._lock:
            states = set(self._states.values())
        return bool(states & GATHERING) or not states & BUSY

    @property
    def is_paused(self) -> bool:
        with self._lock:
            return ParticipantState.PAUSED in self._states.values()

    def has_shut_down(self, name: str) -> bool:
        """Whether a participant's end is known here, and so all that led to it."""
        with self._lock:
            return self._states.get(name) in {None, ParticipantState.SHUTDOWN}

    def running(self) -> list[str]:
        """Return who takes part in time."""
        with self._lock:
            return sorted(name for name, state in self._states.items() if state in BUSY)

    def abort(self) -> None:
        """End the simulation for all: it cannot go on, and SIL Kit's participants would wait for ever."""
        controller = ctypes.c_void_p()
        self._call("Experimental_SystemController_Create", ctypes.byref(controller), self._participant)
        self._call("Experimental_SystemController_AbortSimulation", controller)

    def close(self) -> None:
        """Leave."""
        self._call("Participant_Destroy", self._participant)

    def _note_status(self, _context: object, _monitor: object, name: bytes, status: Any) -> None:  # noqa: ANN401
        state, reason = (
            ParticipantState(status.contents.state),
            (status.contents.reason or b"").decode(errors="replace"),
        )
        with self._lock:
            self._states[name.decode()] = state
            if state is ParticipantState.ERROR:
                is_lost = reason == "Connection Lost"
                said = "crashed: it left without a word" if is_lost else f"reports an error: {' '.join(reason.split())}"
                self._reasons[name.decode()] = said
            self._was_aborted |= state is ParticipantState.ABORTING
        self._on_change()

    def _note_system(self, _context: object, _monitor: object, state: int) -> None:
        with self._lock:
            self._system = ParticipantState(state)
        self._on_change()

    def _note_left(self, _context: object, _monitor: object, connection: Any) -> None:  # noqa: ANN401
        with self._lock:
            self._states.pop(connection.contents.name.decode(), None)
        self._on_change()


def _call(library: ctypes.CDLL, function: str, *arguments: Any) -> None:  # noqa: ANN401 - as C takes them
    """Call a function of SIL Kit; raises RuntimeError with what it says if it fails."""
    library.SilKit_GetLastErrorString.restype = ctypes.c_char_p
    if getattr(library, f"SilKit_{function}")(*arguments) != 0:
        raise RuntimeError(library.SilKit_GetLastErrorString().decode(errors="replace"))


def _joined(library: ctypes.CDLL, settings: str, name: str, registry: str) -> ctypes.c_void_p:
    """Return a new participant."""
    configuration, participant = ctypes.c_void_p(), ctypes.c_void_p()
    _call(library, "ParticipantConfiguration_FromString", ctypes.byref(configuration), settings.encode())
    try:
        _call(library, "Participant_Create", ctypes.byref(participant), configuration, name.encode(), registry.encode())
    finally:
        _call(library, "ParticipantConfiguration_Destroy", configuration)
    return participant


def silent_participants(library: ctypes.CDLL, name: str, registry: str) -> list[str]:
    """Return who does not greet a newcomer of this name: a participant that is stuck in a step reads nothing."""
    settings = f"{{Logging: {{Sinks: []}}, Middleware: {{ConnectTimeoutSeconds: {REPLY_S}}}}}"
    try:
        _call(library, "Participant_Destroy", _joined(library, settings, name, registry))
    except RuntimeError as exc:  # also without a registry
        _LOG.debug("asked who answers: %s", exc)
        return SILENT.findall(" ".join(str(exc).split()))
    return []
