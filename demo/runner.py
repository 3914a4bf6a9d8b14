"""One demonstration from beginning to end: the only file that knows the order of its steps."""

import asyncio
import fcntl
import json
import logging
import math
import os
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from amqtt.broker import Broker
from amqtt.contexts import BrokerConfig
from amqtt.errors import AMQTTError
from rich.console import Console
from rich.text import Text

from canlog.live.medium import Medium, open_medium
from clutch_model.calibration import nominal_calibration
from clutch_results.pictures import fan_of
from clutch_results.records import SHIFT_SCHEMA, ShiftResult, shift_from, verdict_from
from clutchdiag_io.people import PLUS_MINUS
from demo import ageing
from demo.ageing_picture import Point, draw
from demo.outcome import (
    Outcome,
    complaints,
    frame_account,
    frame_lines,
    lateness_text,
    live_line,
    seconds_line,
    tables,
    verdict_lines,
)
from demo.programs import BACKEND, EMULATOR, HANG_S, HOST, LOOK_S, SERVICE, DemoError, Program, free_port, program, run
from demo.scan_tool import ScanTool
from diag_service.api.analysis import draw_fan, save_figure
from diag_service.service.application import first_error
from ecu_emulator.truth import TruthLog, read_truth, truth_path
from fleet_contract import Channel
from fleet_contract.errors import ResultError
from fleet_link import BrokerAddress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IN_REAL_TIME: Final = "as an MQTT subscriber received them"
IN_VIRTUAL_TIME: Final = "as the service finds them in the recording"
SHIFT_S: Final = 3.9  # what one takes on the road, with the drive from one to the next
CAR_KG: Final = 1300  # light: it is quickly in the next gear
LAST_RESULT_S: Final = 60.0  # from the last frame to the last result
RECORDING, TRUTH = "drive.log", "truth.jsonl"
SHIFTS_PER_CYCLE: Final = 10  # 1-2-3-4-5-6-5-4-3-2-1
STORE, PICTURE, AGED = "results.sqlite", "demo.png", "ageing"
LEFT: Final = (
    RECORDING,
    TRUTH,
    PICTURE,
    ageing.PICTURE,
    *(f"{STORE}{suffix}" for suffix in ("", "-wal", "-shm")),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """What the user chose."""

    scenario: str
    seed: int | None
    shifts: int  # on the bus
    broker: BrokerAddress | None  # None: one of our own
    broker_url: str | None
    vehicle: str
    folder: Path
    began_s: float | None = None  # of the set-up [s since 1970]; None: there was none

    @property
    def drive(self) -> tuple[str, ...]:
        """The options with which the emulator drives it."""
        seed = () if self.seed is None else ("--seed", str(self.seed))
        cycles = math.ceil(self.shifts / SHIFTS_PER_CYCLE)
        return ("--scenario", self.scenario, "--cycles", str(cycles), "--mass-kg", str(CAR_KG), *seed)


async def run_demo(options: DemoOptions, console: Console) -> int:
    """Run one demonstration; return 0 if everything was as it must be, else 1.

    Raises
    ------
    DemoError
        If it cannot be run to its end.
    """
    folder = options.folder
    with _own_folder(folder), open_medium() as medium:
        (folder / AGED).mkdir(exist_ok=True)
        for name in LEFT:  # of an earlier demonstration: its running state must not be taken up
            (folder / name).unlink(missing_ok=True)
        console.print(f"bus:    {medium.explanation}", soft_wrap=True)
        parts = Parts(options.began_s)
        scan_tool = ScanTool()
        outcome, points = await _drive(options, medium, console, scan_tool, parts)
        if (late := lateness_text(outcome)) is not None:
            console.print(f"{late}: the same drive once more, in virtual time, from its recording", soft_wrap=True)
            outcome = await drive_in_virtual_time(options)
            parts.end("driving in virtual time")
        console.print(ageing.ageing_table(points))
        for table in tables(outcome):
            console.print(table)
        console.print("drawing the pictures: about 3 s")
        (folder / ageing.PICTURE).write_text(draw(points), encoding="utf-8")
        save_figure(bus_picture(outcome), folder / PICTURE)
        parts.end("pictures")
    found = [*ageing.course_complaints(points), *complaints(outcome)]
    lines: list[str | Text] = [*frame_lines(outcome.frames), f"pictures: {folder / PICTURE}, {folder / ageing.PICTURE}"]
    lines.append(seconds_line(parts.took_s))
    lines += [Text(f"failed: {complaint}", style="bold red") for complaint in found]
    lines += [*verdict_lines(outcome), f"order:   {outcome.order}", scan_tool.line]
    for line in lines:
        console.print(line, soft_wrap=True)
    return 1 if found else 0


def bus_picture(outcome: Outcome) -> "Figure":
    """Return the picture of the shifts that the table of single shifts tells."""
    fan = fan_of(outcome.shifts, (), [one.friction for one in nominal_calibration().clutches])
    return draw_fan(fan, f"{len(outcome.shifts)} shifts on the bus")


class Parts:
    """Measures what each part of a demonstration takes, from the begin of the set-up on, if there was one."""

    def __init__(self, began_s: float | None) -> None:
        self.took_s = {} if began_s is None else {"set-up": time.time() - began_s}
        self._since_s = time.monotonic()

    def end(self, name: str) -> None:
        """Note what took until now."""
        before_s, self._since_s = self._since_s, time.monotonic()
        self.took_s[name] = self._since_s - before_s


async def _drive(
    options: DemoOptions, medium: Medium, console: Console, scan_tool: ScanTool, parts: Parts
) -> tuple[Outcome, list[Point]]:
    """Let both programs run on one bus in real time, and beside it a fluid age; gather what is left of both."""
    folder, vehicle = options.folder, options.vehicle
    heard = Heard(lambda result: console.print(live_line(result), soft_wrap=True))
    async with AsyncExitStack() as stack:
        if options.broker is None:
            address = await stack.enter_async_context(_embedded_broker())
            url, whose = f"mqtt://{address}", "our own, embedded"
        else:
            address, url, whose = options.broker, options.broker_url or "", "yours"
        console.print(f"broker: {address}, {whose}; topics clutchdiag/v1/{vehicle}/#", soft_wrap=True)
        takes = "about 6 s, half a minute more where kernels are still to be compiled"
        console.print(f"starting the service on the bus, and recording the drive once beside it: {takes}")
        broker = {"CLUTCHDIAG_BROKER": url}  # not an argument: it may hold a password
        subscriber = program(BACKEND, "follow", "-", vehicle, "--json", folder=folder, environment=broker)
        results = await stack.enter_async_context(subscriber)
        listening = program(
            SERVICE, "run", *medium.arguments, "--vehicle", vehicle, "--store", folder / STORE, "--json",
            folder=folder, environment={**medium.environment, **broker},
        )  # fmt: skip
        service = await stack.enter_async_context(listening)
        driving = program(
            EMULATOR, "run", *medium.arguments, *options.drive, *scan_tool.emulator_arguments,
            "--truth", folder / TRUTH, "--force", "--json",
            folder=folder, environment=medium.environment,
        )  # fmt: skip
        async with _watched(heard.listen(results), service):
            # Each program compiles its kernels while the other does.
            await run(EMULATOR, "record", folder / RECORDING, "--force", *options.drive, folder=folder)
            if not await heard.within(HANG_S, lambda: heard.is_online):
                raise DemoError(f"the service did not announce itself within {HANG_S:.0f} s")
            parts.end("kernels, recording and service")
            takes_s = max(options.shifts * SHIFT_S, ageing.TAKES_S)
            drive = (
                f"driving {options.shifts} shifts on the bus in real time; each line as MQTT delivers it, {PLUS_MINUS}"
            )
            console.print(f"{drive}\nat once, {ageing.EXPLANATION}: about {takes_s:.0f} s in all", soft_wrap=True)
            async with asyncio.TaskGroup() as tasks:
                aged = tasks.create_task(ageing.let_age(folder / AGED))
                async with driving as driver:
                    with scan_tool:
                        await heard.within(math.inf, lambda: driver.has_ended or len(heard.shifts) >= options.shifts)
                        await driver.finish()
                truth = read_truth(folder / TRUTH)
                # If the last result never comes, the outcome will say so.
                await heard.within(LAST_RESULT_S, lambda: len(heard.shifts) >= len(truth.shifts))
            parts.end("driving")
        await service.finish()
    shifts = tuple(heard.shifts[seq] for seq in sorted(heard.shifts))
    summary = json.loads(service.output.splitlines()[-1])
    return _outcome(options, shifts, IN_REAL_TIME, summary, truth, json.loads(driver.output)), aged.result()


async def drive_in_virtual_time(options: DemoOptions) -> Outcome:
    """Let the service analyse the recording of the drive: frames carry their times, and no machine is too busy."""
    log = options.folder / RECORDING
    output = await run(SERVICE, "analyze", log, "--json", "--vehicle", options.vehicle, folder=options.folder)
    *records, summary = map(json.loads, output.splitlines())
    shifts = tuple(shift_from(record) for record in records if record["schema"] == SHIFT_SCHEMA)
    truth = read_truth(truth_path(log))
    recorded = 0 if truth.totals is None else truth.totals.frames
    transmitted = {"frames_sent": recorded, "frames_given_up": 0, "lateness_max_s": 0.0}
    return _outcome(options, shifts, IN_VIRTUAL_TIME, summary, truth, transmitted)


def _outcome(
    options: DemoOptions,
    shifts: tuple[ShiftResult, ...],
    origin: str,
    summary: Mapping[str, Any],
    truth: TruthLog,
    transmitted: Mapping[str, Any],
) -> Outcome:
    return Outcome(
        expected=options.shifts,
        shifts=shifts,
        origin=origin,
        clutches={int(record["clutch"]): verdict_from(record) for record in summary["clutches"]},
        order=summary["order"],
        truth=truth,
        frames=frame_account(transmitted, summary["frames"]),
    )


class Heard:
    """What a subscriber of MQTT has been told of a vehicle; a result that is delivered twice counts once."""

    def __init__(self, on_shift: Callable[[ShiftResult], None]) -> None:
        self._on_shift = on_shift
        self.is_online = False
        self.shifts: dict[int, ShiftResult] = {}

    async def listen(self, subscriber: Program) -> None:
        """Take up what the subscriber prints until cancelled; raises DemoError if it ends, or that is of no service."""
        async for line in subscriber.lines():
            try:
                self.take(json.loads(line))
            except ResultError as exc:
                raise DemoError(f"the broker delivered what is not of this service: {exc}") from exc

    def take(self, record: dict[str, Any]) -> None:
        """Take up one message."""
        if record["schema"] == Channel.STATUS.schema_name:
            self.is_online = record["status"] == "online"
        elif record["schema"] == SHIFT_SCHEMA and record["seq"] not in self.shifts:
            result = self.shifts[record["seq"]] = shift_from(record)
            self._on_shift(result)

    async def within(self, limit_s: float, is_so: Callable[[], bool]) -> bool:
        """Return whether something has become so within a time."""
        deadline_s = time.monotonic() + limit_s
        while not is_so():
            if time.monotonic() > deadline_s:
                return False
            await asyncio.sleep(LOOK_S)
        return True


@asynccontextmanager
async def _watched(listening: Any, service: Program) -> AsyncIterator[None]:  # noqa: ANN401 - a coroutine
    """Hear the broker and watch the service while the block lasts; what goes wrong with either ends the block."""

    async def no_end() -> None:
        await service.wait()
        raise DemoError("the service ended before its time")

    try:
        async with asyncio.TaskGroup() as tasks:
            watchers = (tasks.create_task(listening), tasks.create_task(no_end()))
            yield
            for watcher in watchers:
                watcher.cancel()
    except BaseExceptionGroup as group:
        raise first_error(group) from group


@asynccontextmanager
async def _embedded_broker() -> AsyncIterator[BrokerAddress]:
    """Run a broker inside this process for as long as the block lasts; raises DemoError if it cannot listen."""
    for name in ("amqtt", "transitions"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # it warns of every client that asks for MQTT 5 first
    address = BrokerAddress(host=HOST, port=free_port())
    broker = Broker(
        BrokerConfig.from_dict(
            {
                "listeners": {"default": {"type": "tcp", "bind": str(address)}},
                "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
            }
        )
    )
    try:
        await broker.start()
    except (AMQTTError, OSError) as exc:
        raise DemoError(f"the embedded broker cannot listen on {address}: {exc}") from exc
    try:
        yield address
    finally:
        await broker.shutdown()


@contextmanager
def _own_folder(folder: Path) -> Iterator[None]:
    """Make the folder ours for a while: another demonstration in it would mix up the files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / ".lock", os.O_CREAT | os.O_RDWR, 0o644)
    except OSError as exc:
        raise DemoError(f"cannot write to {folder}: {exc.strerror}") from exc
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as exc:
        raise DemoError(f"another demo writes to {folder}; choose --output") from exc
    finally:
        os.close(lock)
