"""Options that can be set outside the command line, and what holds where nobody sets them; imports next to nothing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

OptionValue = str | int | float | bool | Path | None

PREFIX: Final = "CLUTCHDIAG_"  # of environment variables, such as CLUTCHDIAG_BROKER
CONFIG_VARIABLE: Final = f"{PREFIX}CONFIG"
BROKER_VARIABLE: Final = f"{PREFIX}BROKER"  # keeps a password out of the process list
UNNAMED_VEHICLE: Final = "vehicle"  # what a vehicle is called that nobody names
DEFAULTS: Final[Mapping[str, OptionValue]] = {
    "vehicle": None,  # that of the calibration
    "dbc": None,
    "lenient": False,
    "profile": None,
    "calibration": None,
    "store": None,
    "store_budget": None,
    "broker": None,
    "ca": None,
    "cert": None,
    "key": None,
    "password_file": None,
    "acknowledge": "broker",
    "interface": None,
    "channel": None,
    "bitrate": None,
    "fd": False,
    "only_mapped": False,
    "duration": None,
    "metrics": None,
}
"""Every option that can be set, with what holds where nobody sets it."""
