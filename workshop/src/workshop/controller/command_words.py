"""Options of ``ecu-emulator run`` that let it answer testers."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import click

from clutchdiag_io.command_line import FILE

if TYPE_CHECKING:
    from ecu_emulator.live import AnswersTesters

DEFAULT_ELM_PORT: Final = "35000"
run_options: Final = (
    click.option(
        "--workshop",
        "is_in_workshop",
        is_flag=True,
        help="stand in neutral until a tester starts the workshop routine (routine 0301); needs --diagnostics",
    ),
    click.option(
        "--diagnostics",
        metavar="[TABLE]",
        is_flag=False,
        flag_value="",
        help="answer UDS requests of testers (7E1, 7DF); TABLE: a controller of your own instead of the one that ships",
    ),
    click.option(
        "--answers-like",
        type=click.Choice(["bmw_dkg", "gm_t87a", "vw_dsg"]),
        help="answer as controllers of a real car do, the engine's beside the transmission's: data, scales and times "
        "to answer; gm_t87a is an automatic (--scenario lockup)",
    ),
    click.option(
        "--doip",
        metavar="[HOST:]PORT",
        help="answer testers on an IP network, too (ISO 13400-2, port 13400); on this machine alone without HOST",
    ),
    click.option("--diagnostic-memory", type=FILE, help="keep trouble codes in this file, over restarts"),
    click.option(
        "--elm327",
        metavar="[[HOST:]PORT]",
        is_flag=False,
        flag_value=DEFAULT_ELM_PORT,
        help="serve OBD apps on this TCP port as an ELM327 adapter does (127.0.0.1:35000)",
    ),
)


def answers(words: Mapping[str, Any]) -> "AnswersTesters | None":
    """Return how testers are answered by a command line, None if they are not."""
    from workshop.controller.answers import chosen

    return chosen(words)
