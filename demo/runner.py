"""One demonstration from beginning to end: the only file that knows the order of its steps."""

import asyncio
import fcntl
import json
import os
import time
from collections.abc import AsyncIterator, Awaitable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from canlog.live.medium import Medium, open_medium
from demo.broker import embedded_broker
from demo.errors import DemoError
from demo.listener import Listener, listening, read_clutch_states
from demo.outcome import SHIFTS_PER_CYCLE, Outcome, complaints, frame_account
from demo.picture import draw
from demo.programs import EMULATOR, SERVICE, Program, output_files, program, run
from demo.scan_tool import ScanTool
from demo.table import live_line, order_lines, print_outcome, verdict_lines
from demo.traces import recorded_shift
from diag_service.diagnosis.records import ShiftResult
from ecu_emulator.truth.records import read_truth
from fleet_contract import CLUTCHES
from fleet_link import BrokerAddress

CYCLE_S = 40.6  # what one cycle takes on the road
READY_S = 30.0  # for a program to load and announce itself
LAST_RESULT_S = 10.0  # from the last frame to the last result
SHOWN_SHIFT = 4  # 4-5: a long upshift under load, which shows every phase
PICTURE = "demo.png"


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """What the user chose."""

    scenario: str
    seed: int | None
    cycles: int
    broker: BrokerAddress | None  # None: one of our own
    broker_url: str | None
    vehicle: str
    folder: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class _Files:
    """The files of a demonstration."""

    folder: Path

    @property
    def recording(self) -> Path:
        return self.folder / "drive.log"

    @property
    def truth(self) -> Path:
        return self.folder / "truth.jsonl"

    @property
    def transmitted(self) -> Path:
        return self.folder / "transmitted.json"

    @property
    def store(self) -> Path:
        return self.folder / "results.sqlite"

    @property
    def picture(self) -> Path:
        return self.folder / PICTURE

    def clear(self) -> None:
        """Remove what an earlier demonstration left: its running state must not be taken up."""
        stores = [self.store.with_name(f"{self.store.name}{suffix}") for suffix in ("", "-wal", "-shm")]
        outputs = [path for module in (EMULATOR, SERVICE) for path in output_files(module, self.folder)]
        for path in (self.recording, self.truth, self.transmitted, self.picture, *stores, *outputs):
            path.unlink(missing_ok=True)


async def run_demo(options: DemoOptions, console: Console) -> int:
    """Run one demonstration; return 0 if everything was as it must be, else 1.

    Raises
    ------
    DemoError
        If it cannot be run to its end.
    """
    with _own_folder(options.folder), open_medium() as medium:
        files = _Files(folder=options.folder)
        files.clear()
        console.print(f"bus:    {medium.explanation}", soft_wrap=True)
        await _warm_up(options, files, console)
        scan_tool = ScanTool()
        outcome = await _drive(options, medium, files, console, scan_tool)
        print_outcome(console, outcome)
        event = await asyncio.to_thread(recorded_shift, files.recording, SHOWN_SHIFT)
        await asyncio.to_thread(draw, files.picture, event, outcome)
    console.print(f"picture: {files.picture}", soft_wrap=True)
    found = complaints(outcome)
    for complaint in found:
        console.print(f"failed: {complaint}", style="bold red", soft_wrap=True)
    for clutch in CLUTCHES:
        if clutch in outcome.clutches:
            for line in verdict_lines(outcome.clutches[clutch]):
                console.print(line, soft_wrap=True)
    for line in order_lines(outcome.clutches.values()):
        console.print(line, soft_wrap=True)
    console.print(scan_tool.line, soft_wrap=True)
    return 1 if found else 0


async def _warm_up(options: DemoOptions, files: _Files, console: Console) -> None:
    """Record and analyse the same drive once: compiles the kernels of both programs, and the picture needs it."""
    console.print("compiling the kernels of both programs, unless cached ... ", end="")
    began_s = time.monotonic()
    await run(EMULATOR, "record", files.recording, "--force", *_scenario(options), folder=files.folder, environment={})
    await run(SERVICE, "analyze", files.recording, "--json", folder=files.folder, environment={})
    console.print(f"{time.monotonic() - began_s:.0f} s")


