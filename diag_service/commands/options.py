"""Options that several commands have, and the wrapper of every command; imports next to nothing.

A setting is an option that the environment or a settings file may set, too: over the file stands the environment, and
over both the command line.
"""

import os
import sys
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import update_wrapper
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import click

from canlog.errors import SourceError
from canlog.files import read_small_file, widen
from clutchdiag_io.command_line import FILE, STANDARD_STREAM, FunctionT, together
from clutchdiag_io.program import standard_output
from diag_service.errors import ConfigError, StoppedError
from diag_service.stopping import Controls, Trigger, patient_trigger

PROGRAM: Final = "diag-service"
VARIABLES: Final = "CLUTCHDIAG"  # begins the environment variables, such as CLUTCHDIAG_BROKER


def setting(*names: str, **attributes: Any) -> Callable[[FunctionT], FunctionT]:
    """Return an option that the environment or a settings file may set, under its name with ``_`` for ``-``."""
    variable = f"{VARIABLES}_{names[-1].removeprefix('--').replace('-', '_').upper()}"
    return click.option(*names, envvar=variable, **attributes)


def _read_elsewhere(ctx: click.Context, _option: click.Parameter, file: Path | None) -> None:
    """Check the names of the environment's variables and take the values of a settings file as defaults."""
    if ctx.resilient_parsing:
        return
    from fleet_contract import VariableError, check_variables

    try:
        check_variables(os.environ)
        if file is not None:
            ctx.default_map = read_settings(file)
    except (VariableError, ConfigError) as exc:
        raise click.ClickException(str(exc)) from exc


_verbose_option = click.option(
    "-v", "--verbose", count=True, show_default=False, help="print more; twice: of libraries"
)
json_option = click.option("--json", is_flag=True, help="one JSON object on standard output")
dbc_option = setting(
    "--dbc", metavar="FILE[#BUS]", type=FILE, help="message database: DBC, KCD, ARXML or SYM (default: the shipped one)"
)
profile_option = setting(
    "--profile",
    metavar="P",
    type=FILE,
    help="which DBC signals are which: TOML file or shipped name (default: the shipped one that fits the DBC)",
)
calibration_option = setting("--calibration", type=FILE, help="of a vehicle or its type: TOML file or shipped name")
meaning_options = together(
    setting("--vehicle", metavar="ID", help="vehicle id (default: the calibration's, or vehicle)"),
    dbc_option,
    profile_option,
    calibration_option,
    setting(
        "--vehicle-file", type=FILE, help="description that learn wrote, instead of a calibration: it has ratios, too"
    ),
)
config_option = click.option(
    "--config",
    type=FILE,
    envvar=f"{VARIABLES}_CONFIG",
    is_eager=True,
    expose_value=False,
    callback=_read_elsewhere,
    help="TOML file with settings, see 'config check'",
)
delivery_options = together(
    setting(
        "--store",
        type=FILE,
        help="SQLite file for results (default of run: in the user's state directory, by vehicle; of analyze: none)",
    ),
    setting(
        "--store-budget",
        metavar="MIB",
        type=int,
        help="how large the store may grow; delivered results go first, then empty ones (default: no limit)",
    ),
    setting(
        "--broker",
        metavar="URL",
        help=f"mqtt[s]://[user[:password]@]host[:port] (default: the environment's {VARIABLES}_BROKER, else none)",
    ),
    setting("--ca", type=FILE, help="authority of an mqtts:// broker (default: system) or a tls:// scheduler"),
    setting("--cert", type=FILE, help="our certificate; a renewed one is taken up at once"),
    setting("--key", type=FILE, help="its key, readable for its owner only"),
    setting("--password-file", type=FILE, help="holds the broker's password, chmod 600"),
    setting(
        "--acknowledge",
        type=click.Choice(["broker", "backend"]),
        default="broker",
        help="who acknowledges a result before the outbox deletes it; a backend does so after its commit",
    ),
)
open_bus_options = together(
    setting("-i", "--interface", help="python-can interface: socketcan, udp_multicast, ..."),
    setting("-c", "--channel", help="channel of the interface, such as vcan0"),
    setting("-b", "--bitrate", type=int, help="bit rate, for interfaces that set it [bit/s]"),
    setting("--fd", is_flag=True, help="open the interface in CAN FD mode"),
)
bus_options = together(
    open_bus_options,
    setting("--only-mapped", is_flag=True, help="let the kernel discard other messages, uncounted"),
    setting("--duration", metavar="S", type=float, help="stop after so many seconds, of a simulation in its own time"),
    setting("--once", is_flag=True, help="end with the bus, such as a simulation, instead of waiting for its return"),
    setting("--metrics", metavar="[HOST:]PORT", help="serve /metrics, /livez and /readyz there (default: nowhere)"),
)
poll_options = together(
    setting(
        "--poll",
        metavar="[S]",
        type=float,
        is_flag=False,
        flag_value=60.0,
        help="ask the controller for its trouble codes every S seconds (default: never; without S: 60); needs --active",
    ),
    setting(
        "--adapter",
        metavar="URL",
        help="ask through elm327://HOST[:PORT], elm327:/dev/NAME or doip://HOST[:PORT]/ADDRESS in place of a bus",
    ),
    setting(
        "--active",
        is_flag=True,
        help="allow requests on the bus, for signals of the profile, too: without it the service only listens",
    ),
    setting(
        "--ecu",
        metavar="ID",
        help="controller that is asked: identifier of its requests, hexadecimal (default: as described, or 7E1)",
    ),
    setting(
        "--reply", metavar="ID", help="identifier of answers (default: as described, or by the rules of the standard)"
    ),
    setting(
        "--description",
        type=FILE,
        help="what the controller has: TOML, PDX or the name of a shipped one (default: the one that it says it is)",
    ),
)


