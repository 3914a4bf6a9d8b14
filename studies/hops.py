"""How long the way is from a shift event to its MQTT message: calls and modules, counted while one shift goes through.

Two counts. The first is of every call of a Python function of ours, whatever it does; a compiled kernel is one call.
Of the second a call counts if it holds the event or what was made of it (estimate, verdict, result, record, row, text,
message) and hands on such a thing: returns it, or calls what counts. Calls that only compute from it, such as those
that read a number, do not. A function that is called twice counts once. The broker is a Mosquitto; the service is
connected to it.

    python -m studies.hops            # an event to its stored result and to the broker
    python -m studies.hops udds       # the events of a UDDS from 20 degC to their diagnoses: the worst of them
    python -m studies.hops decode     # a log to a table of Parquet
    python -m studies.hops --listing  # and which modules and functions the calls are, the most called first
"""

import asyncio
import inspect
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType
from typing import Any

from clutch_model.calibration import nominal_calibration
from clutch_results.records import ClutchVerdict, ShiftEstimate, ShiftResult, StoredResult
from demo.fleet.brokers import Mosquitto
from diag_service.cli import main as command_line
from diag_service.delivery import MemoryReporter, MqttConnector, Outbox
from diag_service.diagnosis.events import Event
from diag_service.service.drive import DriveFrames, open_drive
from diag_service.service.recorded import events
from diag_service.service.session import Session
from diag_service.service.stages import Diagnosis
from diag_service.settings.config import DiagnosisConfig
from diag_service.stopping import Trigger
from diag_service.store import ResultStore
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario_file import load_scenario
from fleet_contract import Outgoing
from fleet_link import BrokerAddress
from studies.builders import in_oil, new_decoder, new_stages, to_batch
from studies.run import parsed, study_parser

CARRIERS = (Event, ShiftEstimate, ClutchVerdict, Diagnosis, ShiftResult, StoredResult, Outgoing)
RECORD_KEYS = {"schema", "friction", "clutch"}
PACKAGES = ("diag_service", "fleet_contract", "fleet_link", "clutch_model", "canlog", "clutchdiag_io")
VEHICLE, NOW = "car1", "2026-01-01T00:00:00.000000Z"
MOST_CALLS, MOST_MODULES = 25, 10  # goals, of what hands an event on
EVENT_GOALS, BROKER_MODULES, DECODE_GOALS = (500, 20), 30, (2_000, 30)  # of all calls: calls and modules
UDDS_GOALS, MOST_FILMS = (1_000, 20), 8  # of the worst event of a UDDS: calls and modules, integrations of its films
COOL_DEGC = 20.0
FILMS = ("diag_service.diagnosis.friction.film", "integrate_films")


Call = tuple[str, str]  # module and function


def record(path: Path, cycles: int) -> None:
    """Record a drive with production scatter, as the emulator's users do."""
    command = [sys.executable, "-m", "ecu_emulator", "record", str(path), "--cycles", str(cycles)]
    subprocess.run(command, check=True, capture_output=True)


@dataclass(slots=True)
class EventTrip:
    """The calls that counted, in the order in which they ended."""

    hops: dict[CodeType, str] = field(default_factory=dict)  # code -> module
    handing_on: set[FrameType] = field(default_factory=set)  # open calls that called one that counts
    calls: Counter[Call] = field(default_factory=Counter)  # of all functions

    def watch(self, frame: FrameType, event: str, result: object) -> None:
        """Take one event of the interpreter's profiler; a coroutine returns whenever it waits."""
        module = str(frame.f_globals.get("__name__", ""))
        is_function = frame.f_code.co_flags & inspect.CO_OPTIMIZED and not frame.f_code.co_name.startswith("<")
        if event == "call" and is_function and module.startswith(PACKAGES):
            self.calls[(module, frame.f_code.co_qualname)] += 1
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
def watched(trip: EventTrip) -> Iterator[None]:
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
        outbox.wake()
        await asyncio.sleep(0.01)


async def trip_of_a_shift(log: Path, port: int) -> tuple[EventTrip, Counter[Call]]:
    """Return the trip of the second shift of a log, and its calls until it was stored; the first one compiles."""
    trip = EventTrip()
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
            stored = trip.calls.copy()
            await delivered(outbox, 2)
        await outbox.close(sender)
    return trip, stored


def trip_of_decoding(log: Path, table: Path) -> EventTrip:
    """Return the trip of a log that becomes a table, a second time: what is compiled or kept then is."""
    words = ["decode", str(log), "-o", str(table), "--force"]
    command_line(words)
    trip = EventTrip()
    with watched(trip):
        command_line(words)
    return trip


