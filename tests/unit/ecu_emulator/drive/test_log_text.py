"""What the formats that are text write of a frame, character by character."""

import io

import numpy as np
import pytest

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.writers import (
    AscWriter,
    CandumpWriter,
    CsvWriter,
    FrameWriter,
    GvretWriter,
    Header,
    TrcWriter,
)

START_US = 1_767_225_600_000_000
HEADER = Header(start_us=START_US, channel="vcan0")
FRAMES = EncodedFrames(
    t_s=np.array([0.0, 12.345678]),
    can_id=np.array([0x0A0, 0x98FE_F100], np.uint32),
    length=np.array([0, 3], np.uint8),
    data=np.array([[0] * 8, [0xAB, 0x0C, 0xDE, 0, 0, 0, 0, 0]], np.uint8),
)
LINES: dict[type[FrameWriter], tuple[str, str]] = {
    CandumpWriter: ("(1767225600.000000) vcan0 0A0#", "(1767225612.345678) vcan0 18FEF100#AB0CDE"),
    AscWriter: (
        "0000000.000000 1  0A0             Rx   d 0",
        "0000012.345678 1  18FEF100x             Rx   d 3 AB 0C DE",
    ),
    TrcWriter: (
        "         1            0.000 DT  1 00A0 Rx -  0   \r",
        "         2        12345.678 DT  1 18FEF100 Rx -  3    AB 0C DE\r",
    ),
    CsvWriter: ("1767225600.000000,0x0A0,0,0,0,0,", "1767225612.345678,0x18FEF100,1,0,0,3,qwze"),
    GvretWriter: (
        "1767225600000000,000000A0,false,Rx,0,0,00,00,00,00,00,00,00,00,",
        "1767225612345678,18FEF100,true,Rx,0,3,AB,0C,DE,00,00,00,00,00,",
    ),
}


@pytest.mark.parametrize("writer", LINES)
def test_a_frame_is_a_line(writer: type[FrameWriter]) -> None:
    stream = io.BytesIO()
    made = writer(stream, HEADER)
    begin = stream.tell()
    made.write(START_US + np.rint(FRAMES.t_s * 1e6).astype(np.int64), FRAMES)
    assert stream.getvalue()[begin:].decode() == "".join(f"{line}\n" for line in LINES[writer])
