"""Orders to a drive while it runs, one JSON table each: a fault, a trouble code, the engine, a trip, a gear."""

import json
import math
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import Event, Lock
from typing import Final, Protocol

from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import EmulatorConfigError, RecordError
from ecu_emulator.scenario.faults import BusFault, Degradation, Fault
from ecu_emulator.scenario.scenario_file import parse_fault

FaultsOfCode = Mapping[str, Sequence[Mapping[str, object]]]  # by trouble code
NO_CODES: Final[FaultsOfCode] = {}
PATIENCE_S: Final = 30.0  # with an emulator on a busy machine


class Ordered(Protocol):
    """What takes orders; each raises ConfigError if it cannot be followed."""

    def add_fault(self, fault: Fault) -> None: ...
    def switch_engine(self, *, is_on: bool) -> None: ...
    def end_trip(self) -> None: ...
    def request_gear(self, gear: int) -> None: ...


POLL_S: Final = 0.02  # how soon a car that is off hears that it is switched on


class LiveOrders:
    """Orders to a drive that goes on in real time: a stay with the engine off is as long as the clock says.

    Orders are carried out in the order in which they come, however many come within one step. Any thread may give one.
    """

    def __init__(self, drive: Drive, clock: Callable[[], float] = time.monotonic) -> None:
        self._drive, self._clock = drive, clock
        self._lock = Lock()
        self._off_s: float | None = None  # when it was ordered off, time of the clock; None: the engine is on
        self.add_fault: Final = drive.add_fault

    def switch_engine(self, *, is_on: bool) -> None:
        """Switch the engine off with the next frames, or on again; raises ConfigError if it is so already."""
        with self._lock:
            if is_on != (self._off_s is not None):
                raise EmulatorConfigError(f"the engine is {'on' if is_on else 'off'} already")
            now_s = self._clock()
            stay_s = 0.0 if self._off_s is None else now_s - self._off_s
            self._drive.switch_engine(is_on=is_on, stay_s=stay_s)
            self._off_s = None if is_on else now_s

    def end_trip(self) -> None:
        """End the trip with the next frames; raises ConfigError if the engine is off, or there are no trips."""
        with self._lock:
            self._check_is_on("trip to end")
            self._drive.end_trip()

    def request_gear(self, gear: int) -> None:
        """Ask for a gear; raises ConfigError if there is none, the engine is off, or there are no trips."""
        with self._lock:
            self._check_is_on("gear to engage")
            self._drive.request_gear(gear)

    def _check_is_on(self, what: str) -> None:
        if self._off_s is not None:
            raise EmulatorConfigError(f"the engine is off: there is no {what}")

    def stay(self, stop: Event) -> None:
        """Return as soon as the engine is on, or ``stop`` is set; for the thread that drives."""
        while self._drive.is_off and not stop.is_set():
            self._drive.obey()
            if self._drive.is_off:
                stop.wait(POLL_S)


def follow(line: bytes, drive: Ordered, faults_of_code: FaultsOfCode = NO_CODES) -> str:
    """Have an order followed and return the answer: ``ok`` and what was taken, or ``error:`` and why it was not.

    Parameters
    ----------
    line
        A fault by the keys of its scenario table, or a table with one of the keys ``code``, ``engine`` (``on``,
        ``off``), ``trip`` (``end``), ``gear``.
    faults_of_code
        Faults, by the keys of their scenario tables, that have the controller store a trouble code.
    """
    try:
        table = json.loads(line)
        key = next((key for key in _ORDERS if isinstance(table, Mapping) and key in table), None)
        if key is not None and len(table) == 1:
            return f"ok: {_ORDERS[key](table[key], drive, faults_of_code)}"
        fault = parse_fault(table)
        drive.add_fault(fault)
    except (ValueError, RecursionError) as exc:
        return f"error: not JSON: {' '.join(str(exc).split())}"
    except EmulatorConfigError as exc:
        return f"error: {' '.join(str(exc).split())}"
    return f"ok: {_words(fault)}"


def ask(path: Path, order: Mapping[str, object]) -> str:
    """Send an order to the emulator that listens at a socket, and return what it has taken.

    Raises ConfigError if it has not, with its reason, RecordError if nobody listens there.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
            caller.settimeout(PATIENCE_S)
            caller.connect(str(path))
            caller.sendall(f"{json.dumps(order)}\n".encode())
            with caller.makefile(encoding="utf-8") as stream:
                answer = stream.readline().strip()
    except OSError as exc:
        raise RecordError(f"no emulator listens at {path}: {exc.strerror or exc}") from exc
    is_taken, _, text = answer.partition(": ")
    if is_taken != "ok":
        raise EmulatorConfigError(text or "the emulator has gone without an answer")
    return text


def _words(fault: Fault) -> str:
    """Return a fault in words: what, where, how much."""
    if isinstance(fault, Degradation):
        where = {0: "", 1: " of clutch 1", 2: " of clutch 2"}[fault.clutch]
        return f"{fault.kind}{where}, strength {fault.strength:g}, from now on"
    what = (fault.message or "the bus") if isinstance(fault, BusFault) else fault.quantity
    much = fault.share if isinstance(fault, BusFault) else fault.size
    until = "from now on" if math.isinf(fault.duration_s) else f"for {fault.duration_s:g} s"
    return f"{fault.kind} of {what}, {much:g}, {until}"


def _code(word: object, drive: Ordered, faults_of_code: FaultsOfCode) -> str:
    tables = faults_of_code.get(str(word))
    if tables is None:
        known = ", ".join(sorted(faults_of_code)) or "none, without --diagnostics"
        raise EmulatorConfigError(f"no fault is known that leads to {word}; to these: {known}")
    faults = [parse_fault(table) for table in tables]
    for fault in faults:
        drive.add_fault(fault)
    return f"{word} by {' and '.join(map(_words, faults))}"


def _engine(word: object, drive: Ordered, _: FaultsOfCode) -> str:
    if word not in ("on", "off"):
        raise EmulatorConfigError(f"engine must be on or off, got {word}")
    drive.switch_engine(is_on=word == "on")
    return f"engine {word}"


def _trip(word: object, drive: Ordered, _: FaultsOfCode) -> str:
    if word != "end":
        raise EmulatorConfigError(f"trip must be end, got {word}")
    drive.end_trip()
    return "this trip ends, the next one follows"


def _gear(word: object, drive: Ordered, _: FaultsOfCode) -> str:
    if not isinstance(word, int) or isinstance(word, bool):
        raise EmulatorConfigError(f"gear must be a number, got {word!r}")
    drive.request_gear(word)
    return f"gear {word} is asked for"


_ORDERS: Final[Mapping[str, Callable[[object, Ordered, FaultsOfCode], str]]] = {
    "code": _code, "engine": _engine, "trip": _trip, "gear": _gear,
}  # fmt: skip
