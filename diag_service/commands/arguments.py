"""The words of the command line: which commands there are, and which options each takes. Imports next to nothing."""

from typing import Any, Final

import click

from clutchdiag_io.command_line import (
    FILE,
    FILE_OR_STORE,
    FLOAT,
    FORCE,
    INT,
    VERBOSE,
    Choice,
    Command,
    Group,
    Option,
    Program,
)
from clutchdiag_io.program import attached
from diag_service.settings.options import (
    BUS,
    CONFIG,
    DEFAULT_BITRATE,
    DELIVERY,
    JSON,
    MEANING,
    POLL,
    PROGRAM,
    VARIABLES,
)

DEFAULT_LIMIT_S: Final = 600.0  # an hour of a bus takes half a minute
_LAKE: Final = click.Argument(
    ["lake"], type=FILE_OR_STORE, metavar="LAKE", help="folder, or s3://BUCKET/PREFIX and such"
)
LAKE_OPTIONS: Final = (
    Option(
        "--lake PLACE",
        "make or continue a lake of Parquet files in this folder or store (s3://BUCKET/PREFIX and such); the logs may "
        "be in a store, too",
        FILE_OR_STORE,
    ),
    Option(
        "--scheduler ADDRESS",
        "who works for a lake: local, or the workers of tls://HOST:PORT, with --ca, --cert and --key (default: local)",
        default="local",
    ),
    Option(
        "--signals NAME,NAME...",
        "for a lake: decoded signals, too; Message.Signal or the signal alone, with * for anything",
    ),
    Option(
        "--time-limit S",
        f"for a lake: give up on a log after this time (default: {DEFAULT_LIMIT_S:g})",
        FLOAT,
        default=DEFAULT_LIMIT_S,
    ),
    Option("--retry", "for a lake: try again the logs that failed before"),
)
LAKE: Final = Group(
    "lake",
    "look after a lake of results",
    Command(
        "check",
        "show what is in a lake, and whether its manifest and its parts agree",
        _LAKE,
        Option("--repair", "remove parts of no log, as a killed run may leave; the next run makes missing ones"),
        VERBOSE,
        examples=(f"{PROGRAM} lake check s3://fleet/lake",),
    ),
    Command(
        "forget",
        "remove one vehicle from a lake and check that nothing is left",
        _LAKE,
        click.Argument(["vehicle"], metavar="VEHICLE", help="vehicle id"),
        *(JSON, VERBOSE),
        description="Remove every part of one vehicle and its rows of the manifest, list them, and check again. Logs "
        "and copies elsewhere stay.",
        examples=(f"{PROGRAM} lake forget s3://fleet/lake car7",),
    ),
    metavar="ACTION",
)

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_SOURCE, EXIT_STORE, EXIT_INCOMPLETE = range(6)
EXIT_SIGNALLED = 128  # and the number of the signal, as a shell tells it
_EXIT_TEXT: Final = (
    "exit status: 0 done; 1 unexpected error; 2 usage, calibration, DBC or an extra that is not installed; "
    "3 bus, log or controller; 4 store; 5 a log is cut off and was not judged, or with --strict a log lost something "
    "or contributed nothing; 130 stopped early by SIGINT; 143 by SIGTERM. run and monitor end with 0 by a signal."
)
_FOLDERS: Final = (
    "Logs given by name are one drive, in order of time. A folder is many drives: each log in it, and in the folders "
    "below, is a drive of its own. With --output an interrupted run over a folder continues where it stopped, even "
    "after it was killed."
)


_JSON_LINES: Final = Option("--json", "JSON lines on standard output, text on standard error")
_DATABASE: Final = tuple(option for option in MEANING if option.name == "dbc")
_MATCH: Final = Option(
    "--match BY",
    "by what frames of 29 bits are known: what the database says, or group: all by their parameter group, as J1939 and "
    "NMEA 2000 have it (default: database)",
    Choice(["database", "group"]),
    default="database",
)
_COLUMNS: Final = Option(
    "--columns ROLES",
    "of a log that is a table: which column is which, time=Time,id=ID,data=D1-D8 by name or number, a unit or base "
    "behind a colon (time=3:ms, id=2:dec); besides length, channel, extended, remote, error, fd, brs, esi, direction "
    "(default: its header says)",
)
_LOG: Final = click.Argument(["log"], type=FILE, metavar="LOG", help="log file; - is standard input")


