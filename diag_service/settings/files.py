"""A settings file: what stands for options that neither the command line nor the environment names."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click

from canlog.files import read_toml_file
from diag_service.errors import ConfigError
from diag_service.settings.options import Setting
from fleet_link import AddressError, check_secret_mode


def read_settings(file: Path, known: Mapping[str, Setting]) -> dict[str, Any]:
    """Return what a file sets of the options that are known.

    Raises ConfigError if a key is unknown, a value unfit, or a file with a password may be read by others. The message
    does not repeat values, which may be secret.
    """
    values, problems = {}, []
    for key, value in _read(file).items():
        try:
            values[key] = _converted(known.get(key), value)
        except ValueError as exc:
            problems.append(f"{key}: {exc}")
    if problems:
        raise ConfigError(f"settings in {file}: {'; '.join(problems)}")
    return values


def _read(file: Path) -> dict[str, Any]:
    try:
        table = read_toml_file(file)
    except OSError as exc:
        raise ConfigError(f"cannot read {file}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise ConfigError(f"{file} is not TOML: {exc}") from exc
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
    takes_numbers = option.type.name in {"boolean", "float", "int"}
    if isinstance(value, str) or (takes_numbers and isinstance(value, bool | int | float)):
        text = str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
        with suppress(click.BadParameter, ValueError):
            return option.type.convert(text, option, None)
    raise ValueError(option.demand)
