"""Writers of the log formats; all take columns."""

from ecu_emulator.log_formats.base import FrameWriter, Header
from ecu_emulator.log_formats.blf import BlfWriter
from ecu_emulator.log_formats.mf4 import Mf4Writer
from ecu_emulator.log_formats.text import AscWriter, CandumpWriter, CsvWriter, GvretWriter, TrcWriter

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
