"""How long the way is from a shift event to its MQTT message: calls and modules, counted while one shift goes through.

A call counts if it holds the event or what was made of it (estimate, verdict, result, record, row, text, message) and
hands on such a thing: returns it, or calls what counts. Calls that only compute from it, such as those that read a
number, do not. A function that is called twice counts once. The broker is a Mosquitto; the service is connected to it.

    python -m benchmarks.hops
"""

import asyncio
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType
from typing import Any

from benchmarks.service import new_decoder, record
from clutch_model.calibration import nominal_calibration
from diag_service.delivery import MemoryReporter, MqttConnector, Outbox
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.records import ClutchVerdict, ShiftEstimate, ShiftResult
from diag_service.diagnosis.results import StoredResult
from diag_service.service.drive import DriveFrames, open_drive
from diag_service.service.recorded import events
from diag_service.service.session import Session
from diag_service.service.stages import Diagnosis
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore
from fleet_contract import Outgoing
from fleet_link import BrokerAddress
from tests.plugins.broker import Mosquitto

CARRIERS = (Event, ShiftEstimate, ClutchVerdict, Diagnosis, ShiftResult, StoredResult, Outgoing)
RECORD_KEYS = {"schema", "friction", "clutch"}
PACKAGES = ("diag_service", "fleet_contract", "clutch_model", "canlog")
VEHICLE, NOW = "car1", "2026-01-01T00:00:00.000000Z"
MOST_CALLS, MOST_MODULES = 25, 10  # goals


@dataclass(slots=True)
class Trip:
    """The calls that counted, in the order in which they ended."""

    hops: dict[CodeType, str] = field(default_factory=dict)  # code -> module
    handing_on: set[FrameType] = field(default_factory=set)  # open calls that called one that counts

    def watch(self, frame: FrameType, event: str, result: object) -> None:
        """Take one event of the interpreter's profiler; a coroutine returns whenever it waits."""
        module = str(frame.f_globals.get("__name__", ""))
        if event != "return" or not module.startswith(PACKAGES) or frame.f_code.co_name.startswith(("<", "__")):
            return
        held = [value for value in frame.f_locals.values() if carries(value)]
        sends = any(is_message(value) for value in held)
        if carries(result) or sends or (held and frame in self.handing_on):
            self.hops.setdefault(frame.f_code, module)
            if frame.f_back is not None:
                self.handing_on.add(frame.f_back)


def is_message(value: object) -> bool:
    """Return whether a value is a message, or begins with one."""
    return isinstance(value, Outgoing) or (isinstance(value, list | tuple) and bool(value) and is_message(value[0]))


def carries(value: object) -> bool:
    """Return whether a value is the event, or what was made of it, or a few of them."""
    if isinstance(value, CARRIERS):
        return True
    if isinstance(value, dict):
        return value.keys() >= RECORD_KEYS
    if isinstance(value, str):
        return value.startswith('{"schema":"clutchdiag/shift')
    return isinstance(value, list | tuple) and any(carries(one) for one in value[:3])


@contextmanager
def watched(trip: Trip) -> Iterator[None]:
    """Let a trip watch all threads."""
    watch: Callable[[FrameType, str, Any], None] = trip.watch
    threading.setprofile(watch)
    sys.setprofile(watch)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def new_session(store: ResultStore) -> Session:
    """Return a session in memory."""
    config = DiagnosisConfig(vehicle=VEHICLE, calibration=nominal_calibration())
    return Session(config, new_decoder(), store, None, MemoryReporter())


async def delivered(outbox: Outbox, count: int) -> None:
    """Return when the broker has acknowledged so many results."""
    while outbox.counts.acknowledged < count:
        outbox.nudge()
        await asyncio.sleep(0.01)


async def trip_of_a_shift(log: Path, port: int) -> Trip:
    """Return the trip of the second shift of a log; the first one compiles."""
    trip = Trip()
    with closing(ResultStore.in_memory()) as store:
        session = new_session(store)
        connector = MqttConnector(BrokerAddress(host="127.0.0.1", port=port), "clutchdiag-hops")
        outbox = Outbox(store, VEHICLE, lambda: connector.connect(NOW), "broker")
        with open_drive([log]) as logs:
            first, second, *_ = events(DriveFrames(logs, session.stages.decoder.sources), session.stages, Trigger())
        sender = asyncio.create_task(outbox.run())
        session.process(first)
        await delivered(outbox, 1)
        with watched(trip):
            asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor())  # only new threads are watched
            session.process(second)
            await delivered(outbox, 2)
        await outbox.close(sender)
    return trip


def main() -> int:
    """Print the way; return 1 if it is longer than the goals."""
    with TemporaryDirectory() as folder:
        log, broker = Path(folder) / "drive.log", Mosquitto(Path(folder))
        record(log, 1)
        broker.start()
        try:
            trip = asyncio.run(trip_of_a_shift(log, broker.port))
        finally:
            broker.stop()
    modules = dict.fromkeys(trip.hops.values())
    for module in modules:
        names = [code.co_qualname for code, where in trip.hops.items() if where == module]
        print(f"{module}: {', '.join(names)}")
    print(f"{len(trip.hops)} calls in {len(modules)} modules; goals {MOST_CALLS} and {MOST_MODULES}")
    return int(len(trip.hops) > MOST_CALLS or len(modules) > MOST_MODULES)


if __name__ == "__main__":
    sys.exit(main())
