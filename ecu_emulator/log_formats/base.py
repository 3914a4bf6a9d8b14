"""What every log writer offers, and what it is told about the log."""

from dataclasses import dataclass
from typing import BinaryIO, Final, Protocol

import numpy as np
import numpy.typing as npt

from ecu_emulator.bus.frames import EncodedFrames

Int64Array = npt.NDArray[np.int64]
UInt8Array = npt.NDArray[np.uint8]
UInt32Array = npt.NDArray[np.uint32]

EXTENDED_FLAG: Final = 0x8000_0000  # bit 31 of ``can_id``: 29-bit identifier
ERROR_FLAG: Final = 0x2000_0000
PAYLOAD_BYTES: Final = 8
US_PER_S: Final = 1_000_000
US_PER_MS: Final = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """What a log says once."""

    start_us: int  # since the epoch: scenario time 0
    channel: str


class FrameWriter(Protocol):
    """Writes frames in one format; made with the header, ended by ``close``, which leaves the stream open."""

    def __init__(self, stream: BinaryIO, header: Header) -> None: ...

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""

    def close(self) -> None:
        """Write what the format needs at its end."""
