"""Writers of the log formats; all take columns."""

from ecu_emulator.log_formats.writers import (
    AscWriter,
    BlfWriter,
    CandumpWriter,
    CsvWriter,
    FrameWriter,
    GvretWriter,
    Header,
    Mf4Writer,
    TrcWriter,
)

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
