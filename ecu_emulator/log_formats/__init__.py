"""Writers of the log formats, one per module; all take columns and write in bulk."""

from ecu_emulator.log_formats.asc import AscWriter
from ecu_emulator.log_formats.base import FrameWriter, Header
from ecu_emulator.log_formats.blf import BlfWriter
from ecu_emulator.log_formats.candump import CandumpWriter
from ecu_emulator.log_formats.csv_tables import CsvWriter, GvretWriter
from ecu_emulator.log_formats.mf4 import Mf4Writer
from ecu_emulator.log_formats.trc import TrcWriter

__all__ = [
    "AscWriter",
    "BlfWriter",
    "CandumpWriter",
    "CsvWriter",
    "FrameWriter",
    "GvretWriter",
    "Header",
    "Mf4Writer",
    "TrcWriter",
]
