"""Command line of the demonstration: ``python -m demo``."""

import argparse
import asyncio
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from demo.errors import DemoError, ExtraMissingError, check_extra

if TYPE_CHECKING:
    from rich.console import Console

    from demo.runner import DemoOptions

PROGRAM: Final = "demo"
DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"
NARROWEST: Final = 110  # columns; a pipe has none of its own
STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return 0 as it must be, 1 not so, 2 usage or a missing extra, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        check_extra("demo")
        return _run(options)
    except ExtraMissingError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE
    except KeyboardInterrupt:
        sys.stderr.write(f"{PROGRAM}: interrupted\n")
        return INTERRUPTED


def _run(options: argparse.Namespace) -> int:
    from rich.console import Console  # noqa: PLC0415 - heavy libraries load inside the reach of the handler above

    from demo.runner import DemoOptions  # noqa: PLC0415 - see above
    from diag_service.errors import ConfigError  # noqa: PLC0415 - see above
    from diag_service.settings.config import check_vehicle  # noqa: PLC0415 - see above
    from fleet_link import AddressError, parse_broker  # noqa: PLC0415 - see above

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=max(console.width, NARROWEST))
    try:
        demo = DemoOptions(
            scenario=options.scenario,
            seed=options.seed,
            cycles=options.cycles,
            broker=parse_broker(options.broker) if options.broker else None,
            broker_url=options.broker,
            vehicle=check_vehicle(options.vehicle),
            folder=options.output,
        )
        return asyncio.run(_interruptible(demo, console))
    except (ConfigError, AddressError) as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE
    except DemoError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return FAILED


async def _interruptible(options: "DemoOptions", console: "Console") -> int:
    """Run the demonstration so that a signal ends it in order, its children included."""
    from demo.runner import run_demo  # noqa: PLC0415 - see above

    loop = asyncio.get_running_loop()
    work = asyncio.create_task(run_demo(options, console))
    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, work.cancel)
    try:
        return await work
    except asyncio.CancelledError:
        console.print()
        raise KeyboardInterrupt from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}",
        description="Drives one shift cycle in real time and diagnoses it, as two programs on one bus.",
        epilog="exit status: 0 as it must be, 1 not so, 2 usage or an extra that is not installed, 130 interrupted",
    )
    parser.add_argument("--scenario", default="ideal", metavar="NAME|FILE", help="what is driven (default: ideal)")
    parser.add_argument("--seed", type=int, metavar="N", help="another car, another drive")
    parser.add_argument(
        "--cycles", type=_positive, default=1, metavar="N", help="40 s and ten shifts each (default: 1)"
    )
    parser.add_argument(
        "--broker",
        default=os.environ.get(BROKER_VARIABLE),
        metavar="URL",
        help=f"mqtt://[user[:password]@]host[:port] (default: {BROKER_VARIABLE} of the environment, else our own)",
    )
    parser.add_argument(
        "--vehicle", default="demo", metavar="ID", help="must differ between demos on one broker (default: demo)"
    )
    parser.add_argument("--output", type=Path, default=Path("demo-output"), metavar="DIR", help="default: demo-output")
    return parser


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, got {text}")
    return number


if __name__ == "__main__":
    sys.exit(main())
