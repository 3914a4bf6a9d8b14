"""Options that the command line leaves open: the environment, a settings file or a default fills them in."""

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from diag_service.errors import ConfigError
from diag_service.settings.defaults import BROKER_VARIABLE, CONFIG_VARIABLE, DEFAULTS, PREFIX, OptionValue
from fleet_contract import VariableError, check_variables
from program_io.legible import legible


def fill_in(options: argparse.Namespace) -> None:
    """Give every option that is still ``None`` the value that was set elsewhere, or its default; raises ConfigError."""
    try:
        check_variables(os.environ)
    except VariableError as exc:
        raise ConfigError(str(exc)) from exc
    values = {**DEFAULTS, **_set_elsewhere(options.config)}
    for name, value in values.items():
        if getattr(options, name, None) is None:
            setattr(options, name, value)


def describe(options: argparse.Namespace) -> str:
    """Return the options as the text of a settings file, with what is secret masked."""
    return "".join(_line(name, getattr(options, name)) for name in DEFAULTS)


def mask(url: str) -> str:
    """Return a URL without its password."""
    password = urlsplit(url).password
    return url if password is None else url.replace(f":{password}@", ":***@")


def _set_elsewhere(file: Path | None) -> Mapping[str, OptionValue]:
    file = file or (Path(os.environ[CONFIG_VARIABLE]) if os.environ.get(CONFIG_VARIABLE) else None)
    names = [name for name in DEFAULTS if os.environ.get(PREFIX + name.upper())]
    if file is None and not set(names) - {"broker"}:
        return {"broker": os.environ[BROKER_VARIABLE]} if names else {}
    from diag_service.settings.files import load_settings  # noqa: PLC0415 - loads pydantic

    return load_settings(file)


def _line(name: str, value: OptionValue) -> str:
    if value is None:
        return f"# {name} is not set\n"
    if isinstance(value, bool):
        return f"{name} = {str(value).lower()}\n"
    if isinstance(value, int | float):
        return f"{name} = {value}\n"
    text = mask(str(value)) if name == "broker" else legible(str(value))
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'{name} = "{escaped}"\n'
