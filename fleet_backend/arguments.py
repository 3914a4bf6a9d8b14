"""The words of the command line: which commands there are, and which options each takes. Needs no extra."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Final

import click

from clutchdiag_io.command_line import FILE, FLOAT, INT, VERBOSE, Choice, Command, Option, Program, parse
from fleet_backend.choices import Axis, Pace

PROGRAM: Final = "fleet-backend"
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
GROUP_VARIABLE: Final = "CLUTCHDIAG_GROUP"
MAIL_VARIABLE: Final = "CLUTCHDIAG_MAIL"
DATABASE_VARIABLE: Final = "CLUTCHDIAG_DATABASE"

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_BROKER, EXIT_DATABASE, EXIT_UNKNOWN = range(6)
_EXIT_TEXT: Final = (
    "exit status: 0 done, stopped, or the reader closed the pipe; 1 unexpected error; 2 usage or an extra that is not "
    "installed; 3 broker; 4 database; 5 unknown vehicle"
)
_QUARANTINE_LIMIT: Final = 50
DEFAULT_SERVICE_KM: Final = 15_000
DEFAULT_SILENCE_DAYS: Final = 14
DEFAULT_LISTEN: Final = "127.0.0.1:8090"
_AHEAD_MONTHS: Final = 3
_PACE: Final = Pace()


def _count(text: str | int) -> int:
    """Return how many lines are wanted; databases differ in what a negative number means."""
    if not str(text).isdecimal():
        raise ValueError(f"must be a count, got {text}")
    return int(text)


_COMMON: Final = (
    Option(
        "--database URL",
        f"postgresql://[user@]host[:port]/NAME or sqlite:///FILE (default: the environment's"
        f" {DATABASE_VARIABLE}, else an SQLite file in the user's state directory)",
        envvar=DATABASE_VARIABLE,
    ),
    VERBOSE,
)
_QUESTION: Final = (
    *_COMMON,
    Option("--json", "one JSON object per line"),
    Option("--width N", "columns to fit a table into (default: the terminal's, in a pipe any)", _count),
)
_VEHICLE: Final = click.Argument(["vehicle"], metavar="VEHICLE", help="vehicle id")
_CLUTCH: Final = Choice([1, 2])
_BROKER: Final = (
    Option(
        "--broker URL",
        f"mqtt[s]://[user[:password]@]host[:port], MQTT 5 (default: the environment's {BROKER_VARIABLE})",
        envvar=BROKER_VARIABLE,
    ),
    Option("--ca FILE", "certificate authority of an mqtts:// broker", FILE),
    Option("--cert FILE", "our certificate, for mutual TLS", FILE),
    Option("--key FILE", "its private key", FILE),
)
_INGEST: Final = Command(
    "ingest",
    "take results from the broker into the database, until stopped",
    *_COMMON,
    Option(
        "--broker URL",
        "mqtt[s]://[user[:password]@]host[:port], MQTT 5, or nats[+tls]://... with JetStream"
        f" (default: the environment's {BROKER_VARIABLE})",
        envvar=BROKER_VARIABLE,
    ),
    *_BROKER[1:],
    Option("--worker NAME", "unique name of this worker (default: generated)"),
    Option(
        "--group NAME",
        "of workers that share what an MQTT broker sends; better a secret that no vehicle can guess"
        f" (default: the environment's {GROUP_VARIABLE}, else ingest)",
        default="ingest",
        envvar=GROUP_VARIABLE,
    ),
    Option("--alive FILE", "touch this file every 5 s while broker and database answer", FILE),
    Option("--batch N", f"results per transaction (default: {_PACE.batch_size})", INT, default=_PACE.batch_size),
    Option(
        "--patience MS",
        f"how long the first message of a batch waits for others (default: {_PACE.patience_s * 1000.0:g})",
        FLOAT,
        default=_PACE.patience_s * 1000.0,
    ),
    Option(
        "--no-bundles", "ask vehicles to send each result in a message of its own, for other readers of the topic shift"
    ),
    examples=(
        f"{PROGRAM} ingest --broker mqtts://fleet@broker.example --database postgresql://fleet@db.example/fleet",
    ),
)
_TABLE: Final = Command(
    "table",
    "show the running condition of every clutch, the worst first",
    *_QUESTION,
    Option("--limit N", "show only the N worst", _count),
    examples=(f"{PROGRAM} table --limit 10",),
)
_TREND: Final = Command(
    "trend",
    "show how the friction of a clutch went",
    _VEHICLE,
    click.Argument(["clutch"], type=_CLUTCH, metavar="CLUTCH", help="1 or 2"),
    *_QUESTION,
    Option(
        "--against",
        f"what the trend is shown over (default: {Axis.SHIFT})",
        Choice([axis.value for axis in Axis]),
        default=Axis.SHIFT.value,
    ),
    examples=(f"{PROGRAM} trend car1 2 --against odometer",),
)
_ALARMS: Final = Command(
    "alarms",
    "show or acknowledge alarms",
    *_QUESTION,
    Option("--all", "include cleared alarms"),
    Option(
        "--acknowledge VEHICLE",
        "acknowledge the latest alarm of its --clutch, or without --clutch what was kept aside on its topics",
    ),
    Option("--clutch", "whose alarm is acknowledged", _CLUTCH),
    Option("--by WHO", "who acknowledges (default: the user)"),
    Option("--note TEXT", "a note to keep with it"),
    examples=(
        f"{PROGRAM} alarms --all --json",
        f"{PROGRAM} alarms --acknowledge car1 --clutch 2 --note 'fluid is on order'",
    ),
)
_QUARANTINE: Final = Command(
    "quarantine",
    "show or forget messages that could not be used",
    *_QUESTION,
    Option("--limit N", f"show only the N latest (default: {_QUARANTINE_LIMIT})", _count, default=_QUARANTINE_LIMIT),
    Option("--purge-days D", "delete messages older than D days instead", FLOAT),
    examples=(f"{PROGRAM} quarantine --purge-days 90",),
)
_PEERS: Final = Command(
    "peers",
    "learn how fluids of each type usually age, and show which lots age faster than others",
    *_QUESTION,
    Option("--keep", "keep what was learned as the next version: prognoses begin with it"),
    Option("--write FILE", "write what was learned as JSON, for diag-service history --peers", FILE),
    examples=(f"{PROGRAM} peers", f"{PROGRAM} peers --keep --write peers.json"),
)
_LOTS: Final = Command(
    "lots",
    "show properties that vehicles share, such as the lot of their fluid, or read them from a table",
    *_QUESTION,
    Option("--read FILE", "CSV with a column vehicle and one for each property; empty cells are forgotten", FILE),
    examples=(f"{PROGRAM} lots --read lots.csv", f"{PROGRAM} lots --json"),
)
_FILL: Final = Command(
    "fill",
    "note that a vehicle got new fluid",
    _VEHICLE,
    click.Argument(["product"], metavar="[PRODUCT]", required=False, help="name of the fluid"),
    *_COMMON,
    Option("--at DATE", "ISO 8601, UTC without a zone (default: now)"),
    Option("--odometer-km KM", "reading of the odometer", FLOAT),
    Option("--note TEXT", "a note to keep with it"),
    Option(
        "--insist", "note an odometer that does not fit to the results, as after a change of the instrument cluster"
    ),
    Option("--undo", "take back the last fill, or the one at --at: it was noted by mistake"),
    examples=(
        f"{PROGRAM} fill car1 DCTF-II --at 2026-01-31 --odometer-km 61200",
        f"{PROGRAM} fill car1 --undo",
    ),
)
_PARTITIONS: Final = Command(
    "partitions",
    "make the months in which a PostgreSQL database keeps results, and show all",
    *_QUESTION,
    Option("--ahead N", f"months ahead (default: {_AHEAD_MONTHS})", _count, default=_AHEAD_MONTHS),
    Option("--back N", "months back, for old results that may still arrive (default: 0)", _count, default=0),
    examples=(f"{PROGRAM} partitions --ahead 6",),
)
_ROLLUP: Final = Command(
    "rollup",
    "sum up the results so far by clutch and month",
    *_COMMON,
    examples=(f"{PROGRAM} rollup",),
)
_RETAIN: Final = Command(
    "retain",
    "sum up and forget old results; the last of each clutch stays",
    *_COMMON,
    Option("--months N", "whole months to keep besides this one", _count, required=True),
    examples=(f"{PROGRAM} retain --months 24",),
)
_SERVE: Final = Command(
    "serve",
    "show the fleet to browsers and programs, until stopped",
    *_COMMON,
    Option(
        "--listen ADDRESS",
        f"HOST:PORT to listen at, a loopback address unless --access is given; port 0 takes any free one"
        f" (default: {DEFAULT_LISTEN})",
        default=DEFAULT_LISTEN,
    ),
    Option(
        "--access FILE", "who may read and change what, by a login here or by a proxy with one (docs/page.md)", FILE
    ),
    examples=(f"{PROGRAM} serve", f"{PROGRAM} serve --listen 127.0.0.1:8090"),
)
_WATCH: Final = Command(
    "watch",
    "raise alarms by rules and deliver them, until stopped",
    *_COMMON,
    Option("--webhook URL", "post each alarm there, signed with the secret"),
    Option("--secret FILE", "secret that the receiver of the webhook knows, as Standard Webhooks has it", FILE),
    Option(
        "--mail URL",
        f"smtp[s]://[user[:password]@]host[:port] that sends e-mail (default: the environment's {MAIL_VARIABLE})",
        envvar=MAIL_VARIABLE,
    ),
    Option("--from ADDRESS", "sender of e-mail"),
    Option("--to ADDRESS", "who gets e-mail; may be given several times", multiple=True),
    Option("--mqtt", "publish each alarm on clutchdiag/alarms/v1/VEHICLE of the broker"),
    *_BROKER,
    Option(
        "--service-km KM",
        f"distance to the next service (default: {DEFAULT_SERVICE_KM})",
        FLOAT,
        default=float(DEFAULT_SERVICE_KM),
    ),
    Option(
        "--silence-days D",
        f"days without a result until an alarm is raised (default: {DEFAULT_SILENCE_DAYS})",
        FLOAT,
        default=float(DEFAULT_SILENCE_DAYS),
    ),
    Option("--once", "check everything once, deliver, and end"),
    examples=(
        f"{PROGRAM} watch --webhook https://hooks.example/fleet --secret webhook.secret",
        f"{PROGRAM} watch --mqtt --broker mqtts://fleet@broker.example",
        f"{PROGRAM} watch --mail smtp://mail.example --from fleet@example.org --to workshop@example.org --once",
    ),
)
_FOLLOW: Final = Command(
    "follow",
    "show what vehicles find as it arrives, until Ctrl-C; needs no database",
    click.Argument(["broker"], metavar="BROKER", help=f"mqtt[s]://[user[:password]@]host[:port]; -: {BROKER_VARIABLE}"),
    click.Argument(["vehicles"], nargs=-1, metavar="[VEHICLE...]", help="only these"),
    Option("--json", "one JSON object per line"),
    *_BROKER[1:],
    VERBOSE,
    examples=(f"{PROGRAM} follow mqtt://localhost", f"{PROGRAM} follow mqtts://fleet@broker.example car1 car2 --json"),
)
COMMAND_LINE: Final = Program(
    PROGRAM,
    "Keeps the results of a fleet and answers questions about it.",
    _EXIT_TEXT,
    _INGEST,
    Command(
        "migrate",
        "create the database, or bring it to the schema of this version",
        *_COMMON,
        examples=(f"{PROGRAM} migrate --database sqlite:///fleet.sqlite",),
    ),
    *(_FOLLOW, _TABLE, _TREND, _ALARMS, _PEERS, _LOTS, _QUARANTINE),
    Command("seen", "show when each vehicle was last heard from", *_QUESTION, examples=(f"{PROGRAM} seen --json",)),
    Command(
        "codes",
        "show the trouble codes that controllers report",
        *_QUESTION,
        examples=(f"{PROGRAM} codes", f"{PROGRAM} codes --json"),
    ),
    *(_FILL, _SERVE, _WATCH, _PARTITIONS, _ROLLUP, _RETAIN),
    Command(
        "hash",
        "show a hash of all results: equal results, equal hash, in any database",
        *_COMMON,
        examples=(f"{PROGRAM} hash",),
    ),
)


def parse_arguments(words: Sequence[str] | None) -> SimpleNamespace:
    """Return what a command line says; raises SystemExit after help or a complaint."""
    return parse(COMMAND_LINE, words)
