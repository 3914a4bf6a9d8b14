"""The fleet demonstration from beginning to end: servers, workers, vehicles, table."""

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.console import Console

from demo.errors import DemoError
from demo.fleet.mosquitto import mosquitto
from demo.fleet.page import show_page
from demo.fleet.postgres import PostgresServer, program_folder
from demo.programs import EMULATOR, SERVICE, output_files, program, run

BACKEND: Final = "fleet_backend"
WORKERS: Final = 2
OLD_DRIVES_DAYS: Final = 3650  # the emulated drives have dates of their own
ARRIVAL_S: Final = 60.0  # from the last shift to the last row
BROKER_LINES: Final = ("max_inflight_messages 0", "max_queued_messages 0")  # docs/fleet.md, limits


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """An emulated vehicle."""

    name: str
    scenario: str
    fluid: str  # for people


VEHICLES: Final = (
    Vehicle(name="taxi-1", scenario="ideal", fluid="fresh"),
    Vehicle(name="taxi-2", scenario="case1", fluid="worn"),
    Vehicle(name="taxi-3", scenario="case2", fluid="aged"),
)


async def run_fleet(folder: Path, cycles: int, console: Console, *, stays: bool) -> None:
    """Drive the vehicles, bring their results into the database, and show the fleet; all files go to ``folder``.

    At the end its page is there, and ``stays`` until somebody presses Ctrl-C.

    Raises
    ------
    DemoError
        If a program or server fails, or results do not arrive.
    """
    began_s = time.monotonic()
    async with AsyncExitStack() as stack:
        database = stack.enter_context(_database(folder, console))
        port = stack.enter_context(mosquitto(folder, BROKER_LINES))
        broker = f"mqtt://127.0.0.1:{port}"
        console.print(f"broker    Mosquitto at {broker}")
        await _backend(folder, "migrate", database)
        for number in range(1, WORKERS + 1):
            place = _subfolder(folder, f"worker-{number}")
            worker = ("ingest", "--broker", broker, "--database", database, "--worker", place.name)
            await stack.enter_async_context(program(BACKEND, *worker, folder=place, environment={}))
        console.print(f"ingest    {WORKERS} workers")
        await _subscribed(folder)
        first, *others = VEHICLES  # the first alone: it may have to compile the numerical kernels for all
        counts = [await _drive(first, folder, cycles, broker, console)]
        counts += await asyncio.gather(*(_drive(vehicle, folder, cycles, broker, console) for vehicle in others))
        await _arrival(folder, database, sum(counts))
        for vehicle in VEHICLES:
            fill = ("fill", vehicle.name, vehicle.fluid, "--at", "2025-12-01")
            await _backend(folder, *fill[:1], database, *fill[1:])
        console.print(
            f"database  {sum(counts)} results of {len(counts)} vehicles, {time.monotonic() - began_s:.0f} s\n"
        )
        for question in ("table", "alarms"):
            console.print(await _backend(folder, question, database, width=console.width), markup=False, soft_wrap=True)
        await _backend(folder, "watch", database, "--once", "--silence-days", str(OLD_DRIVES_DAYS))
        await show_page(_subfolder(folder, "page"), database, VEHICLES[-1].name, console, stays=stays)


@contextmanager
def _database(folder: Path, console: Console) -> Iterator[str]:
    """Yield the address of an empty database: PostgreSQL where it is installed."""
    if program_folder() is None:
        console.print("database  SQLite, since PostgreSQL is not installed (Debian package postgresql)")
        path = folder / "fleet.sqlite"
        for old in folder.glob("fleet.sqlite*"):
            old.unlink()
        yield f"sqlite:///{path.absolute()}"
        return
    server = PostgresServer()
    with closing(server):
        server.start()
        console.print(f"database  PostgreSQL on port {server.port}, data in {server.folder}")
        yield server.create("fleet")


async def _drive(vehicle: Vehicle, folder: Path, cycles: int, broker: str, console: Console) -> int:
    """Record a drive, analyse it and publish its results; return how many there are."""
    place = _subfolder(folder, vehicle.name)
    log = place / "drive.log"
    began_s = time.monotonic()
    drive = ("record", log, "--scenario", vehicle.scenario, "--cycles", str(cycles))
    await run(EMULATOR, *drive, folder=place, environment={})
    analysis = ("analyze", log, "--json", "--vehicle", vehicle.name, "--broker", broker, "--acknowledge", "backend")
    await run(SERVICE, *analysis, folder=place, environment={})
    lines = output_files(SERVICE, place)[0].read_text(encoding="utf-8").splitlines()
    count = len([line for line in lines if json.loads(line)["schema"] == "clutchdiag/shift/v1"])
    took_s = time.monotonic() - began_s
    console.print(
        f"vehicle   {vehicle.name}: {vehicle.fluid} fluid, {count} shifts recorded and analysed in {took_s:.0f} s"
    )
    return count


async def _subscribed(folder: Path) -> None:
    """Return when every worker listens; what is published before reaches nobody."""
    logs = [output_files(BACKEND, folder / f"worker-{number}")[1] for number in range(1, WORKERS + 1)]
    await _until(lambda: all("listening" in log.read_text(encoding="utf-8") for log in logs), "the workers listen")


async def _arrival(folder: Path, database: str, count: int) -> None:
    deadline_s = time.monotonic() + ARRIVAL_S
    while not (await _backend(folder, "hash", database)).endswith(f"  {count} results\n"):
        if time.monotonic() > deadline_s:
            raise DemoError(f"not all of the {count} results arrived within {ARRIVAL_S:g} s")
        await asyncio.sleep(0.5)


async def _until(is_so: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + ARRIVAL_S
    while not is_so():
        if time.monotonic() > deadline_s:
            raise DemoError(f"it took more than {ARRIVAL_S:g} s until {what}")
        await asyncio.sleep(0.05)


async def _backend(folder: Path, command: str, database: str, *more: str, width: int | None = None) -> str:
    """Run a command of the backend and return what it said, in lines of a width if that matters."""
    place = _subfolder(folder, "questions")
    wide = () if width is None else ("--width", str(width))
    await run(BACKEND, command, "--database", database, *more, *wide, folder=place, environment={})
    return output_files(BACKEND, place)[0].read_text(encoding="utf-8")


def _subfolder(folder: Path, name: str) -> Path:
    path = folder / name
    path.mkdir(exist_ok=True)
    return path
