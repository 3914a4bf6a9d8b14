"""What the emulator's commands do, once arguments are read and signals are in hand."""

import json
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Event
from typing import Final

from rich.console import Console

from ecu_emulator.bus import TransmitReport, open_bus, transmit
from ecu_emulator.errors import ConfigError, RecordError
from ecu_emulator.frames import EncodedFrames
from ecu_emulator.progress import ProgressLine
from ecu_emulator.record import open_log
from ecu_emulator.recording import LONG_STRETCH_S, SHORT_STRETCH_S, Drive, Stretch
from ecu_emulator.scenario import FluidCondition, Scenario
from ecu_emulator.scenario_file import load_scenario, shipped_scenarios
from ecu_emulator.truth import ShiftTruth, Totals, TruthWriter, truth_path


@dataclass(frozen=True, slots=True, kw_only=True)
class BusChoice:
    """Which bus to open; None leaves the choice to python-can's configuration."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    is_fd: bool


def choose_scenario(name_or_file: str, *, fluid: str | None, seed: int | None, cycles: int | None) -> Scenario:
    """Load a scenario and override what the command line names.

    Raises
    ------
    ConfigError
        If the scenario or an override cannot be used.
    """
    scenario = load_scenario(name_or_file)
    if fluid is not None:
        scenario = replace(scenario, fluid=replace(scenario.fluid, condition=FluidCondition(fluid)))
    if seed is not None:
        scenario = replace(scenario, seed=seed)
    if cycles is not None:
        scenario = replace(scenario, cycles=cycles)
    return scenario


def list_scenarios() -> None:
    """Print the shipped scenarios."""
    console = Console(highlight=False, soft_wrap=True)
    for name in shipped_scenarios():
        console.print(f"{name:<12} {load_scenario(name).description}", markup=False)
