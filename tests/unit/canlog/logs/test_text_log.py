"""What the readers of lines share."""

import io

import pytest

from canlog.logs.detection import TEXT_LOGS, LogFormat
from canlog.logs.log_counts import LogCounts
from canlog.logs.text_log import BLOCK_BYTES, reader_of


@pytest.mark.parametrize(
    ("log_format", "header", "line"),
    [
        (LogFormat.CANDUMP, b"", b"(0.0)c 123#"),
        (LogFormat.ASC, b"base hex\n", b"0.0 1 1 Rx r"),
        (LogFormat.TRC, b";$FILEVERSION=2.1\n;$COLUMNS=O,T,I\n", b"0 DT 1"),
        (LogFormat.GVRET, b"Time Stamp,ID,Extended,Bus,LEN,D1\n", b"0,1,0,0,0"),
        (LogFormat.CRTD, b"", b"0 R11 1"),
        (LogFormat.BUSMASTER, b"***BUSMASTER***\n", b"0:0:0:0 Rx 1 1 s 0"),
    ],
)
def test_a_block_of_the_shortest_lines_fits_into_the_buffer(log_format: LogFormat, header: bytes, line: bytes) -> None:
    number, counts = BLOCK_BYTES // len(line + b"\n") + 10, LogCounts()
    assert len(line + b"\n") >= TEXT_LOGS[log_format]().shortest_line_bytes
    stream = io.BytesIO(header + number * (line + b"\n"))
    frames = [len(batch) for batch in reader_of(TEXT_LOGS[log_format])(stream, counts)]
    assert sum(frames) == number == counts.frames
    assert not counts.rejected
