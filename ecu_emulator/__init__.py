"""The emulated vehicle: plant, sensors and controllers of a wet dual-clutch transmission on a CAN bus.

    ecu_emulator.Emulator("case2", seed=7).record("drive.log")

What is named here is imported when it is first used, and prints nothing (docs/python.md). The modules load what they
need and no more: the command line answers before the plant's compiler is loaded.
"""

import typing

from canlog.extras import on_demand as _on_demand

if typing.TYPE_CHECKING:
    from ecu_emulator.api import Emulator, write_dbc
    from ecu_emulator.commands import Recording
    from ecu_emulator.errors import BusError, EmulatorConfigError, EmulatorError, LogFormatExtraError, RecordError
    from ecu_emulator.scenario.faults import BusFault, SensorFault
    from ecu_emulator.scenario.scenario import Scenario
    from ecu_emulator.scenario.scenario_file import load_scenario, shipped_scenarios
    from ecu_emulator.truth import TruthLog, read_truth

__all__ = [
    "BusError",
    "BusFault",
    "Emulator",
    "EmulatorConfigError",
    "EmulatorError",
    "LogFormatExtraError",
    "RecordError",
    "Recording",
    "Scenario",
    "SensorFault",
    "TruthLog",
    "__version__",
    "load_scenario",
    "read_truth",
    "shipped_scenarios",
    "write_dbc",
]

__version__ = "0.9.0"

__getattr__, __dir__ = _on_demand(__name__, __file__)
