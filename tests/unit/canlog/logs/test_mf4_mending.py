"""Records of MDF 4: cut into pieces anywhere they are the same, and one that lacks a part is missing."""

import struct

import pytest

from canlog.logs.mf4_blocks import ChannelGroup, DataGroup, Stored, transposed
from canlog.logs.mf4_mending import RecordCounter

FRAMES, PAYLOADS = 100, 200  # addresses of channel groups


def channel_group(
    at: int,
    record_id: int,
    record_bytes: int,
    *,
    stated: int = 0,
    is_variable: bool = False,
    parts: tuple[int, ...] = (),
) -> ChannelGroup:
    return ChannelGroup(
        at=at, cycles_at=0, bytes_at=0, record_id=record_id, stated=stated, record_bytes=record_bytes,
        is_variable=is_variable, parts=parts,
    )  # fmt: skip


def data_group(*groups: ChannelGroup, id_bytes: int) -> DataGroup:
    return DataGroup(link_at=0, data_at=1, id_bytes=id_bytes, groups=groups)


def payload(data: bytes, id_bytes: int) -> bytes:
    return (2).to_bytes(id_bytes, "little") + struct.pack("<L", len(data)) + data


@pytest.mark.parametrize("id_bytes", [1, 2, 4, 8])
@pytest.mark.parametrize("piece_bytes", [1, 3, 1000])
def test_a_frame_whose_payload_is_cut_is_missing(id_bytes: int, piece_bytes: int) -> None:
    frame = (1).to_bytes(id_bytes, "little") + bytes(6)
    first = payload(b"abc", id_bytes)
    stream = frame + first + frame + payload(b"defgh", id_bytes)

    def is_begun(rest_bytes: int) -> bool:
        return 0 < rest_bytes < len(frame)

    for cut in range(len(stream) + 1):
        group = data_group(
            channel_group(FRAMES, 1, 6, parts=(PAYLOADS,)), channel_group(PAYLOADS, 2, 0, is_variable=True),
            id_bytes=id_bytes,
        )  # fmt: skip
        counter = RecordCounter(group)
        there = stream[:cut]
        kept = b"".join(counter.whole_records(there[at : at + piece_bytes] for at in range(0, cut, piece_bytes)))
        whole = (cut >= len(stream)) + (cut >= len(frame + first))
        assert counter.whole(group.groups[0]) == whole
        assert counter.found[FRAMES] == counter.found[PAYLOADS] + counter.stand_ins[PAYLOADS]  # as asammdf wants it
        assert kept.count(frame) == counter.found[FRAMES]
        lacking = counter.missing(Stored(blocks=(), is_cut=True)).get(FRAMES, 0)
        assert lacking == (counter.found[FRAMES] - whole or (whole < 2 and is_begun(cut - whole * len(frame + first))))


def test_what_a_file_states_beyond_what_is_there_is_missing() -> None:
    group = data_group(channel_group(FRAMES, 0, 4, stated=10), id_bytes=0)
    counter = RecordCounter(group)
    assert b"".join(counter.whole_records([b"12345", b"678", b"9"])) == b"12345678"
    assert counter.missing(Stored(blocks=(), is_cut=True)) == {FRAMES: 8}


def test_zeros_up_to_the_next_block_are_no_record() -> None:
    group = data_group(channel_group(FRAMES, 0, 5), id_bytes=0)
    counter = RecordCounter(group)
    assert b"".join(counter.whole_records([b"abcde" + bytes(3)])) == b"abcde"
    assert not counter.missing(Stored(blocks=(), is_cut=False))
    assert counter.missing(Stored(blocks=(), is_cut=True)) == {FRAMES: 1}


def test_an_unknown_record_ends_them() -> None:
    group = data_group(channel_group(FRAMES, 1, 2), id_bytes=1)
    counter = RecordCounter(group)
    assert b"".join(counter.whole_records([b"\x01ab\x01cd\x05ef\x01gh"])) == b"\x01ab\x01cd"
    assert counter.is_lost
    assert counter.found == {FRAMES: 2}


def test_transposed_bytes() -> None:
    rows = bytes(range(12))
    columns = bytes(rows[line * 4 + column] for column in range(4) for line in range(3))
    assert transposed(columns + b"xy", 4) == rows + b"xy"
