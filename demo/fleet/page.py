"""The fleet's page at the end: where it is, what to look at, and for how long."""

import asyncio
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

from rich.console import Console

from demo.errors import DemoError
from demo.programs import Program, program

BACKEND: Final = "fleet_backend"
HOST: Final = "127.0.0.1"
USUAL_PORT: Final = 8090
START_S: Final = 60.0


async def show_page(folder: Path, database: str, worst: str, console: Console, *, stays: bool) -> None:
    """Serve the page of a database and say what is to be seen there; it ``stays`` until somebody presses Ctrl-C.

    Raises
    ------
    DemoError
        If it does not start.
    """
    command = ("serve", "--database", database, "--listen", f"{HOST}:{_port()}")
    async with program(BACKEND, *command, folder=folder, environment={}) as server:
        address = await _address(server)
        console.print(f"page      {address}", highlight=False)
        console.print(
            f"look at   the worst first; {worst}: its trend with bands and limits, and how far its fluid will go;"
            " an event of it: friction over slip; Alarms; Changes"
        )
        if stays:
            console.print("          Ctrl-C ends the page, the database and the broker")
            with suppress(asyncio.CancelledError):  # Ctrl-C is how this is meant to end
                await server.wait()
        else:
            console.print("          nobody sits at a terminal, so all of it ends now")


async def _address(server: Program) -> str:
    """Return where the server says that it is."""
    deadline_s = time.monotonic() + START_S
    while not server.output.endswith("\n"):
        if server.has_ended or time.monotonic() > deadline_s:
            raise DemoError(f"the page does not start: {server.last_words}")
        await asyncio.sleep(0.05)
    return server.output.split()[0]


def _port() -> int:
    """Return the usual port, or 0 for any other if it is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, USUAL_PORT))
        except OSError:
            return 0
    return USUAL_PORT
