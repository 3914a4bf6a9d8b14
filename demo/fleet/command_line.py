"""The fleet demonstration, ``python -m demo.fleet``: servers, workers, vehicles, the fleet's table and its page."""

import argparse
import asyncio
import json
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AsyncExitStack, closing, contextmanager, nullcontext, suppress
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from clutchdiag_io.console import PeopleConsole
from demo.fleet.servers import PostgresServer, mosquitto, program_folder
from demo.programs import (
    BACKEND,
    DONE,
    EMULATOR,
    HANG_S,
    HOST,
    LOOK_S,
    SERVICE,
    USAGE,
    DemoError,
    ExtraMissingError,
    check_extra,
    foreground,
    output_files,
    program,
    run,
    to_its_end,
)

PROGRAM: Final = "fleet"
CYCLES: Final = 2
WORKERS: Final = 2
OLD_DRIVES_DAYS: Final = 3650  # the emulated drives have dates of their own
BROKER_LINES: Final = ("max_inflight_messages 0", "max_queued_messages 0")  # docs/operations.md, MQTT
USUAL_PORT: Final = 8090  # of the page
FLUIDS: Final = {"taxi-1": ("ideal", "fresh"), "taxi-2": ("case1", "worn"), "taxi-3": ("case2", "aged")}
"""Scenario and fluid of each vehicle, the worst last."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return 0 done, 1 failed, 2 usage or a missing extra, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        check_extra("./fleet[page]")
    except ExtraMissingError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE
    options.output.mkdir(parents=True, exist_ok=True)
    console, stays = PeopleConsole(highlight=False), sys.stdin.isatty()
    with foreground() if stays else nullcontext():
        return to_its_end(PROGRAM, run_fleet(options.output, options.cycles, console, stays=stays))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m demo.fleet",
        description="Broker, database, ingest workers, three emulated vehicles; then the fleet, worst first; its page.",
        epilog="exit status: 0 done, 1 failed, 2 usage or an extra that is not installed, 130 interrupted",
    )
    parser.add_argument(
        "--cycles", type=int, default=CYCLES, metavar="N", help="ten shifts each (default: %(default)s)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("fleet-output"), metavar="DIR", help="default: fleet-output"
    )
    return parser


async def run_fleet(folder: Path, cycles: int, console: PeopleConsole, *, stays: bool) -> int:
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
        broker = f"mqtt://{HOST}:{port}"
        console.print(f"broker    Mosquitto at {broker}")
        await _backend(folder, "migrate", database)
        places = [_subfolder(folder, f"worker-{number}") for number in range(1, WORKERS + 1)]
        for place in places:
            worker = ("ingest", "--broker", broker, "--database", database, "--worker", place.name)
            await stack.enter_async_context(program(BACKEND, *worker, folder=place))
        console.print(f"ingest    {WORKERS} workers")
        # What is published before they listen reaches nobody.
        logs = [output_files(BACKEND, place)[1] for place in places]
        await _until(lambda: all("listening" in log.read_text(encoding="utf-8") for log in logs), "the workers listen")
        first, *others = FLUIDS  # the first alone: it may have to compile the numerical kernels for all
        counts = [await _drive(first, folder, cycles, broker, console)]
        counts += await asyncio.gather(*(_drive(name, folder, cycles, broker, console) for name in others))
        await _arrival(folder, database, sum(counts))
        fills = [(name, fluid, "--at", "2025-12-01") for name, (_, fluid) in FLUIDS.items()]
        await asyncio.gather(*(_backend(folder, "fill", database, *fill) for fill in fills))
        took_s = time.monotonic() - began_s
        console.print(f"database  {sum(counts)} results of {len(counts)} vehicles, {took_s:.0f} s\n")
        await _backend(folder, "watch", database, "--once", "--silence-days", str(OLD_DRIVES_DAYS))
        for question in ("table", "alarms"):
            console.print(await _backend(folder, question, database))
        await _show_page(_subfolder(folder, "page"), database, console, stays=stays)
    return DONE


@contextmanager
def _database(folder: Path, console: PeopleConsole) -> Iterator[str]:
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


async def _drive(name: str, folder: Path, cycles: int, broker: str, console: PeopleConsole) -> int:
    """Record a drive, analyse it and publish its results; return how many there are."""
    place, (scenario, fluid) = _subfolder(folder, name), FLUIDS[name]
    log = place / "drive.log"
    began_s = time.monotonic()
    driving = ("--scenario", scenario, "--cycles", str(cycles), "--force")  # over the drive of an earlier demonstration
    await run(EMULATOR, "record", log, *driving, folder=place)
    analysis = ("analyze", log, "--json", "--vehicle", name, "--broker", broker, "--acknowledge", "backend")
    lines = (await run(SERVICE, *analysis, folder=place)).splitlines()
    count = len([line for line in lines if json.loads(line)["schema"] == "clutchdiag/shift/v1"])
    took_s = time.monotonic() - began_s
    console.print(f"vehicle   {name}: {fluid} fluid, {count} shifts recorded and analysed in {took_s:.0f} s")
    return count


async def _arrival(folder: Path, database: str, count: int) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not (await _backend(folder, "hash", database)).endswith(f"  {count} results\n"):
        if time.monotonic() > deadline_s:
            raise DemoError(f"not all of the {count} results arrived within {HANG_S:g} s")
        await asyncio.sleep(0.5)


async def _until(is_so: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not is_so():
        if time.monotonic() > deadline_s:
            raise DemoError(f"it took more than {HANG_S:g} s until {what}")
        await asyncio.sleep(LOOK_S)


async def _backend(folder: Path, command: str, database: str, *more: str) -> str:
    """Run a command of the backend and return what it said."""
    place = _subfolder(_subfolder(folder, "questions"), "-".join((command, *more[:1])))
    return await run(BACKEND, command, "--database", database, *more, folder=place)


def _subfolder(folder: Path, name: str) -> Path:
    path = folder / name
    path.mkdir(exist_ok=True)
    return path


async def _show_page(folder: Path, database: str, console: PeopleConsole, *, stays: bool) -> None:
    """Serve the page of a database and say what is to be seen there; it ``stays`` until somebody presses Ctrl-C."""
    command = ("serve", "--database", database, "--listen", f"{HOST}:{_page_port()}")
    async with program(BACKEND, *command, folder=folder) as server:
        address = (await anext(server.lines())).split()[0]
        size_bytes = len(await asyncio.to_thread(_answer, address))
        console.print(f"page      {address} answered with {size_bytes / 1e3:.0f} kB")
        console.print(
            f"look at   the worst first; {list(FLUIDS)[-1]}: its trend with bands and limits, and how far its "
            "fluid will go; an event of it: friction over slip; Alarms; Maintenance"
        )
        if stays:
            console.print("          Ctrl-C ends the page, the database and the broker")
            with suppress(asyncio.CancelledError):  # Ctrl-C is how this is meant to end
                await server.wait()
        else:
            console.print("          nobody sits at a terminal, so all of it ends now")


def _answer(address: str) -> bytes:
    """Return the page at an address; raises DemoError if the server does not answer with one."""
    place = urlsplit(address)
    connection = HTTPConnection(str(place.hostname), place.port, timeout=HANG_S)
    with closing(connection):
        try:
            connection.request("GET", place.path or "/")
            answer = connection.getresponse()
            page = answer.read()
        except (OSError, HTTPException) as exc:
            raise DemoError(f"the page at {address} does not answer: {exc}") from exc
    if answer.status != HTTPStatus.OK:
        raise DemoError(f"the page at {address} answers with status {answer.status}")
    return page


def _page_port() -> int:
    """Return the usual port, or 0 for any other if it is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, USUAL_PORT))
        except OSError:
            return 0
    return USUAL_PORT
