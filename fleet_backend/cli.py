"""The command line of the backend: signals and errors to one line and an exit status; libraries load in here only."""

import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Final

from clutchdiag_io.program import complain, reckon_in_one_thread, standard_output
from fleet_backend.arguments import (
    COMMAND_LINE,
    EXIT_BROKER,
    EXIT_CONFIG,
    EXIT_DATABASE,
    EXIT_OK,
    EXIT_UNKNOWN,
    PROGRAM,
)
from fleet_backend.errors import BrokerError, ConfigError, DatabaseError, ExtraMissingError, UnknownVehicleError
from fleet_contract import VariableError, check_variables

_STATUSES: Final = (
    ((ConfigError, VariableError), EXIT_CONFIG),
    (BrokerError, EXIT_BROKER),
    (DatabaseError, EXIT_DATABASE),
    (UnknownVehicleError, EXIT_UNKNOWN),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the backend and return its exit status."""
    reckon_in_one_thread()
    options = COMMAND_LINE.parse(arguments)
    _set_up_log(options.verbose)
    try:
        check_variables(os.environ)
        with standard_output():
            _load_commands(options).execute(options)
    except KeyboardInterrupt:
        return EXIT_OK
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        return complain(PROGRAM, exc, _STATUSES, is_verbose=options.verbose > 0, hint=" (-v shows where)")
    return EXIT_OK


def _load_commands(options: SimpleNamespace) -> ModuleType:
    """Return the module of the commands; raises ExtraMissingError where what it needs is not installed."""
    try:
        return import_module("fleet_backend.follow" if options.command == "follow" else "fleet_backend.commands")
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith(("fleet_backend", "fleet_contract")):
            raise
        extra = "nats" if str(getattr(options, "broker", "")).startswith("nats") else "fleet"
        if options.command in {"serve", "watch"}:  # each of these extras brings what `fleet` brings
            extra = "page"
        raise ExtraMissingError(exc.name, extra) from exc


def _set_up_log(verbosity: int) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(f"%(asctime)s {PROGRAM}: %(levelname)s: %(message)s"))
    for name in ("fleet_backend", "fleet_link", "clutchdiag_io", "uvicorn"):
        own = logging.getLogger(name)
        own.handlers, own.propagate = [handler], False
        own.setLevel(logging.DEBUG if verbosity else logging.INFO)
    if not verbosity:
        logging.getLogger("uvicorn").setLevel(logging.WARNING)  # that it starts is said already
    logging.getLogger().handlers = [handler] if verbosity > 1 else [logging.NullHandler()]
