"""The words of what answers testers: options of ``run``, and the command ``pdx``. Imports next to nothing."""

from typing import Final

import click

from clutchdiag_io.command_line import FILE, FORCE, INT, Choice, Command, Option

DEFAULT_ELM_PORT: Final = "35000"
DOIP_TLS_PORT: Final = 3496  # registered for DoIP by TLS, as 13400 is without
RUN_OPTIONS: Final = (
    Option(
        "--diagnostics [TABLE]",
        "answer UDS requests of testers (7E1, 7DF); TABLE: a controller of your own instead of the one that ships",
        flag_value="",
    ),
    Option(
        "--answers-like",
        "answer as a controller of a real car does: its data, scales and times to answer, besides the own ones",
        Choice(["bmw_dkg", "vw_dsg"]),
    ),
    Option(
        "--doip [HOST:]PORT",
        "answer testers on an IP network as well (ISO 13400-2; its port is 13400); only on this machine unless HOST "
        "says otherwise",
    ),
    Option("--doip-certificate FILE", "answer over IP by TLS as well, with this certificate (PEM)", FILE),
    Option("--doip-key FILE", "its key, unless that is in the same file", FILE),
    Option("--doip-tls-port PORT", f"port for TLS (default: {DOIP_TLS_PORT})", INT, default=DOIP_TLS_PORT),
    Option("--diagnostic-memory FILE", "keep trouble codes in this file, over restarts", FILE),
    Option(
        "--elm327 [[HOST:]PORT]",
        "serve OBD apps on this TCP port as an ELM327 adapter does (127.0.0.1:35000)",
        flag_value=DEFAULT_ELM_PORT,
    ),
)
_PDX: Final = Command(
    "pdx",
    "describe for diagnostic tools what a tester can ask: a PDX package, ODX 2.2 (ISO 22901-1)",
    click.Argument(
        ["table"],
        type=FILE,
        metavar="[TABLE]",
        required=False,
        help="TOML table of a controller (default: the own one)",
    ),
    Option("-o --output FILE", "PDX file to write", FILE, default="tcu.pdx"),
    FORCE,
    Option("--json", "print the result as one JSON line on stdout"),
    Option("-v --verbose", "show a traceback on errors"),
    examples=("ecu-emulator pdx -o tcu.pdx", "ecu-emulator pdx my.toml -o my.pdx"),
)
COMMANDS: Final = (_PDX,)
