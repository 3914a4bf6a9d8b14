"""The words of the commands of the fleet office. Needs no extra."""

from typing import Final

from click import Choice

from clutchdiag_io.command_line import FILE, FLOAT, Command, Option
from fleet_backend.arguments import COMMON, METRICS, PROGRAM, QUESTION, VEHICLE, count

DEFAULT_SERVICE_KM: Final = 15_000
DEFAULT_SILENCE_DAYS: Final = 14
DEFAULT_LISTEN: Final = "127.0.0.1:8090"
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
    "--access FILE", "who may read and change what, behind a proxy that logs people in (docs/page.md)", FILE
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
    Option("--months N", "whole months to keep besides this one", count, required=True),
    examples=(f"{PROGRAM} retain --months 24",),
)
_FORGET: Final = Command(
    "forget",
    "delete all that is stored of a vehicle, and prove it by a second look",
    *QUESTION,
    VEHICLE,
    examples=(f"{PROGRAM} forget car2", f"{PROGRAM} forget car2 --json"),
)
COMMANDS: Final = (_ALARMS, _PEERS, _SERVE, _WATCH, _RETAIN, _FORGET)
