"""Captures in pcap and pcapng: which packets are frames, what is skipped, and where the reader goes on after damage."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs.captures import SWAPPED, read_capture
from canlog.logs.log_counts import LogCounts, LogReject
from tests.support.batches import read_whole
from tests.support.capture_grammars import SOCKETCAN, pcap, pcapng, socketcan
from tests.support.log_grammars import Frame

FRAME = Frame(t_us=1_000, can_id=0x123, is_extended=False, length=3, data=b"\1\2\3")
FRAMES = [replace(FRAME, t_us=1_000 * number) for number in range(10)]
PCAP_HEADER = struct.pack("<LHHLLLL", 0xA1B2C3D4, 2, 4, 0, 0, 262144, SOCKETCAN)


def read(contents: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(read_capture, contents)


def record(packet: bytes, seconds: int = 1, part: int = 5, stated: int | None = None) -> bytes:
    size = len(packet) if stated is None else stated
    return struct.pack("<LLLL", seconds, part, size, size) + packet


@pytest.mark.parametrize(
    ("packet", "outcome"),
    [
        (socketcan(FRAME), ""),
        (socketcan(FRAME)[:11], ""),
        (socketcan(FRAME)[:10], "malformed"),  # the capture took less of a packet than it has
        (socketcan(FRAME)[:7], "malformed"),
        (socketcan(replace(FRAME, can_id=0x800)), "malformed"),
        (socketcan(replace(FRAME, length=9, is_fd=True)), "malformed"),
        (socketcan(replace(FRAME, length=65, is_fd=True)), "malformed"),
        (socketcan(FRAME)[:4] + b"\x81" + socketcan(FRAME)[5:], "malformed"),  # of CAN XL
        (socketcan(replace(FRAME, is_remote=True, is_fd=True)), "malformed"),
    ],
)
def test_a_packet_is_a_frame_or_has_a_reason(packet: bytes, outcome: str) -> None:
    batch, counts = read(PCAP_HEADER + record(socketcan(FRAME)) + record(packet))
    assert len(batch) == (1 if outcome else 2)
    assert counts.rejected == ({LogReject.MALFORMED: 1} if outcome else {})
    assert counts.first_rejected == ("packet 2: malformed" if outcome else "")


def test_identifiers_in_the_other_byte_order_are_read_swapped_and_that_is_said() -> None:
    ids = [0x12A, 0x0E1, 0x241] * 7
    packets = [socketcan(replace(FRAME, can_id=one), "<") for one in ids]
    batch, counts = read(PCAP_HEADER + b"".join(map(record, packets)))
    assert batch.can_id.tolist() == ids
    assert counts.rejected == {}
    assert SWAPPED in counts.notes


@pytest.mark.parametrize("name", ["pcap", "pcapng"])
@pytest.mark.parametrize("garbage", [b"\xff" * 7, b"\xff" * 4096, bytes(range(256)) * 3])
def test_what_stands_between_packets_is_stepped_over(name: str, garbage: bytes, tmp_path: Path) -> None:
    (pcap if name == "pcap" else pcapng)(SOCKETCAN)(tmp_path / "a", FRAMES)
    sound = (tmp_path / "a").read_bytes()
    record_bytes = 32 if name == "pcap" else 56
    place = len(sound) - 4 * record_bytes
    batch, counts = read(sound[:place] + garbage + sound[place:])
    assert np.diff(batch.t_ns).tolist() == [1_000_000] * 9
    assert counts.rejected == {LogReject.DAMAGED: 1}
    assert counts.first_rejected == "packet 7: damaged"


@pytest.mark.parametrize("name", ["pcap", "pcapng"])
def test_the_end_may_be_missing(name: str, tmp_path: Path) -> None:
    (pcap if name == "pcap" else pcapng)(SOCKETCAN)(tmp_path / "a", FRAMES)
    sound = (tmp_path / "a").read_bytes()
    for missing in (1, 5, 20, 31):
        batch, counts = read(sound[:-missing])
        assert len(batch) == 9
        assert counts.rejected == {LogReject.CUT_OFF: 1}
        assert counts.truncated
    with pytest.raises(SourceError, match="inside its header"):
        read(PCAP_HEADER[:20])
