"""The command line of the service: commands with their options; errors to one line and an exit status."""

import logging
import signal
import sys
from collections.abc import Sequence
from typing import Any, Final

import click

from canlog.errors import DefinitionError, ExtraMissingError, InputLeftError, OutputError, SourceError
from clutchdiag_io.command_line import CONTEXT, DISTRIBUTION, FILE, FILE_OR_STORE, examples, force_option, together
from clutchdiag_io.command_line import run as run_command_line
from clutchdiag_io.program import Kinds, attached, complain, reckon_in_one_thread
from diag_service.commands.options import (
    PROGRAM,
    bus_options,
    calibration_option,
    config_option,
    dbc_option,
    delivery_options,
    json_option,
    logs_argument,
    meaning_options,
    output_option,
    poll_options,
    profile_option,
    setting,
    working,
)
from diag_service.errors import ConfigError, ControllerError, IncompleteError, StoppedError, StoreError
from diag_service.stopping import Controls, Trigger, ignore

ENDED_BY_SIGNALS: Final = ("run", "monitor")  # as a rule
COUNTS_WANTED: Final = tuple(number for number in signal.Signals if number.name == "SIGUSR1")  # POSIX alone has it
EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_SOURCE, EXIT_STORE, EXIT_INCOMPLETE = range(6)
EXIT_SIGNALLED: Final = 128  # and the number of the signal, as a shell tells it
DEFAULT_LIMIT_S: Final = 600.0  # an hour of a bus takes half a minute
_EXIT_TEXT: Final = (
    "exit status: 0 done; 1 unexpected error; 2 usage, calibration, DBC or an extra that is not installed; "
    "3 bus, log or controller; 4 store; 5 a log is cut off and was not judged, or with --strict a log lost something "
    "or contributed nothing; 130 stopped early by SIGINT; 143 by SIGTERM. run and monitor end with 0 by a signal."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the service and return its exit status."""
    reckon_in_one_thread()
    controls = Controls()
    controls.stop.listen_to(signal.SIGINT, signal.SIGTERM)
    controls.counts_wanted.listen_to(*COUNTS_WANTED)
    try:
        return run_command_line(command_line, arguments, controls)
    except (StoppedError, InputLeftError) as exc:
        words = sys.argv[1:] if arguments is None else arguments
        return _end_early(exc, controls.stop, is_usual=words[0] in ENDED_BY_SIGNALS)
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        is_verbose = logging.getLogger("diag_service").isEnabledFor(logging.INFO)
        return complain(PROGRAM, exc, _statuses(), is_verbose=is_verbose, hint=" (-v shows where)")
    finally:
        if arguments is None:  # a signal while the interpreter winds down must not change the exit status
            ignore(signal.SIGINT, signal.SIGTERM, *COUNTS_WANTED)


def _statuses() -> Sequence[tuple[Kinds, int]]:
    """Return the exit status of each kind of error."""
    from clutch_model.errors import CalibrationError

    return (
        ((ConfigError, CalibrationError, DefinitionError, ExtraMissingError), EXIT_CONFIG),
        ((SourceError, ControllerError), EXIT_SOURCE),
        ((StoreError, OutputError), EXIT_STORE),
        (IncompleteError, EXIT_INCOMPLETE),
    )


def _end_early(exc: Exception, stop: Trigger, *, is_usual: bool) -> int:
    """Say that a run was stopped and return the exit status; a reader that hung up wants to hear no more."""
    if stop.signal is None:
        return EXIT_OK
    sys.stderr.write(f"{PROGRAM}: {exc}\n")
    return EXIT_OK if is_usual else EXIT_SIGNALLED + stop.signal


_json_lines_option = click.option("--json", is_flag=True, help="JSON lines on standard output, text on standard error")
_vehicle_from_option = click.option(
    "--vehicle-from",
    type=click.Choice(["path"]),
    help="path: in a folder, a log is of the vehicle by which the folder below is called (FOLDER/VEHICLE/...)",
)
_match_option = click.option(
    "--match",
    metavar="BY",
    type=click.Choice(["database", "group"]),
    default="database",
    help="by what frames of 29 bits are known: as the database says, or all by their parameter group, as in J1939",
)
_columns_option = click.option(
    "--columns",
    metavar="ROLES",
    default="",
    help="of a log that is a table: which column is which, time=Time,id=ID,data=D1-D8 by name or number, a unit or "
    "base behind a colon (time=3:ms, id=2:dec); besides length, channel, extended, remote, error, fd, brs, esi, "
    "direction (default: its header says)",
)
_store_argument = click.argument(
    "store", type=FILE, metavar="STORE", help="store of results, as run and analyze make it"
)
_vehicle_option = click.option("--vehicle", metavar="ID", help="whose results (default: the only vehicle in the store)")
_lake_argument = click.argument(
    "place", type=FILE_OR_STORE, metavar="LAKE", help="folder, or s3://BUCKET/PREFIX and such"
)
_lake_options = together(
    click.option(
        "--lake",
        type=FILE_OR_STORE,
        help="make or continue a lake of Parquet in this folder or store (s3://BUCKET/PREFIX); logs may be in one, too",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        default="local",
        help="who works for a lake: local, or the workers of tls://HOST:PORT, with --ca, --cert and --key",
    ),
    click.option(
        "--signals",
        metavar="NAME,NAME...",
        help="for a lake: decoded signals, too; Message.Signal or the signal alone, with * for anything",
    ),
    click.option(
        "--time-limit",
        metavar="S",
        type=float,
        default=DEFAULT_LIMIT_S,
        help="for a lake: give up on a log after this time",
    ),
    click.option("--retry", is_flag=True, help="for a lake: try again the logs that failed before"),
)


@click.group(PROGRAM, epilog=_EXIT_TEXT, context_settings=CONTEXT, no_args_is_help=False)
@click.version_option(package_name=DISTRIBUTION, prog_name=PROGRAM, message="%(prog)s %(version)s")
def command_line() -> None:
    """Diagnose wet dual clutches from their CAN traffic, shift by shift."""


@command_line.command(
    epilog=examples(
        f"{PROGRAM} run -i socketcan -c can0 --vehicle car1",
        f"{PROGRAM} run -i socketcan -c can0 --vehicle car1 --poll 60 --active",
        f"{PROGRAM} run -i socketcan -c can0 --broker mqtts://car1@fleet.example --store car1.sqlite --metrics 9464",
        f"{PROGRAM} run --config car1.toml --json",
    )
)
@together(bus_options, meaning_options, config_option, delivery_options, poll_options)
@_json_lines_option
@working
def run(controls: Controls, **words: Any) -> None:
    """Diagnose a live bus."""
    from diag_service.commands.live import run
    from diag_service.settings.options import LiveOptions

    run(LiveOptions(**words), controls)


@command_line.command(epilog=examples(f"{PROGRAM} monitor -i socketcan -c can0 --duration 60"))
@together(bus_options, meaning_options, config_option)
@working
def monitor(controls: Controls, **words: Any) -> None:
    """Show a live bus, store nothing."""
    from diag_service.commands.live import monitor
    from diag_service.settings.options import LiveOptions

    monitor(LiveOptions(**words), controls)


@command_line.group(subcommand_metavar="ACTION ...", no_args_is_help=False)
def config() -> None:
    """Look at the settings."""


@config.command(epilog=examples(f"{PROGRAM} config check --config car1.toml"))
@together(bus_options, meaning_options, config_option, delivery_options, poll_options)
@working
def check(_controls: Controls, **words: Any) -> None:
    """Check the settings and print what a run would use, secrets masked."""
    from diag_service.commands.live import check
    from diag_service.settings.options import LiveOptions

    check(LiveOptions(**words))


@command_line.command(
    epilog=examples(
        f"{PROGRAM} analyze drive.log",
        f"{PROGRAM} analyze monday.blf tuesday.blf --dbc car.dbc --calibration car1.toml --store car1.sqlite",
        f"{PROGRAM} analyze recordings -o results.parquet --jobs 4 --vehicle-from path",
        f"{PROGRAM} analyze s3://fleet/logs --lake s3://fleet/lake --scheduler tls://node1.example --ca ca.crt ...",
        f"candump -L can0 | {PROGRAM} analyze -",
    )
)
@logs_argument("log file, or folder of log files; - is standard input", kind=FILE_OR_STORE)
@click.option(
    "--estimator",
    type=click.Choice(["impulse", "paper"]),
    default="impulse",
    help="impulse: the service's own; paper: the method of SAE 2015-01-1146, without uncertainty and verdict",
)
@click.option(
    "--strict",
    is_flag=True,
    help="stop at the first fault of a log, and say where; status 5 if a log or a channel contributed nothing",
)
@output_option("write the results to a .jsonl, .csv or .parquet file, too")
@force_option
@click.option("--jobs", type=int, help="drives of folders at a time (default: one per core)")
@_vehicle_from_option
@together(_lake_options, meaning_options, config_option, delivery_options, _columns_option, _json_lines_option)
@working
def analyze(controls: Controls, **words: Any) -> None:
    """Diagnose recorded logs, or folders of them.

    Logs given by name are one drive, in order of time. A folder is many drives: each log in it, and in the folders
    below, is a drive of its own. With --output an interrupted run over a folder continues where it stopped, even after
    it was killed.
    """
    from diag_service.commands.analyze import analyze
    from diag_service.settings.options import AnalyzeOptions

    source = click.get_current_context().get_parameter_source
    given = frozenset(name for name in words if source(name) is click.core.ParameterSource.COMMANDLINE)
    analyze(AnalyzeOptions(given=given, **words), controls)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} report drive.log -o report.html",
        f"{PROGRAM} report car1.sqlite -o car1.html --calibration car1.toml",
    )
)
@logs_argument("logs of a drive, - is standard input; or a store", "LOG...|STORE")
@output_option("HTML file to write; PDF where its name ends so", required=True)
@click.option(
    "--full", is_flag=True, help="after the sheet everything else: numbers, single shifts, data quality, events"
)
@together(force_option, meaning_options, config_option, _columns_option)
@working
def report(controls: Controls, **words: Any) -> None:
    """Write the findings of logs or a store as one HTML page.

    The page needs no network. It has what to do, friction over slip, trend, single shifts (of logs), quality of the
    data, and what was not seen and why.
    """
    from diag_service.commands.store import report
    from diag_service.settings.options import ReportOptions

    report(ReportOptions(**words), controls)


@command_line.command(
    epilog=examples(f"{PROGRAM} history car1.sqlite", f"{PROGRAM} history car1.sqlite --clutch 2 --json")
)
@_store_argument
@_vehicle_option
@click.option("--clutch", type=click.Choice([1, 2]), help="only this clutch")
@click.option("--rows", type=int, default=20, help="events per clutch in the table, evenly spread")
@click.option("--calibration", type=FILE, help="that made the results (TOML; default: nominal)")
@click.option("--peers", type=FILE, help="begin prognoses with what a fleet taught: fleet-backend peers --write")
@click.option("--json", is_flag=True, help="JSON lines on standard output: every event, then the fluid fills")
@working
def history(_controls: Controls, **words: Any) -> None:
    """Show how the friction of each clutch went."""
    from diag_service.commands.store import history
    from diag_service.settings.options import HistoryOptions

    history(HistoryOptions(**words))


@command_line.command(epilog=examples(f"{PROGRAM} show car1.sqlite 17"))
@_store_argument
@click.argument("shift", type=int, metavar="SHIFT", help="its number in the table of history")
@json_option
@working
def show(_controls: Controls, **words: Any) -> None:
    """Show all that a store holds of one shift."""
    from diag_service.commands.store import show

    show(**words)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} fluid-changed car1.sqlite --at 2026-01-31 --odometer 61200 --product DCTF-II",
        f"{PROGRAM} fluid-changed car1.sqlite --undo",
    )
)
@_store_argument
@_vehicle_option
@click.option("--at", metavar="DATE", help="when, ISO 8601, UTC without a zone (default: now)")
@click.option("--odometer", metavar="KM", type=float, help="reading of the odometer [km]")
@click.option("--product", metavar="NAME", help="name of the fluid")
@click.option("--note", help="a note to keep with it")
@click.option(
    "--insist",
    is_flag=True,
    help="note an odometer that does not fit to the results, as after a change of the instrument cluster",
)
@click.option(
    "--undo", is_flag=True, help="take back the last fill, or the one within a day of --at: it was noted by mistake"
)
@working
def fluid_changed(_controls: Controls, **words: Any) -> None:
    """Note that the vehicle got new fluid.

    The shifts after that begin a new baseline; what is known of sensors and lining stays. A service that is running
    takes it up before its next shift.
    """
    from diag_service.commands.store import fluid_changed
    from diag_service.settings.options import FluidOptions

    fluid_changed(FluidOptions(**words))


@command_line.command(epilog=examples(f"{PROGRAM} calibrate monday.log tuesday.log --vehicle car1 -o car1.toml"))
@logs_argument("logs of one vehicle, a drive or more; - is standard input")
@output_option("calibration file to write (TOML)", required=True)
@together(force_option, meaning_options, config_option)
@click.option("--json", is_flag=True, help="JSON on standard output")
@_columns_option
@working
def calibrate(controls: Controls, **words: Any) -> None:
    """Find one vehicle's sensor errors and inertia from its logs."""
    from diag_service.commands.learn import calibrate
    from diag_service.settings.options import LearnOptions

    calibrate(LearnOptions(**words), controls)


@command_line.command(
    epilog=examples(f"{PROGRAM} inspect drive.blf --dbc car.dbc", f"candump -L -T 5000 can0 | {PROGRAM} inspect -")
)
@logs_argument("log file, or folder of files; - is standard input")
@together(dbc_option, _match_option, _columns_option)
@click.option("-b", "--bitrate", type=int, default=500_000, help="bit rate for which the bus load is given [bit/s]")
@json_option
@working
def inspect(controls: Controls, **words: Any) -> None:
    """Show what traffic a log holds.

    A database names the messages; the shipped one also checks them.
    """
    from diag_service.commands.inspect import inspect
    from diag_service.settings.options import InspectOptions

    inspect(InspectOptions(**words), controls)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} signals drive.blf --dbc car.dbc >car-profile.toml",
        f"{PROGRAM} signals recordings --dbc hyundai.dbc --dbc vw.dbc",
        f"{PROGRAM} signals recordings --vehicle-from path --csv >vehicles.csv",
    )
)
@logs_argument("log file, - is standard input; of a folder, or of several logs, a row for each")
@setting(
    "--dbc",
    metavar="FILE[#BUS]",
    type=FILE,
    multiple=True,
    help="message database: DBC, KCD, ARXML or SYM (default: the shipped ones); of rows several, of which each log "
    "takes the one that fits",
)
@_vehicle_from_option
@click.option("--jobs", type=int, help="logs at a time, of rows (default: one per core)")
@click.option("--csv", is_flag=True, help="the rows as CSV on standard output")
@together(_columns_option, _json_lines_option)
@working
def signals(controls: Controls, **words: Any) -> None:
    """List the signals in a log and propose a profile; of a folder, show what each log can tell.

    A row has what kind of file it is, its tier, what that tells, what is missing for the next better one, and what to
    do next. What counts is what came on the bus, not what a profile names. A file that cannot be read is a row, too.
    """
    from diag_service.commands.inspect import signals
    from diag_service.settings.options import SignalsOptions

    signals(SignalsOptions(**words), controls)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o drive",
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o drive.parquet",
        f"{PROGRAM} decode drive.blf --dbc car.dbc -o part.csv --signals 'EngineSpeed,Brake.*' --from 60 --to 90",
        f"{PROGRAM} decode front.blf rear.blf --dbc car.dbc -o both.parquet",
        f"{PROGRAM} decode recordings --dbc car.dbc -o tables --jobs 4",
        f"candump -L can0 | {PROGRAM} decode - --dbc car.dbc -o - --format jsonl",
    )
)
@logs_argument("log file; of several the frames are put in order of time; or folder of logs; - is standard input")
@output_option(
    "folder for a table of each message; or one table: .parquet, .csv, .jsonl or .arrows; - is standard output",
    required=True,
)
@force_option
@click.option(
    "--format",
    "table_format",
    type=click.Choice(["parquet", "csv", "jsonl", "arrow"]),
    help="whatever the name of the output says (default of standard output: csv; of a folder: parquet)",
)
@together(dbc_option, _match_option, _columns_option)
@click.option(
    "--layout",
    type=click.Choice(["messages", "wide"]),
    help="a table per message, in a folder, or wide: a row per frame, a column per signal (default: as the output is)",
)
@click.option(
    "--values",
    type=click.Choice(["numbers", "texts", "both"]),
    default="numbers",
    help="values that the database names: as numbers, as texts in a column beside, or both",
)
@click.option(
    "--signals",
    metavar="NAME,NAME...",
    default="",
    help="only these: Message.Signal or the signal alone, both with * for anything (default: all)",
)
@click.option(
    "--from",
    "begin",
    metavar="TIME",
    help="only what is not before: seconds from the first frame, or a time as 2026-01-01T12:30:00 (UTC)",
)
@click.option("--to", "end", metavar="TIME", help="only what is before; the log is read no further")
@click.option("--jobs", type=int, help="tables of a folder at a time (default: one per core)")
@click.option(
    "--strict", is_flag=True, help="end with status 5 if anything of the log is not in the file, and say what"
)
@json_option
@working
def decode(controls: Controls, **words: Any) -> None:
    """Write the signals of logs as a table: Parquet, CSV, JSON lines or Arrow."""
    from diag_service.commands.decode import decode
    from diag_service.settings.options import DecodeOptions

    decode(DecodeOptions(**words), controls)


