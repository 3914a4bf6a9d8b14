"""The programs as child processes: their output in files, their end in order; and what stops a demonstration."""

import asyncio
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Coroutine, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Final

EMULATOR, SERVICE, BACKEND = "ecu_emulator", "diag_service", "fleet_backend"
DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130
HOST: Final = "127.0.0.1"
LOOK_S: Final = 0.05
HANG_S: Final = 900.0  # for what must happen: no machine is so busy that it takes longer, only a hang does
STOP_S: Final = 15.0  # the service gives its broker five seconds at the end
HURRY_S: Final = 1.0  # for a program that leaves nothing behind: it may be amid a kernel that takes ten to compile
OWN_GROUP: Final = 0  # of processes: a terminal's Ctrl-C reaches the demonstration alone, which ends its children
STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
EXTRA_OF: Final = {
    **dict.fromkeys(("amqtt", "matplotlib", "doipclient", "isotp", "udsoncan"), ".[demo]"),
    **dict.fromkeys(("starlette", "uvicorn"), "./fleet[page]"),
}
_OWN_VARIABLES: Final = ("CAN_", "CLUTCHDIAG_")  # the user's bus and broker are not the demonstration's


class DemoError(Exception):
    """The demonstration cannot go on; the text says why."""


class ExtraMissingError(DemoError):
    """A library that only an extra brings is not installed."""


def check_extra(extra: str) -> None:
    """Raise ExtraMissingError unless the libraries of an extra can be found."""
    for module, name in EXTRA_OF.items():
        if name == extra and find_spec(module) is None:
            raise ExtraMissingError(f"the module {module} is not installed: pip install '{extra}' in the checkout")


def to_its_end(name: str, work: Coroutine[None, None, int]) -> int:
    """Return the exit status of a demonstration; a signal ends it in order, servers and children included."""

    async def interruptible() -> int:
        task = asyncio.ensure_future(work)
        for number in STOP_SIGNALS:
            asyncio.get_running_loop().add_signal_handler(number, task.cancel)
        return await task

    try:
        return asyncio.run(interruptible())
    except asyncio.CancelledError:
        sys.stderr.write(f"\n{name}: interrupted\n")
        return INTERRUPTED
    except DemoError as exc:
        sys.stderr.write(f"{name}: error: {exc}\n")
        return FAILED


@contextmanager
def foreground() -> Iterator[None]:
    """Be alone in the foreground of the terminal at standard input: its Ctrl-C does not reach ``make`` or children.

    ``make`` would end with 130 at a Ctrl-C, whatever becomes of what it runs.
    """
    before = os.tcgetpgrp(sys.stdin.fileno())
    is_alone = os.getpgrp() == os.getpid()
    if is_alone or before != os.getpgrp():  # the latter in the background, where no key reaches us
        yield
        return
    # To give the terminal back is a background's write; to stop at Ctrl-Z would leave the terminal to nobody.
    kept = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGTTOU, signal.SIGTSTP)}
    os.setpgid(0, 0)
    os.tcsetpgrp(sys.stdin.fileno(), os.getpgrp())
    try:
        yield
    finally:
        with suppress(OSError):  # the terminal is gone
            os.tcsetpgrp(sys.stdin.fileno(), before)
        for number, handler in kept.items():
            signal.signal(number, handler)


class Program:
    """A running child; standard output goes to ``NAME.out``, standard error to ``NAME.log``."""

    def __init__(self, module: str, folder: Path, process: asyncio.subprocess.Process, stop_s: float) -> None:
        self._stop_s = stop_s
        self.name = module.replace("_", "-")
        self._out, self._log = output_files(module, folder)
        self._process = process

    @property
    def has_ended(self) -> bool:
        """Whether it runs no more."""
        return self._process.returncode is not None

    @property
    def output(self) -> str:
        """Standard output until now."""
        return self._out.read_text(encoding="utf-8")

    @property
    def last_words(self) -> str:
        """The last line of standard error."""
        return last_line(self._log)

    async def lines(self) -> AsyncIterator[str]:
        """Yield the lines of standard output as they come; raises DemoError when the program has ended."""
        count = 0
        while self._process.returncode is None:
            told = self.output.split("\n")[:-1]
            for line in told[count:]:
                yield line
            count = len(told)
            await asyncio.sleep(LOOK_S)
        raise DemoError(f"{self.name} ended before its time: {self.last_words}")

    async def finish(self) -> None:
        """Ask the program to end, and return when it has ended well; raises DemoError if it ended badly."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)
        await self.wait()

    async def wait(self) -> None:
        """Return when the program has ended well; raises DemoError with its last words if it ended badly."""
        status = await self._process.wait()
        if status != 0:
            raise DemoError(f"{self.name} ended with status {status}: {self.last_words}")

    async def stop(self) -> None:
        """Ask the program to end, and make it if it does not or if we cannot wait."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)
        try:
            async with asyncio.timeout(self._stop_s):
                await self._process.wait()
        except (TimeoutError, asyncio.CancelledError) as exc:
            with suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()
            if isinstance(exc, asyncio.CancelledError):
                raise


@asynccontextmanager
async def program(
    module: str,
    *arguments: str | Path,
    folder: Path,
    environment: Mapping[str, str] | None = None,
    stdin: int = asyncio.subprocess.DEVNULL,
    stdout: int | None = None,
    stop_s: float = STOP_S,
) -> AsyncIterator[Program]:
    """Start a module as a program, with ends of pipes where they are given; it does not outlive the block."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(_OWN_VARIABLES)}
    out_file, log_file = output_files(module, folder)
    with out_file.open("wb") as out, log_file.open("wb") as log:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", module, *map(str, arguments),
            stdin=stdin, stdout=out if stdout is None else stdout, stderr=log,
            env={**inherited, **(environment or {})}, process_group=OWN_GROUP,
        )  # fmt: skip
    child = Program(module, folder, process, stop_s)
    try:
        yield child
    finally:
        if process.returncode is None:
            await child.stop()


async def run(module: str, *arguments: str | Path, folder: Path) -> str:
    """Run a module as a program to its end and return what it printed; raises DemoError if it fails."""
    async with program(module, *arguments, folder=folder, stop_s=HURRY_S) as child:
        await child.wait()
        return child.output


def output_files(module: str, folder: Path) -> Sequence[Path]:
    """Return where standard output and standard error of a program go."""
    name = module.replace("_", "-")
    return folder / f"{name}.out", folder / f"{name}.log"


def last_line(log: Path) -> str:
    """Return what a program said last in its log, for people."""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else "it said nothing"


def free_port() -> int:
    """Return a port of the loopback interface that nobody uses now."""
    with socket.create_server((HOST, 0)) as probe:
        return int(probe.getsockname()[1])
