"""The two programs as child processes: their output in files, their end in order."""

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from demo.errors import DemoError

EMULATOR, SERVICE = "ecu_emulator", "diag_service"
STOP_S = 15.0  # the service gives its broker five seconds at the end
_OWN_VARIABLES = ("CAN_", "CLUTCHDIAG_")  # the user's bus and broker are not the demonstration's


class Program:
    """A running child; standard output goes to ``NAME.out``, standard error to ``NAME.log``."""

    def __init__(self, module: str, folder: Path, process: asyncio.subprocess.Process) -> None:
        self.name = module.replace("_", "-")
        self._out, self._log = output_files(module, folder)
        self._process = process

    @property
    def output(self) -> str:
        """Standard output until now."""
        return self._out.read_text(encoding="utf-8")

    @property
    def has_ended(self) -> bool:
        """Whether it runs no more."""
        return self._process.returncode is not None

    @property
    def last_words(self) -> str:
        """The last line of standard error."""
        words = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return words[-1] if words else "it said nothing"

    async def wait(self) -> None:
        """Return when the program has ended well.

        Raises
        ------
        DemoError
            If it ended badly, with its last words.
        """
        status = await self._process.wait()
        if status != 0:
            raise DemoError(f"{self.name} ended with status {status}: {self.last_words}")

    async def stop(self) -> None:
        """Ask the program to end, and make it if it does not or if we cannot wait."""
        self._send(signal.SIGINT)
        try:
            async with asyncio.timeout(STOP_S):
                await self._process.wait()
        except TimeoutError:
            self._send(signal.SIGKILL)
            await self._process.wait()
        except asyncio.CancelledError:
            self._send(signal.SIGKILL)
            raise

    def _send(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            self._process.send_signal(number)


@asynccontextmanager
async def program(
    module: str, *arguments: str | Path, folder: Path, environment: Mapping[str, str]
) -> AsyncIterator[Program]:
    """Start a module as a program; it does not outlive the block."""
    command = [sys.executable, "-m", module, *(str(argument) for argument in arguments)]
    out_file, log_file = output_files(module, folder)
    with out_file.open("wb") as out, log_file.open("wb") as log:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=out,
            stderr=log,
            env=_child_environment(environment),
        )
    child = Program(module, folder, process)
    try:
        yield child
    finally:
        if process.returncode is None:
            await child.stop()


async def run(module: str, *arguments: str | Path, folder: Path, environment: Mapping[str, str]) -> None:
    """Run a module as a program to its end; raises DemoError if it fails."""
    async with program(module, *arguments, folder=folder, environment=environment) as child:
        await child.wait()


def output_files(module: str, folder: Path) -> Sequence[Path]:
    """Return where standard output and standard error of a program go."""
    name = module.replace("_", "-")
    return folder / f"{name}.out", folder / f"{name}.log"


def _child_environment(more: Mapping[str, str]) -> dict[str, str]:
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(_OWN_VARIABLES)}
    return {**inherited, **more}
