"""What lets the emulator answer testers: options of ``run``; who works imports what does the work."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, Final

from clutchdiag_io.command_line import FILE, INT, Choice, Option
from workshop.controller.iso14229 import DOIP_TLS_PORT

if TYPE_CHECKING:
    from ecu_emulator.live import AnswersTesters

DEFAULT_ELM_PORT: Final = "35000"


def answers(options: SimpleNamespace) -> "AnswersTesters | None":
    """Return what a command line says of answering, None if nobody is to answer."""
    from workshop.controller.answers import chosen  # noqa: PLC0415 - compiled libraries

    return chosen(options)


RUN_OPTIONS: Final = (
    Option(
        "--workshop",
        "stand in neutral until a tester starts the workshop routine (routine 0301); needs --diagnostics",
    ),
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
