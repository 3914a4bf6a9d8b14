"""The words of the command line: which commands and options there are, some of several commands. Needs no extra."""

from typing import Final

import click

from clutchdiag_io.command_line import FILE, FLOAT, INT, VERBOSE, Choice, Command, Option, Program
from fleet_backend.choices import Pace, TrendAxis

PROGRAM: Final = "fleet-backend"
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
GROUP_VARIABLE: Final = "CLUTCHDIAG_GROUP"
DATABASE_VARIABLE: Final = "CLUTCHDIAG_DATABASE"
DEFAULT_SERVICE_KM: Final = 15_000
DEFAULT_SILENCE_DAYS: Final = 14
DEFAULT_LISTEN: Final = "127.0.0.1:8090"


COUNT: Final = click.IntRange(min=0)  # databases differ in what a negative number means
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
)
VEHICLE: Final = click.Argument(["vehicle"], metavar="VEHICLE", help="vehicle id")
CLUTCH: Final = Choice([1, 2])
_TLS: Final = (
    Option("--ca FILE", "certificate authority of an mqtts:// broker", FILE),
    Option("--cert FILE", "our certificate, for mutual TLS", FILE),
    Option("--key FILE", "its private key", FILE),
)


EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_BROKER, EXIT_DATABASE, EXIT_UNKNOWN = range(6)
_EXIT_TEXT: Final = (
    "exit status: 0 done, stopped, or the reader closed the pipe; 1 unexpected error; 2 usage or an extra that is not "
    "installed; 3 broker; 4 database; 5 unknown vehicle"
)
_QUARANTINE_LIMIT: Final = 50
_AHEAD_MONTHS: Final = 3
_PACE: Final = Pace()


