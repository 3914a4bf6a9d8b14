"""The command line of the backend: signals and errors to one line and an exit status; libraries load in here only."""

import logging
import os
import sys
from collections.abc import Sequence
from types import SimpleNamespace
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
from fleet_backend.errors import BackendConfigError, BrokerError, DatabaseError, UnknownVehicleError
from fleet_contract import VariableError, check_variables

_STATUSES: Final = (
    ((BackendConfigError, VariableError), EXIT_CONFIG),
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
            _execute(options)
    except KeyboardInterrupt:
        return EXIT_OK
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        return complain(PROGRAM, exc, _STATUSES, is_verbose=options.verbose > 0, hint=" (-v shows where)")
    return EXIT_OK


def _execute(options: SimpleNamespace) -> None:
    """Carry out a command; only what it needs is loaded."""
    if options.command == "follow":
        from fleet_backend import follow

        follow.execute(options)
        return
    from fleet_backend import commands
    from fleet_backend.office import commands as office

    commands.execute(options, {**commands.COMMANDS, **office.COMMANDS})


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
