"""Command line of the fleet demonstration: ``python -m demo.fleet``."""

import argparse
import asyncio
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from demo.errors import DemoError, ExtraMissingError, check_extra
from demo.fleet.runner import run_fleet

PROGRAM: Final = "fleet"
DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130
CYCLES: Final = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return 0 done, 1 failed, 2 usage or a missing extra, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        check_extra("fleet")
        check_extra("page")
        options.output.mkdir(parents=True, exist_ok=True)
        asyncio.run(_interruptible(options.output, options.cycles, Console(highlight=False), stays=sys.stdin.isatty()))
    except asyncio.CancelledError:
        sys.stderr.write(f"{PROGRAM}: interrupted\n")
        return INTERRUPTED
    except DemoError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE if isinstance(exc, ExtraMissingError) else FAILED
    return DONE


async def _interruptible(folder: Path, cycles: int, console: Console, *, stays: bool) -> None:
    """Run the demonstration so that a signal ends it in order, servers and children included."""
    work = asyncio.ensure_future(run_fleet(folder, cycles, console, stays=stays))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, work.cancel)
    await work


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


if __name__ == "__main__":
    sys.exit(main())