def trips_of_a_udds(oil_degc: float) -> list[tuple[Event, Counter[Call]]]:
    """Return the events of a UDDS in oil of a temperature, each with its calls from the event to its diagnosis.

    They go through twice: what is loaded or compiled once is not theirs.
    """
    scenario = in_oil(replace(load_scenario("ideal"), drive=DriveName.UDDS), oil_degc)
    stages, trips = new_stages(), list[tuple[Event, Counter[Call]]]()
    events = [*stages.segment(to_batch(frames_of(scenario)[0])), *stages.flush()]
    for event in events:
        stages.conclude(event)
    stages = new_stages()
    for event in events:
        with watched(trip := EventTrip()):
            stages.conclude(event)
        trips.append((event, trip.calls))
    return trips


def modules_of(calls: Counter[Call]) -> Counter[str]:
    """Return how many calls each module had."""
    modules: Counter[str] = Counter()
    for (module, _), count in calls.items():
        modules[module] += count
    return modules


def said(what: str, calls: Counter[Call], goals: tuple[int, int]) -> str:
    """Return a count of all calls, with the modules that have most."""
    modules = modules_of(calls)
    most = ", ".join(f"{module} {count}" for module, count in modules.most_common(6))
    return f"{what}: {calls.total()} own calls in {len(modules)} modules; goals {goals[0]} and {goals[1]}; most: {most}"


def listing(calls: Counter[Call]) -> str:
    """Return the modules and their functions, one a line, the most called first."""
    lines = []
    for module, count in modules_of(calls).most_common():
        lines.append(f"{count:6} {module}")
        lines += [f"{n:12} {name}" for (where, name), n in calls.most_common() if where == module]
    return "\n".join(lines)


def main() -> int:
    """Print the way; return 1 if it is longer than the goals."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("way", nargs="?", choices=("event", "udds", "decode"), default="event")
    parser.add_argument("--listing", action="store_true", help="print every module and function with its count")
    asked = parsed(parser)
    if asked.way == "udds":
        trips = trips_of_a_udds(COOL_DEGC)
        event, calls = max(trips, key=lambda trip: trip[1].total())
        if asked.listing:
            print(listing(calls))
        total = sum((every for _, every in trips), Counter[Call]())
        calls_each, films_each = total.total() / len(trips), total[FILMS] / len(trips)
        print(f"{len(trips)} events: {calls_each:.0f} own calls and {films_each:.1f} integrations of films each")
        print(said(f"the worst, {event.kind.value} number {event.number}", calls, UDDS_GOALS))
        print(f"its films were integrated {max(every[FILMS] for _, every in trips)} times at most; goal {MOST_FILMS}")
        return int(calls.total() > UDDS_GOALS[0] or len(modules_of(calls)) > UDDS_GOALS[1])
    if asked.way == "decode":
        with TemporaryDirectory() as folder:
            log = Path(folder) / "drive.log"
            record(log, 1)
            calls = trip_of_decoding(log, Path(folder) / "drive.parquet").calls
        if asked.listing:
            print(listing(calls))
        print(said("a log to a table", calls, DECODE_GOALS))
        return int(calls.total() > DECODE_GOALS[0] or len(modules_of(calls)) > DECODE_GOALS[1])
    with TemporaryDirectory() as folder:
        log, broker = Path(folder) / "drive.log", Mosquitto(Path(folder))
        record(log, 1)
        broker.start()
        try:
            trip, stored = asyncio.run(trip_of_a_shift(log, broker.port))
        finally:
            broker.stop()
    modules = dict.fromkeys(trip.hops.values())
    for module in modules:
        names = [code.co_qualname for code, where in trip.hops.items() if where == module]
        print(f"{module}: {', '.join(names)}")
    if asked.listing:
        print(listing(stored))
        print("after that, until the broker has it:")
        print(listing(trip.calls - stored))
    print(said("an event to its stored result", stored, EVENT_GOALS))
    all_modules = len(modules_of(trip.calls))
    print(f"to the broker: {trip.calls.total()} own calls in {all_modules} modules; goal {BROKER_MODULES} modules")
    print(f"{len(trip.hops)} calls in {len(modules)} modules; goals {MOST_CALLS} and {MOST_MODULES}")
    return int(len(trip.hops) > MOST_CALLS or len(modules) > MOST_MODULES)


if __name__ == "__main__":
    sys.exit(main())