@command_line.command(epilog=examples(f"{PROGRAM} predict drive-a.csv drive-b.csv --profile car.toml"))
@logs_argument("logs of one type of vehicle, frames or tables of signals; - is standard input")
@together(dbc_option, profile_option)
@click.option(
    "--touch",
    metavar="BAR",
    type=float,
    help="touch point of the clutches in bar (default: the pressure in gear at standstill)",
)
@click.option(
    "--halves", is_flag=True, help="predict the second half from the first (default: each shift from all others)"
)
@click.option("--each-log", is_flag=True, help="predict the shifts of each log from the other logs alone")
@json_option
@working
def predict(controls: Controls, **words: Any) -> None:
    """Predict shifts of logs from the others, and show how well it went.

    Friction, up to a scale, is found in some shifts; given the pressures and the first speed of another, it predicts
    the course of engine speed while the clutch slips, with intervals. If these fail their own blind test, none is
    shown. Needs engine speed, both clutch pressures, and
    speeds behind the clutches or ratios; no torque, no drawing.
    """
    from clutch_model.units import pa_from_bar
    from diag_service.commands.learn import predict
    from diag_service.settings.options import PredictOptions

    touch_bar = words.pop("touch")
    predict(PredictOptions(touch_pa=None if touch_bar is None else pa_from_bar(touch_bar), **words), controls)


