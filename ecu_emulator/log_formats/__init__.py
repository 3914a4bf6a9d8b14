"""Writers of the log formats, one per module; all take columns and write in bulk."""

from ecu_emulator.log_formats.asc import AscWriter
from ecu_emulator.log_formats.base import FrameWriter, Header
from ecu_emulator.log_formats.blf import BlfWriter
from ecu_emulator.log_formats.candump import CandumpWriter
from ecu_emulator.log_formats.mf4 import Mf4Writer

__all__ = ["AscWriter", "BlfWriter", "CandumpWriter", "FrameWriter", "Header", "Mf4Writer"]