def logs_argument(text: str, metavar: str = "LOG...", kind: Any = FILE) -> Callable[[FunctionT], FunctionT]:
    return click.argument("logs", nargs=-1, required=True, type=kind, metavar=metavar, help=text)


def output_option(text: str, *, required: bool = False) -> Callable[[FunctionT], FunctionT]:
    return click.option("-o", "--output", type=FILE, required=required, help=text)


@click.command()
@together(bus_options, meaning_options, delivery_options, poll_options)
def _set() -> None:
    """All that can be set."""


SETTINGS: Final = tuple(str(option.name) for option in _set.params)


def read_settings(file: Path) -> dict[str, str]:
    """Return what a settings file sets, as texts, which click reads as it reads those of a command line.

    Raises ConfigError if it is no such file, a key is unknown, or it has a password and may be read by others.
    """
    try:
        table = tomllib.loads(read_small_file(file).decode("utf-8"))
    except OSError as exc:
        raise ConfigError(f"cannot read {file}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise ConfigError(f"{file} is not TOML: {exc}") from exc
    except RecursionError:
        raise ConfigError(f"{file} is not TOML: its lists or tables are nested too deeply") from None
    if unknown := sorted(table.keys() - set(SETTINGS)):
        raise ConfigError(f"settings in {file}: {unknown[0]}: Extra inputs are not permitted")
    from fleet_link import AddressError, check_secret_mode

    try:
        if _holds_password(str(table.get("broker", ""))):
            check_secret_mode(file)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    return {name: str(value) for name, value in table.items()}


def _holds_password(url: str) -> bool:
    try:
        return urlsplit(url).password is not None
    except ValueError:  # no address at all; that is said later
        return "@" in url


def working(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with ``-v`` that sets up notices and signals, then calls the function with ``Controls``."""

    def work(*, verbose: int, **words: Any) -> None:
        # python-can loads asammdf where it is installed, and that pandas: 0.3 s, 45 MB. Who reads MF4 loads it then.
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # Python's own way to say "not here"
        controls: Controls = replace(click.get_current_context().obj, verbosity=verbose)
        logs = (words.get("log") or "", *words.get("logs", ()))
        if is_piped := STANDARD_STREAM in logs:
            with suppress(AttributeError, OSError, ValueError):  # none, or none of the system: reading it says so
                widen(sys.stdin.fileno())  # whoever writes goes on meanwhile: candump loses frames at a full pipe
        # Imported here: compiled libraries take a second, in which a signal must already find its handler.
        from canlog.jit import on_compiling
        from diag_service.console import set_up_notices

        set_up_notices(verbose)
        if is_piped:  # whoever writes into the pipe may get the same signal, and end it
            controls = replace(controls, stop=patient_trigger(controls.stop))
        unheed = on_compiling(lambda _kernel: None if is_piped else _check(controls.stop))  # a pipe's frames are judged
        try:
            with standard_output():
                function(controls, **words)
        except SourceError as exc:
            from diag_service.api.stores import store_among

            if store := store_among(logs):
                text = f"{store} is a store of results, no log: {PROGRAM} report {store} shows what is in it"
                raise ConfigError(text) from exc
            raise
        finally:
            unheed()

    return _verbose_option(update_wrapper(work, function))


def _check(stop: Trigger) -> None:
    """Raise StoppedError if a run was told to stop: compiling can take minutes."""
    if stop.is_set:
        raise StoppedError("stopped early: numerical kernels were being compiled")
