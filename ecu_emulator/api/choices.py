"""What a caller may choose, as Python values: checked as the options of the command line are."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ecu_emulator.arguments import DOIP_TLS_PORT
from ecu_emulator.diagnostics.doip.tls import tls_node
from ecu_emulator.errors import ConfigError
from ecu_emulator.live.live_drive import DiagnosticsChoice, diagnostics_choice
from ecu_emulator.scenario.faults import BusFault, SensorFault
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.scenario.scenario_file import parse_fault

AnyPath = str | os.PathLike[str]
AnyFault = SensorFault | BusFault | Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """How the emulated controller answers testers; each member is the option of that name.

    Attributes
    ----------
    table : path, optional
        A TOML file that describes a controller of your own.
    memory : path, optional
        A file that keeps trouble codes over restarts.
    doip, elm327 : str, optional
        ``[HOST:]PORT`` at which it answers over IP, and as an ELM327 adapter.
    doip_certificate, doip_key : path, optional
        With a certificate it answers over IP by TLS as well; the key may be in the same file.
    doip_tls_port : int
        Where it does.
    on_board : bool
        Whether a diag-service that is started beside it tells it of its clutches; not on a virtual bus.
    """

    table: AnyPath | None = None
    memory: AnyPath | None = None
    doip: str | None = None
    elm327: str | None = None
    doip_certificate: AnyPath | None = None
    doip_key: AnyPath | None = None
    doip_tls_port: int = DOIP_TLS_PORT
    on_board: bool = False


def with_faults(scenario: Scenario, faults: Iterable[AnyFault]) -> Scenario:
    """Return a scenario with more faults; raises ConfigError if one cannot be."""
    given = [fault_of(one) for one in faults]
    return replace(
        scenario,
        sensor_faults=(*scenario.sensor_faults, *(one for one in given if isinstance(one, SensorFault))),
        bus_faults=(*scenario.bus_faults, *(one for one in given if isinstance(one, BusFault))),
    )


def fault_of(fault: AnyFault) -> SensorFault | BusFault:
    """Return a fault, from its table perhaps; raises ConfigError if it cannot be."""
    return fault if isinstance(fault, SensorFault | BusFault) else parse_fault(fault)


def diagnostics_of(answers: Answers | None) -> DiagnosticsChoice | None:
    """Return how testers are answered; raises ConfigError if an address is none."""
    if answers is None:
        return None
    table = "" if answers.table is None else os.fspath(answers.table)
    memory = None if answers.memory is None else Path(answers.memory)
    certificate, key = (None if one is None else Path(one) for one in (answers.doip_certificate, answers.doip_key))
    tls = tls_node(certificate, key, answers.doip_tls_port)
    return diagnostics_choice(table, memory, answers.doip, answers.elm327, has_service=answers.on_board, tls=tls)


def check_range(name: str, value: float | None, limits: tuple[float, float]) -> None:
    """Raise ConfigError unless a number, if it is given, lies within its limits."""
    low, high = limits
    if value is not None and not low <= value <= high:
        raise ConfigError(f"{name} must be {low:g}..{high:g}, got {value:g}")


def check_word(name: str, word: str | None, words: list[str]) -> None:
    """Raise ConfigError unless a word, if it is given, is one of these."""
    if word is not None and word not in words:
        raise ConfigError(f"{name} must be {', '.join(words[:-1])} or {words[-1]}, got {word!r}")
