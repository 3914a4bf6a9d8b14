"""The options that can be set: each is declared here, once, for command line, environment and settings file.

Over the file stands the environment, and over both the command line. Loads next to nothing.
"""

import os
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import click

from canlog.files import read_small_file
from clutchdiag_io.command_line import FILE, FLOAT, INT, Choice, Option
from diag_service.errors import ConfigError

PROGRAM: Final = "diag-service"
DEFAULT_BITRATE: Final = 500_000
JSON: Final = Option("--json", "one JSON object on standard output")

_KINDS: Final = {
    "boolean": "true or false",
    "float": "a number",
    "integer": "a whole number",
    "path": "a file name",
    "text": "a text",
}


VARIABLES: Final = "CLUTCHDIAG"  # begins the environment variables, such as CLUTCHDIAG_BROKER


class Setting(Option):
    """An option that the environment or a settings file may set, under its name with ``_`` for ``-``."""

    can_be_set = True

    @property
    def demand(self) -> str:
        if isinstance(self.type, Choice):
            return f"must be {' or '.join(self.type.choices)}"
        return f"must be {_KINDS[self.type.name]}"

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:  # noqa: ANN401 - as click has it
        """Return what a text stands for; of the environment's texts none is repeated, since it may be secret."""
        try:
            return super().type_cast_value(ctx, value)
        except click.BadParameter:
            if ctx.get_parameter_source(self.name) is click.ParameterSource.COMMANDLINE:
                raise
            raise ConfigError(f"settings: {self.name}: {self.demand}") from None


def _read_elsewhere(ctx: click.Context, _option: click.Parameter, file: Path | None) -> Path | None:
    """Check the names of the environment's variables and take the values of a settings file as defaults."""
    if ctx.resilient_parsing:
        return file
    from fleet_contract import VariableError, check_variables  # noqa: PLC0415 - help does without

    try:
        check_variables(os.environ)
    except VariableError as exc:
        raise ConfigError(str(exc)) from exc
    if file is not None:
        ctx.default_map = read_settings(file)
    return file


MEANING: Final = (
    Setting("--vehicle ID", "vehicle id (default: the calibration's, or vehicle)"),
    Setting("--dbc FILE[#BUS]", "message database: DBC, KCD, ARXML or SYM (default: the shipped one)", FILE),
    Setting(
        "--profile P",
        "which DBC signals are which: TOML file or shipped name (default: the shipped one that fits the DBC)",
        FILE,
    ),
    Setting("--calibration FILE", "of a vehicle or its type: TOML file or shipped name (default: nominal)", FILE),
    Setting("--vehicle-file FILE", "description that learn wrote, instead of a calibration: it has ratios, too", FILE),
)
DELIVERY: Final = (
    Setting(
        "--store FILE",
        "SQLite file for results (default of run: in the user's state directory, by vehicle; of analyze: none, "
        "results are shown only)",
        FILE,
    ),
    Setting(
        "--store-budget MIB",
        "how large the store may grow; delivered results go first, then empty ones (default: no limit)",
        INT,
    ),
    Setting(
        "--broker URL",
        f"mqtt[s]://[user[:password]@]host[:port] (default: the environment's {VARIABLES}_BROKER, else none)",
    ),
    Setting("--ca FILE", "authority of an mqtts:// broker (default: system) or a tls:// scheduler", FILE),
    Setting("--cert FILE", "our certificate; a renewed one is taken up at once", FILE),
    Setting("--key FILE", "its key, readable for its owner only", FILE),
    Setting("--password-file FILE", "holds the broker's password, chmod 600", FILE),
    Setting(
        "--acknowledge",
        "who acknowledges a result before the outbox deletes it; a backend does so after its commit (default: broker)",
        Choice(["broker", "backend"]),
        default="broker",
    ),
)
BUS: Final = (
    Setting("-i --interface INTERFACE", "python-can interface: socketcan, udp_multicast, ..."),
    Setting("-c --channel CHANNEL", "channel of the interface, such as vcan0"),
    Setting("-b --bitrate BITRATE", "bit rate, for interfaces that set it [bit/s]", INT),
    Setting("--fd", "open the interface in CAN FD mode"),
    Setting("--only-mapped", "let the kernel discard other messages, uncounted"),
    Setting("--duration S", "stop after this many seconds", FLOAT),
    Setting("--metrics [HOST:]PORT", "serve /metrics, /livez and /readyz there (default: nowhere)"),
)
POLL: Final = (
    Setting(
        "--poll [S]",
        "ask the controller for its trouble codes every S seconds (default: never; without S: 60); needs --active",
        FLOAT,
        flag_value=60.0,
    ),
    Setting(
        "--adapter URL",
        "ask through elm327://HOST[:PORT], elm327:/dev/NAME or doip://HOST[:PORT]/ADDRESS in place of a bus",
    ),
    Setting(
        "--active",
        "allow requests on the bus, for signals of the profile, too: without it the service only listens",
    ),
    Setting(
        "--ecu ID", "controller that is asked: identifier of its requests, hexadecimal (default: as described, or 7E1)"
    ),
    Setting("--reply ID", "identifier of answers (default: as described, or by the rules of the standard)"),
    Setting(
        "--description FILE",
        "what the controller has: TOML, PDX or the name of a shipped one (default: the shipped one that it says it is)",
        FILE,
    ),
)
CONFIG: Final = Setting(
    "--config FILE", "TOML file with settings, see 'config check'", FILE, is_eager=True, callback=_read_elsewhere
)
SETTINGS: Final[Mapping[str, Setting]] = {option.name: option for option in (*MEANING, *DELIVERY, *BUS, *POLL)}


def read_settings(file: Path) -> dict[str, Any]:
    """Return what a settings file sets.

    Raises ConfigError if a key is unknown, a value unfit, or a file with a password may be read by others. The message
    does not repeat values, which may be secret.
    """
    values, problems = {}, []
    for key, value in _read(file).items():
        try:
            values[key] = _converted(SETTINGS.get(key), value)
        except ValueError as exc:
            problems.append(f"{key}: {exc}")
    if problems:
        raise ConfigError(f"settings in {file}: {'; '.join(problems)}")
    return values


def _read(file: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(read_small_file(file).decode("utf-8"))
    except OSError as exc:
        raise ConfigError(f"cannot read {file}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise ConfigError(f"{file} is not TOML: {exc}") from exc
    except RecursionError:
        raise ConfigError(f"{file} is not TOML: its lists or tables are nested too deeply") from None
    from fleet_link import AddressError, check_secret_mode  # noqa: PLC0415 - most do without a file

    try:
        if _holds_password(str(table.get("broker", ""))):
            check_secret_mode(file)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    return table


def _holds_password(url: str) -> bool:
    try:
        return urlsplit(url).password is not None
    except ValueError:  # no address at all; that is said later
        return "@" in url


def _converted(option: Setting | None, value: object) -> object:
    """Return what the value of an option stands for; a number may be written as a text, a text not as a number.

    Raises ValueError if it does not fit.
    """
    if option is None:
        raise ValueError("Extra inputs are not permitted")
    takes_numbers = option.type.name in {"boolean", "float", "integer"}
    if isinstance(value, str) or (takes_numbers and isinstance(value, bool | int | float)):
        text = str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
        with suppress(click.BadParameter, ValueError):
            return option.type.convert(text, option, None)
    raise ValueError(option.demand)