def _logs(text: str, kind: click.ParamType[Any] = FILE) -> click.Argument:
    return click.Argument(["logs"], nargs=-1, required=True, type=kind, metavar="LOG...", help=text)


def _output(text: str, *, required: bool = False) -> Option:
    return Option("-o --output FILE", text, FILE, required=required)


_RUN: Final = Command(
    "run",
    "diagnose a live bus",
    *(*BUS, *MEANING, CONFIG, *DELIVERY, *POLL, _JSON_LINES, VERBOSE),
    variables=VARIABLES,
    examples=(
        f"{PROGRAM} run -i socketcan -c can0 --vehicle car1",
        f"{PROGRAM} run -i socketcan -c can0 --vehicle car1 --poll 60 --active",
        f"{PROGRAM} run -i socketcan -c can0 --broker mqtts://car1@fleet.example --store car1.sqlite --metrics 9464",
        f"{PROGRAM} run --config car1.toml --json",
    ),
)
_MONITOR: Final = Command(
    "monitor",
    "show a live bus, store nothing",
    *(*BUS, *MEANING, CONFIG),
    VERBOSE,
    variables=VARIABLES,
    examples=(f"{PROGRAM} monitor -i socketcan -c can0 --duration 60",),
)
_CHECK: Final = Command(
    "check",
    "check the settings and print what a run would use, secrets masked",
    *(*BUS, *MEANING, CONFIG, *DELIVERY, *POLL, _JSON_LINES, VERBOSE),
    variables=VARIABLES,
    examples=(f"{PROGRAM} config check --config car1.toml",),
)
_ANALYZE: Final = Command(
    "analyze",
    "diagnose recorded logs, or folders of them",
    _logs("log file, or folder of log files; - is standard input", FILE_OR_STORE),
    Option(
        "--estimator",
        "impulse: the service's own; paper: the method of SAE 2015-01-1146, without uncertainty and verdict",
        Choice(["impulse", "paper"]),
        default="impulse",
    ),
    Option(
        "--strict",
        "stop at the first line or object that is not a frame, time jump or cut, and say where; end with status 5 "
        "if a log or a channel contributed nothing",
    ),
    _output("write the results to a .jsonl, .csv or .parquet file, too"),
    FORCE,
    Option("--jobs N", "drives of folders at a time (default: one per core)", INT),
    Option(
        "--vehicle-from",
        "path: in a folder, a log is of the vehicle by which the folder below is called (FOLDER/VEHICLE/...)",
        Choice(["path"]),
    ),
    *(*LAKE_OPTIONS, *MEANING, CONFIG, *DELIVERY, _COLUMNS, _JSON_LINES, VERBOSE),
    variables=VARIABLES,
    description=_FOLDERS,
    examples=(
        f"{PROGRAM} analyze drive.log",
        f"{PROGRAM} analyze monday.blf tuesday.blf --dbc car.dbc --calibration car1.toml --store car1.sqlite",
        f"{PROGRAM} analyze recordings -o results.parquet --jobs 4 --vehicle-from path",
        f"{PROGRAM} analyze s3://fleet/logs --lake s3://fleet/lake --scheduler tls://node1.example --ca ca.crt ...",
        f"candump -L can0 | {PROGRAM} analyze -",
    ),
)
_CALIBRATE: Final = Command(
    "calibrate",
    "find one vehicle's sensor errors and inertia from its logs",
    _logs("logs of one vehicle, a drive or more; - is standard input"),
    _output("calibration file to write (TOML)", required=True),
    FORCE,
    *(*MEANING, CONFIG),
    Option("--json", "JSON on standard output"),
    *(_COLUMNS, VERBOSE),
    variables=VARIABLES,
    examples=(f"{PROGRAM} calibrate monday.log tuesday.log --vehicle car1 -o car1.toml",),
)
_INSPECT: Final = Command(
    "inspect",
    "show what traffic a log holds",
    _logs("log file, or folder of files; - is standard input"),
    *(*_DATABASE, _MATCH),
    _COLUMNS,
    Option(
        "-b --bitrate BITRATE",
        f"bit rate for which the bus load is given [bit/s] (default: {DEFAULT_BITRATE})",
        INT,
        default=DEFAULT_BITRATE,
    ),
    *(JSON, VERBOSE),
    description="Show what traffic a log holds. A database names the messages; the shipped one also checks them.",
    examples=(
        f"{PROGRAM} inspect drive.blf --dbc car.dbc",
        f"candump -L -T 5000 can0 | {PROGRAM} inspect -",
    ),
)
_SIGNALS: Final = Command(
    "signals",
    "list the signals in a log and propose a profile",
    *(_LOG, *_DATABASE, _COLUMNS, VERBOSE),
    examples=(f"{PROGRAM} signals drive.blf --dbc car.dbc >car-profile.toml",),
)
_PREDICT: Final = Command(
    "predict",
    "predict shifts of logs from the others, and show how well it went",
    _logs("logs of one type of vehicle, frames or tables of signals; - is standard input"),
    *(option for option in MEANING if option.name in {"dbc", "profile"}),
    Option("--touch BAR", "touch point of the clutches in bar (default: the pressure in gear at standstill)", FLOAT),
    Option("--halves", "predict the second half from the first (default: each shift from all others)"),
    *(JSON, VERBOSE),
    description="Friction, up to a scale, is found in some shifts; given the pressures and the first speed of another, "
    "it predicts the course of engine speed while the clutch slips, with intervals. "
    "Needs engine speed, both clutch pressures, and speeds behind the clutches or ratios; no torque, no drawing.",
    examples=(f"{PROGRAM} predict drive-a.csv drive-b.csv --profile car.toml",),
)
_LEARN: Final = Command(
    "learn",
    "describe an unknown vehicle from its logs: gears, ratios, clutches, touch points, for a person to complete",
    _logs("logs of one vehicle, frames or tables of signals"),
    _output("description to write (TOML), for analyze --vehicle-file", required=True),
    FORCE,
    *(option for option in MEANING if option.name in {"dbc", "profile", "calibration"}),
    _COLUMNS,
    *(JSON, VERBOSE),
    description="Each value has its standard deviation and says whether it is from the log or assumed. Nothing is "
    "claimed that the logs do not tell.",
    examples=(f"{PROGRAM} learn drive-a.csv drive-b.csv --profile car.toml -o car1.toml",),
)
_TRANSMISSION: Final = Command(
    "transmission",
    "show what follows from the description of a transmission: ratios, and which element which gear change tells",
    click.Argument(
        ["file"],
        type=FILE,
        metavar="NAME|FILE",
        help="nominal, gs7, 8hp70, or a TOML file with a table [transmission]",
    ),
    *(JSON, VERBOSE),
    description="Levers are torques over that of the input. An element can be told from a change in which it slips "
    "and moves the input.",
    examples=(f"{PROGRAM} transmission 8hp70",),
)
_DECODE: Final = Command(
    "decode",
    "write the signals of logs as a table: Parquet, CSV, JSON lines or Arrow",
    _logs("log file; of several the frames are put in order of time; or folder of logs; - is standard input"),
    _output(
        "folder for a table of each message; or one table: .parquet, .csv, .jsonl or .arrows; - is standard output",
        required=True,
    ),
    FORCE,
    Option(
        "--format",
        "whatever the name of the output says (default of standard output: csv; of a folder: parquet)",
        Choice(["parquet", "csv", "jsonl", "arrow"]),
    ),
    *(*_DATABASE, _MATCH),
    _COLUMNS,
    Option(
        "--layout",
        "messages: a table per message, in a folder; wide: a row per frame, a column per signal "
        "(default: messages where the output is a folder, wide where it is one table)",
        Choice(["messages", "wide"]),
    ),
    Option(
        "--values",
        "values that the database names: as numbers, as texts in a column beside, or both (default: numbers)",
        Choice(["numbers", "texts", "both"]),
        default="numbers",
    ),
    Option(
        "--signals NAME,NAME...",
        "only these: Message.Signal or the signal alone, both with * for anything (default: all)",
    ),
    Option(
        "--from TIME", "only what is not before: seconds from the first frame, or a time as 2026-01-01T12:30:00 (UTC)"
    ),
    Option("--to TIME", "only what is before; the log is read no further"),
    Option("--jobs N", "tables of a folder at a time (default: one per core)", INT),
    Option("--strict", "end with status 5 if anything of the log is not in the file, and say what"),
    *(JSON, VERBOSE),
    examples=(
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o drive",
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o drive.parquet",
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o part.csv --signals 'EngineSpeed,Brake.*' --from 60 --to 90",
        f"{PROGRAM} decode front.blf rear.blf --dbc car.dbc -o both.parquet",
        f"{PROGRAM} decode recordings --dbc car.dbc -o tables --jobs 4",
        f"candump -L can0 | {PROGRAM} decode - --dbc car.dbc -o - --format jsonl",
    ),
)
_STORE: Final = click.Argument(
    ["store"], type=FILE, metavar="STORE", help="store of results, as run and analyze make it"
)
_VEHICLE: Final = Option("--vehicle ID", "whose results (default: the only vehicle in the store)")
_REPORT: Final = Command(
    "report",
    "write the findings of logs or a store as one HTML page",
    click.Argument(
        ["logs"],
        nargs=-1,
        required=True,
        type=FILE,
        metavar="LOG...|STORE",
        help="logs of a drive, - is standard input; or a store",
    ),
    _output("HTML file to write; PDF where its name ends so", required=True),
    Option("--full", "after the sheet everything else: numbers, single shifts, data quality, events"),
    FORCE,
    *(*MEANING, CONFIG, _COLUMNS, VERBOSE),
    variables=VARIABLES,
    description="Write the findings as one HTML page that needs no network. It has what to do, friction over slip, "
    "trend, single shifts (of logs), quality of the data, and what was not seen and why.",
    examples=(
        f"{PROGRAM} report drive.log -o report.html",
        f"{PROGRAM} report car1.sqlite -o car1.html --calibration car1.toml",
    ),
)
_HISTORY: Final = Command(
    "history",
    "show how the friction of each clutch went",
    _STORE,
    _VEHICLE,
    Option("--clutch", "only this clutch", Choice([1, 2])),
    Option("--rows N", "events per clutch in the table, evenly spread (default: 20)", INT, default=20),
    Option("--calibration FILE", "that made the results (TOML; default: nominal)", FILE),
    Option("--peers FILE", "begin prognoses with what a fleet taught: fleet-backend peers --write", FILE),
    Option("--json", "JSON lines on standard output: every event, then the fluid fills"),
    VERBOSE,
    examples=(f"{PROGRAM} history car1.sqlite", f"{PROGRAM} history car1.sqlite --clutch 2 --json"),
)
_SHOW: Final = Command(
    "show",
    "show all that a store holds of one shift",
    _STORE,
    click.Argument(["shift"], type=INT, metavar="SHIFT", help="its number in the table of history"),
    *(JSON, VERBOSE),
    examples=(f"{PROGRAM} show car1.sqlite 17",),
)
_FLUID_CHANGED: Final = Command(
    "fluid-changed",
    "note that the vehicle got new fluid",
    *(_STORE, _VEHICLE),
    Option("--at DATE", "when, ISO 8601, UTC without a zone (default: now)"),
    Option("--odometer KM", "reading of the odometer [km]", FLOAT),
    Option("--product NAME", "name of the fluid"),
    Option("--note TEXT", "a note to keep with it"),
    Option(
        "--insist", "note an odometer that does not fit to the results, as after a change of the instrument cluster"
    ),
    Option("--undo", "take back the last fill, or the one within a day of --at: it was noted by mistake"),
    VERBOSE,
    description="Note that the vehicle got new fluid. The shifts after that begin a new baseline; what is known of "
    "sensors and lining stays. A service that is running takes it up before its next shift.",
    examples=(
        f"{PROGRAM} fluid-changed car1.sqlite --at 2026-01-31 --odometer 61200 --product DCTF-II",
        f"{PROGRAM} fluid-changed car1.sqlite --undo",
    ),
)
COMMAND_LINE: Final = Program(
    PROGRAM,
    "Diagnoses wet dual clutches from their CAN traffic, shift by shift.",
    _EXIT_TEXT,
    _RUN,
    _MONITOR,
    Group("config", "look at the settings", _CHECK, metavar="ACTION"),
    *(_ANALYZE, _REPORT, _HISTORY, _SHOW, _FLUID_CHANGED),
    *(_CALIBRATE, _INSPECT, _SIGNALS, _DECODE, _PREDICT, _LEARN, _TRANSMISSION),
    *attached("diag_service.commands").values(),
    LAKE,
)
