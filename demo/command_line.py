"""The command line of the demonstration."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from demo.programs import USAGE, ExtraMissingError, check_extra, to_its_end

PROGRAM: Final = "demo"
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"
SHIFTS: Final = 6  # three onto each clutch: enough for a verdict
NARROWEST: Final = 110  # columns; a pipe has none of its own


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return 0 as it must be, 1 not so, 2 usage or a missing extra, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        check_extra(".[demo]")
    except ExtraMissingError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE
    from rich.console import Console  # noqa: PLC0415 - what an extra brings is there

    from demo.runner import DemoOptions, run_demo  # noqa: PLC0415 - see above
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
            shifts=options.shifts,
            broker=parse_broker(options.broker) if options.broker else None,
            broker_url=options.broker,
            vehicle=check_vehicle(options.vehicle),
            folder=options.output,
            began_s=options.since,
        )
    except (ConfigError, AddressError) as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return USAGE
    return to_its_end(PROGRAM, run_demo(demo, console))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}",
        description="Drives and diagnoses in real time, two programs on one bus; beside it a fluid ages.",
        epilog="exit status: 0 as it must be, 1 not so, 2 usage or an extra that is not installed, 130 interrupted",
    )
    parser.add_argument("--scenario", default="ideal", metavar="NAME|FILE", help="what is driven (default: ideal)")
    parser.add_argument("--seed", type=int, metavar="N", help="another car, another drive")
    parser.add_argument(
        "--shifts", type=_positive, default=SHIFTS, metavar="N", help="on the bus, 4 s each (default: %(default)s)"
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
    parser.add_argument(
        "--since", type=float, metavar="TIME", help="when a set-up began [s since 1970], to tell its time"
    )
    return parser


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, got {text}")
    return number
