"""The command line of the backend: all commands, errors to one line and an exit status."""

import logging
from collections.abc import Sequence
from typing import Final

from clutchdiag_io.command_line import run
from clutchdiag_io.program import complain, reckon_in_one_thread
from fleet_backend.commands import PROGRAM, command_line
from fleet_backend.errors import BackendConfigError, BrokerError, DatabaseError, UnknownVehicleError
from fleet_backend.office import commands as office
from fleet_contract import VariableError

__all__ = ["command_line", "main"]

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_BROKER, EXIT_DATABASE, EXIT_UNKNOWN = range(6)
_STATUSES: Final = (
    ((BackendConfigError, VariableError), EXIT_CONFIG),
    (BrokerError, EXIT_BROKER),
    (DatabaseError, EXIT_DATABASE),
    (UnknownVehicleError, EXIT_UNKNOWN),
)
for _command in (office.alarms, office.peers, office.serve, office.watch, office.retain, office.forget):
    command_line.add_command(_command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the backend and return its exit status."""
    reckon_in_one_thread()
    try:
        return run(command_line, arguments)
    except KeyboardInterrupt:
        return EXIT_OK
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        is_verbose = logging.getLogger("fleet_backend").isEnabledFor(logging.DEBUG)
        return complain(PROGRAM, exc, _STATUSES, is_verbose=is_verbose, hint=" (-v shows where)")