async def _drive(options: DemoOptions, medium: Medium, files: _Files, console: Console, scan_tool: ScanTool) -> Outcome:
    """Let both programs run on one bus in real time, and gather what is left of it."""

    def show(result: ShiftResult) -> None:
        console.print(live_line(result), soft_wrap=True)

    async with AsyncExitStack() as stack:
        if options.broker is None:
            address = await stack.enter_async_context(embedded_broker())
            url, whose = f"mqtt://{address}", "our own, embedded"
        else:
            address, url, whose = options.broker, options.broker_url or "", "yours"
        console.print(f"broker: {address}, {whose}; topics clutchdiag/v1/{options.vehicle}/#", soft_wrap=True)
        listener = await stack.enter_async_context(listening(address, options.vehicle, show))
        environment = {**medium.environment, "CLUTCHDIAG_BROKER": url}  # not an argument: it may hold a password
        service = await stack.enter_async_context(
            program(SERVICE, *_service_arguments(options, medium, files), folder=files.folder, environment=environment)
        )
        emulator = program(
            EMULATOR,
            *_emulator_arguments(options, medium, files),
            *scan_tool.emulator_arguments,
            folder=files.folder,
            environment=medium.environment,
        )
        async with _watched(listener, service):
            await _within(READY_S, listener.service_online(), "the service did not announce itself")
            console.print(f"driving {options.cycles * CYCLE_S:.0f} s in real time; each line as MQTT delivers it")
            async with emulator as driver:
                with scan_tool:
                    await driver.wait()
            await _last_shift(listener, SHIFTS_PER_CYCLE * options.cycles)
        await service.stop()
        await service.wait()
        clutches = await read_clutch_states(address, options.vehicle)
    summary = json.loads(service.output.splitlines()[-1])
    return Outcome(
        cycles=options.cycles,
        shifts=listener.shifts,
        clutches=clutches,
        truth=read_truth(files.truth),
        frames=frame_account(json.loads(files.transmitted.read_text(encoding="utf-8")), summary["frames"]),
    )


@asynccontextmanager
async def _watched(listener: Listener, service: Program) -> AsyncIterator[None]:
    """Hear the broker and watch the service while the block lasts; what goes wrong with either ends the block."""

    async def no_end() -> None:
        await service.wait()
        raise DemoError("the service ended before its time")

    try:
        async with asyncio.TaskGroup() as tasks:
            watchers = (tasks.create_task(listener.listen()), tasks.create_task(no_end()))
            yield
            for watcher in watchers:
                watcher.cancel()
    except BaseExceptionGroup as group:
        raise _first(group) from group


async def _last_shift(listener: Listener, count: int) -> None:
    """Wait for the last result; if it never comes, the outcome will say so."""
    try:
        async with asyncio.timeout(LAST_RESULT_S):
            await listener.shift_count(count)
    except TimeoutError:
        return


async def _within(limit_s: float, event: Awaitable[None], complaint: str) -> None:
    try:
        async with asyncio.timeout(limit_s):
            await event
    except TimeoutError as exc:
        raise DemoError(f"{complaint} within {limit_s:.0f} s") from exc


def _service_arguments(options: DemoOptions, medium: Medium, files: _Files) -> tuple[str | Path, ...]:
    outputs = ("--store", files.store, "--json")
    return ("run", *medium.arguments, "--vehicle", options.vehicle, *outputs)


def _emulator_arguments(options: DemoOptions, medium: Medium, files: _Files) -> tuple[str | Path, ...]:
    outputs = ("--truth", files.truth, "--summary", files.transmitted, "--force")
    return ("run", *medium.arguments, *_scenario(options), *outputs)


def _scenario(options: DemoOptions) -> tuple[str, ...]:
    seed = () if options.seed is None else ("--seed", str(options.seed))
    return ("--scenario", options.scenario, "--cycles", str(options.cycles), *seed)


def _first(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the first error inside nested groups."""
    error = group.exceptions[0]
    return _first(error) if isinstance(error, BaseExceptionGroup) else error


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
