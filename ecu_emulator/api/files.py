"""The database of the emulated vehicle, from Python."""

from pathlib import Path

from ecu_emulator.api.emulator import AnyPath
from ecu_emulator.commands import save_dbc


def write_dbc(output: AnyPath) -> int:
    """Write the DBC file of the emulated vehicle, as ``ecu-emulator dbc`` does; one that is there is replaced.

    Returns its size [bytes]. Raises RecordError if it cannot be written.
    """
    return save_dbc(Path(output), is_forced=True)