@command_line.command(epilog=examples(f"{PROGRAM} learn drive-a.csv drive-b.csv --profile car.toml -o car1.toml"))
@logs_argument("logs of one vehicle, frames or tables of signals")
@output_option("description to write (TOML), for analyze --vehicle-file", required=True)
@together(force_option, dbc_option, profile_option, calibration_option, _columns_option)
@json_option
@working
def learn(controls: Controls, **words: Any) -> None:
    """Describe an unknown vehicle from its logs: gears, ratios, clutches, touch points, for a person to complete.

    Each value has its standard deviation and says whether it is from the log or assumed. Nothing is claimed that the
    logs do not tell.
    """
    from diag_service.commands.learn import learn
    from diag_service.settings.options import LearnOptions

    learn(LearnOptions(**words), controls)


@command_line.group(subcommand_metavar="ACTION ...", no_args_is_help=False)
def lake() -> None:
    """Look after a lake of results."""


@lake.command("check", epilog=examples(f"{PROGRAM} lake check s3://fleet/lake"))
@_lake_argument
@click.option(
    "--repair", is_flag=True, help="remove parts of no log, as a killed run may leave; the next run makes missing ones"
)
@working
def check_lake(_controls: Controls, **words: Any) -> None:
    """Show what is in a lake, and whether its manifest and its parts agree."""
    from diag_service.commands.lake import check

    check(**words)


@lake.command(epilog=examples(f"{PROGRAM} lake forget s3://fleet/lake car7"))
@_lake_argument
@click.argument("vehicle", metavar="VEHICLE", help="vehicle id")
@json_option
@working
def forget(_controls: Controls, **words: Any) -> None:
    """Remove one vehicle from a lake and check that nothing is left.

    Every part of one vehicle and its rows of the manifest are removed, listed, and looked for again. Logs and copies
    elsewhere stay.
    """
    from diag_service.commands.lake import forget

    forget(**words)


for _command in attached("diag_service.commands").values():
    command_line.add_command(_command)
