"""Options that several commands of the backend share. Needs no extra."""

from typing import Final

import click

from clutchdiag_io.command_line import FILE, VERBOSE, Choice, Option

PROGRAM: Final = "fleet-backend"
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
GROUP_VARIABLE: Final = "CLUTCHDIAG_GROUP"
MAIL_VARIABLE: Final = "CLUTCHDIAG_MAIL"
DATABASE_VARIABLE: Final = "CLUTCHDIAG_DATABASE"


def count(text: str | int) -> int:
    """Return how many lines are wanted; databases differ in what a negative number means."""
    if not str(text).isdecimal():
        raise ValueError(f"must be a count, got {text}")
    return int(text)


COMMON: Final = (
    Option(
        "--database URL",
        f"postgresql://[user@]host[:port]/NAME or sqlite:///FILE (default: the environment's"
        f" {DATABASE_VARIABLE}, else an SQLite file in the user's state directory)",
        envvar=DATABASE_VARIABLE,
    ),
    VERBOSE,
)
METRICS: Final = Option("--metrics ADDRESS", "serve metrics for Prometheus at HOST:PORT, a loopback address")
QUESTION: Final = (
    *COMMON,
    Option("--json", "one JSON object per line"),
    Option("--width N", "columns to fit a table into (default: the terminal's, in a pipe any)", count),
)
VEHICLE: Final = click.Argument(["vehicle"], metavar="VEHICLE", help="vehicle id")
CLUTCH: Final = Choice([1, 2])
BROKER: Final = (
    Option(
        "--broker URL",
        f"mqtt[s]://[user[:password]@]host[:port], MQTT 5 (default: the environment's {BROKER_VARIABLE})",
        envvar=BROKER_VARIABLE,
    ),
    Option("--ca FILE", "certificate authority of an mqtts:// broker", FILE),
    Option("--cert FILE", "our certificate, for mutual TLS", FILE),
    Option("--key FILE", "its private key", FILE),
)
