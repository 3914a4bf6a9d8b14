"""ASAM MDF 4 bus logging through asammdf, an optional and heavy dependency."""

from datetime import UTC, datetime
from typing import Any, BinaryIO, Final

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.errors import ExtraMissingError
from ecu_emulator.log_formats.base import EXTENDED_FLAG, PAYLOAD_BYTES, US_PER_S, Header, Int64Array

FRAME: Final = np.dtype([
    ("CAN_DataFrame.BusChannel", "<u1"),
    ("CAN_DataFrame.ID", "<u4"),
    ("CAN_DataFrame.IDE", "<u1"),
    ("CAN_DataFrame.DLC", "<u1"),
    ("CAN_DataFrame.DataLength", "<u1"),
    ("CAN_DataFrame.DataBytes", "<u1", (PAYLOAD_BYTES,)),
    ("CAN_DataFrame.Dir", "<u1"),
    ("CAN_DataFrame.EDL", "<u1"),
    ("CAN_DataFrame.BRS", "<u1"),
    ("CAN_DataFrame.ESI", "<u1"),
])  # fmt: skip
VERSION: Final = "4.10"
TRANSPOSED_AND_DEFLATED: Final = 2
BUS_CHANNEL: Final = 1


class Mf4Writer:
    """Writes what python-can's MF4Writer writes, in columns; times are float seconds from the start.

    Raises
    ------
    ExtraMissingError
        If asammdf is not installed.
    """

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        try:
            import asammdf  # noqa: PLC0415 - optional, and takes a second to import
            from asammdf.blocks import v4_constants  # noqa: PLC0415
            from asammdf.blocks.v4_blocks import SourceInformation  # noqa: PLC0415
        except ImportError as exc:
            raise ExtraMissingError("MF4 needs the optional package asammdf: pip install 'clutchdiag[mf4]'") from exc
        self._stream = stream
        self._start_us = header.start_us
        self._signal: Any = asammdf.Signal
        self._source: Any = SourceInformation(source_type=v4_constants.SOURCE_BUS, bus_type=v4_constants.BUS_TYPE_CAN)
        self._mdf: Any = asammdf.MDF(version=VERSION)
        self._mdf.header.start_time = datetime.fromtimestamp(self._start_us / US_PER_S, UTC)
        self._has_group = False

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        samples = np.zeros(len(frames), FRAME)
        samples["CAN_DataFrame.BusChannel"] = BUS_CHANNEL
        samples["CAN_DataFrame.ID"] = frames.can_id & np.uint32(EXTENDED_FLAG - 1)
        samples["CAN_DataFrame.IDE"] = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
        samples["CAN_DataFrame.DLC"] = frames.length
        samples["CAN_DataFrame.DataLength"] = frames.length
        samples["CAN_DataFrame.DataBytes"] = frames.data
        elapsed_s = (t_us - self._start_us) / US_PER_S
        if self._has_group:
            self._mdf.extend(0, [(elapsed_s, None), (samples, None)])
        else:
            signal = self._signal(name="CAN_DataFrame", samples=samples, timestamps=elapsed_s, source=self._source)
            self._mdf.append(signal)
            self._has_group = True

    def close(self) -> None:
        """Write the file: MDF is assembled at the end."""
        try:
            self._mdf.save(self._stream, compression=TRANSPOSED_AND_DEFLATED)
        finally:
            self._mdf.close()
