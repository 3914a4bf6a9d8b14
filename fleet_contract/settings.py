"""The environment variables of service and backend: both may be set in one shell."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Final

from fleet_contract.errors import VariableError

PREFIX: Final = "CLUTCHDIAG_"
SERVICE_VARIABLES: Final = frozenset(
    PREFIX + name
    for name in (
        *("ACKNOWLEDGE", "BITRATE", "BROKER", "CA", "CALIBRATION", "CERT", "CHANNEL", "CONFIG", "DBC"),
        *("DURATION", "FD", "INTERFACE", "KEY", "METRICS", "ONLY_MAPPED"),
        *("PASSWORD_FILE", "PROFILE", "STORE", "STORE_BUDGET", "VEHICLE", "VEHICLE_FILE"),
        *("ACTIVE", "ADAPTER", "DESCRIPTION", "ECU", "POLL", "REPLY"),
    )
)
BACKEND_VARIABLES: Final = frozenset(PREFIX + name for name in ("BROKER", "DATABASE", "GROUP"))


def check_variables(environment: Mapping[str, str]) -> None:
    """Raise VariableError if a variable that is set has our prefix and is known to neither program."""
    known = SERVICE_VARIABLES | BACKEND_VARIABLES
    for name in sorted(environment):
        if not name.startswith(PREFIX) or name in known or not environment[name]:
            continue
        nearest = get_close_matches(name, sorted(known), n=1, cutoff=0.0)
        raise VariableError(f"the environment sets {name}, which nothing reads; the nearest known name is {nearest[0]}")