_INGEST: Final = Command(
    "ingest",
    "take results from the broker into the database, until stopped",
    *COMMON,
    Option(
        "--broker URL",
        "mqtt[s]://[user[:password]@]host[:port], MQTT 5, or nats[+tls]://... with JetStream"
        f" (default: the environment's {BROKER_VARIABLE})",
        envvar=BROKER_VARIABLE,
    ),
    *_TLS,
    Option("--worker NAME", "unique name of this worker (default: generated)"),
    Option(
        "--group NAME",
        "of workers that share what an MQTT broker sends; better a secret that no vehicle can guess"
        f" (default: the environment's {GROUP_VARIABLE}, else ingest)",
        default="ingest",
        envvar=GROUP_VARIABLE,
    ),
    Option("--alive FILE", "touch this file every 5 s while broker and database answer", FILE),
    METRICS,
    Option("--batch N", f"results per transaction (default: {_PACE.batch_size})", INT, default=_PACE.batch_size),
    Option(
        "--patience MS",
        f"how long the first message of a batch waits for others (default: {_PACE.patience_s * 1000.0:g})",
        FLOAT,
        default=_PACE.patience_s * 1000.0,
    ),
    Option(
        "--quotas R,Q,MB",
        "what is taken of a vehicle in a day (UTC): results, unusable messages, megabytes; 0: any number. It keeps what"
        " is beyond (default: 100000,1000,500)",
        default="100000,1000,500",
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
    *QUESTION,
    Option("--limit N", "show only the N worst", COUNT),
    examples=(f"{PROGRAM} table --limit 10",),
)
_TREND: Final = Command(
    "trend",
    "show how the friction of a clutch went",
    VEHICLE,
    click.Argument(["clutch"], type=CLUTCH, metavar="CLUTCH", help="1 or 2"),
    *QUESTION,
    Option(
        "--against",
        f"what the trend is shown over (default: {TrendAxis.SHIFT})",
        Choice([axis.value for axis in TrendAxis]),
        default=TrendAxis.SHIFT.value,
    ),
    examples=(f"{PROGRAM} trend car1 2 --against odometer",),
)
_QUARANTINE: Final = Command(
    "quarantine",
    "show or forget messages that could not be used",
    *QUESTION,
    Option("--limit N", f"show only the N latest (default: {_QUARANTINE_LIMIT})", COUNT, default=_QUARANTINE_LIMIT),
    Option("--purge-days D", "delete messages older than D days instead", FLOAT),
    examples=(f"{PROGRAM} quarantine --purge-days 90",),
)
_FILL: Final = Command(
    "fill",
    "note that a vehicle got new fluid",
    VEHICLE,
    click.Argument(["product"], metavar="[PRODUCT]", required=False, help="name of the fluid"),
    *COMMON,
    Option("--at DATE", "ISO 8601, UTC without a zone (default: now)"),
    Option("--odometer-km KM", "reading of the odometer", FLOAT),
    Option("--note TEXT", "a note to keep with it"),
    Option(
        "--insist", "note an odometer that does not fit to the results, as after a change of the instrument cluster"
    ),
    Option("--undo", "take back the last fill, or the one within a day of --at: it was noted by mistake"),
    examples=(
        f"{PROGRAM} fill car1 DCTF-II --at 2026-01-31 --odometer-km 61200",
        f"{PROGRAM} fill car1 --undo",
    ),
)
_PARTITIONS: Final = Command(
    "partitions",
    "make the months in which a PostgreSQL database keeps results, and show all",
    *QUESTION,
    Option("--ahead N", f"months ahead (default: {_AHEAD_MONTHS})", COUNT, default=_AHEAD_MONTHS),
    Option("--back N", "months back, for old results that may still arrive (default: 0)", COUNT, default=0),
    examples=(f"{PROGRAM} partitions --ahead 6",),
)
_FOLLOW: Final = Command(
    "follow",
    "show what vehicles find as it arrives, until Ctrl-C; needs no database",
    click.Argument(["broker"], metavar="BROKER", help=f"mqtt[s]://[user[:password]@]host[:port]; -: {BROKER_VARIABLE}"),
    click.Argument(["vehicles"], nargs=-1, metavar="[VEHICLE...]", help="only these"),
    Option("--json", "one JSON object per line"),
    *_TLS,
    VERBOSE,
    examples=(f"{PROGRAM} follow mqtt://localhost", f"{PROGRAM} follow mqtts://fleet@broker.example car1 car2 --json"),
)
_ALARMS: Final = Command(
    "alarms",
    "show or acknowledge alarms that the watch raised",
    *QUESTION,
    Option("--all", "include cleared alarms"),
    Option(
        "--acknowledge VEHICLE",
        "acknowledge the open alarms of its --clutch, or without --clutch what was kept aside on its topics",
    ),
    Option("--clutch", "whose alarms are acknowledged; 0: those of the vehicle as a whole", Choice([0, 1, 2])),
    Option("--by WHO", "who acknowledges (default: the user)"),
    Option("--note TEXT", "a note to keep with it"),
    examples=(
        f"{PROGRAM} alarms --all --json",
        f"{PROGRAM} alarms --acknowledge car1 --clutch 2 --note 'fluid is on order'",
    ),
)
_PEERS: Final = Command(
    "peers",
    "learn how fluids of each type usually age",
    *QUESTION,
    Option("--keep", "keep what was learned as the next version: prognoses begin with it"),
    Option("--write FILE", "write what was learned as JSON, for diag-service history --peers", FILE),
    examples=(f"{PROGRAM} peers", f"{PROGRAM} peers --keep --write peers.json"),
)
_ACCESS: Final = Option(
    "--access FILE", "who may read and change what, behind a proxy that logs people in (docs/fleet.md)", FILE
)
_SERVE: Final = Command(
    "serve",
    "show the fleet to browsers and programs, until stopped",
    *COMMON,
    Option(
        "--listen ADDRESS",
        f"HOST:PORT to listen at, a loopback address unless --access is given; port 0 takes any free one"
        f" (default: {DEFAULT_LISTEN})",
        default=DEFAULT_LISTEN,
    ),
    _ACCESS,
    METRICS,
    examples=(f"{PROGRAM} serve", f"{PROGRAM} serve --listen 127.0.0.1:8090"),
)
_WATCH: Final = Command(
    "watch",
    "raise alarms by rules and deliver them, until stopped",
    *COMMON,
    Option(
        "--notify FILE",
        "tell each alarm at the address in this file, as apprise has it: mail, chat, webhook, MQTT; may be repeated",
        FILE,
        multiple=True,
    ),
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
    Option("--listen ADDRESS", "show the pages of serve there, too: both share one view of the fleet"),
    _ACCESS,
    METRICS,
    Option("--once", "judge each vehicle once, however long that takes, deliver, and end"),
    examples=(
        f"{PROGRAM} watch --notify workshop.url",
        f"{PROGRAM} watch --notify workshop.url --notify hook.url --once",
    ),
)
_RETAIN: Final = Command(
    "retain",
    "forget old results; the last of each clutch stays",
    *COMMON,
    Option("--months N", "whole months to keep besides this one", COUNT, required=True),
    examples=(f"{PROGRAM} retain --months 24",),
)
_FORGET: Final = Command(
    "forget",
    "delete all that is stored of a vehicle, and prove it by a second look",
    *QUESTION,
    VEHICLE,
    examples=(f"{PROGRAM} forget car2", f"{PROGRAM} forget car2 --json"),
)
COMMAND_LINE: Final = Program(
    PROGRAM,
    "Keeps the results of a fleet and answers questions about it.",
    _EXIT_TEXT,
    _INGEST,
    Command(
        "migrate",
        "create the database, or bring it to the schema of this version",
        *COMMON,
        examples=(f"{PROGRAM} migrate --database sqlite:///fleet.sqlite",),
    ),
    *(_FOLLOW, _TABLE, _TREND, _QUARANTINE),
    Command("seen", "show when each vehicle was last heard from", *QUESTION, examples=(f"{PROGRAM} seen --json",)),
    Command(
        "codes",
        "show the trouble codes that controllers report",
        *QUESTION,
        examples=(f"{PROGRAM} codes", f"{PROGRAM} codes --json"),
    ),
    *(_FILL, _PARTITIONS),
    *(_ALARMS, _PEERS, _SERVE, _WATCH, _RETAIN, _FORGET),
    Command(
        "hash",
        "show a hash of all results: equal results, equal hash, in any database",
        *COMMON,
        examples=(f"{PROGRAM} hash",),
    ),
)
