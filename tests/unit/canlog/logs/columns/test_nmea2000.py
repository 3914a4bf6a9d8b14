"""NMEA 2000 as programs and gateways write it: identifiers in parts, messages that are longer than a frame."""

from collections.abc import Callable

import numpy as np
import pytest

from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.logs.columns.programs import Actisense, Canboat, YachtDevices
from canlog.logs.log_counts import LogCounts
from canlog.logs.text_log import TextLog, frames_of
from canlog.transport.fast_packet import FastPackets
from canlog.transport.transfers import TransferCounts

GROUP = 129_540


def read(log: TextLog, text: str) -> tuple[FrameBatch, LogCounts]:
    counts = LogCounts()
    log.look_ahead(text.encode())
    return frames_of(log, text.rstrip("\n").encode(), counts), counts


def together(batch: FrameBatch) -> list[bytes]:
    """Return the messages of fast packets, put together."""
    counts = TransferCounts()
    packets = FastPackets(counts)
    found = [
        packets.feed(int(t_ns), (0, int(can_id)), bytes(data[:length]))
        for t_ns, can_id, data, length in zip(batch.t_ns, batch.can_id, batch.data, batch.length, strict=True)
    ]
    packets.close()
    assert not counts.incomplete
    return [one.data for one in found if one is not None]


def canboat_line(data: bytes, group: int = GROUP) -> str:
    return f"2011-11-24-22:42:04.388,6,{group},36,255,{len(data)},{data.hex(',')}\n"


def actisense_line(data: bytes, group: int = GROUP) -> str:
    return f"A173321.107 24FF6 {group:05X} {data.hex().upper()}   \n"


@pytest.mark.parametrize(("log", "line"), [(Canboat, canboat_line), (Actisense, actisense_line)])
def test_a_message_longer_than_a_frame_becomes_the_fast_packet_that_carried_it(
    log: Callable[[], TextLog], line: Callable[[bytes], str]
) -> None:
    rng = np.random.default_rng(1)
    for length in (9, 13, 14, 20, 21, 100, 222, 223):
        messages = [rng.bytes(length) for _ in range(11)]
        batch, counts = read(log(), "".join(map(line, messages)))
        assert together(batch) == messages
        assert np.unique(batch.can_id).tolist() == [6 << 26 | GROUP << 8 | 36 | EXTENDED_FLAG]
        assert len(np.unique(batch.t_ns)) == 1
        assert (batch.length == 8).all()
        assert counts.rejected == {}


def test_that_frames_are_made_is_said() -> None:
    log = Canboat()
    read(log, canboat_line(bytes(9)))
    assert [note.partition(":")[0] for note in log.notes] == ["messages of more than 8 bytes are whole in this log"]
    log = Canboat()
    read(log, canboat_line(bytes(8)))
    assert log.notes == []


def test_a_short_message_of_a_group_with_long_ones_is_a_fast_packet_too() -> None:
    """Also where the long one comes later; a group without long ones has frames of its own."""
    messages = [b"\1\2\3", b"\4" * 8, bytes(range(50)), b"\5" * 6]
    text = "".join(map(canboat_line, messages)) + canboat_line(b"\7" * 8, 127_250)
    batch, _ = read(Canboat(), text)
    is_other = (batch.can_id >> 8 & 0x3FFFF) == 127_250
    assert batch.data[is_other].tolist() == [[7] * 8]
    assert together(batch[~is_other]) == messages


@pytest.mark.parametrize(
    ("line", "can_id"),
    [
        ("2011-11-24-22:42:04.388,2,127251,36,255,2,7d,0b", 0x09F11324),
        ("2011-11-24-22:42:04.388,2,127251,36,17,2,7d,0b", 0x09F11324),  # a group for all has no destination
        ("2011-11-24-22:42:04.388,6,59904,36,17,2,7d,0b", 0x18EA1124),
        ("2011-11-24T22:42:04.388Z,6,59904,36,255,2,7d,0b", 0x18EAFF24),
    ],
)
def test_an_identifier_is_put_together_from_its_parts(line: str, can_id: int) -> None:
    batch, counts = read(Canboat(), line)
    assert batch.can_id.tolist() == [can_id | EXTENDED_FLAG]
    assert batch.t_ns.tolist() == [1_322_174_524_388_000_000]
    assert counts == LogCounts()


@pytest.mark.parametrize(
    "line",
    [
        "2011-11-24-22:42:04.388,8,127251,36,255,1,7d",
        "2011-11-24-22:42:04.388,2,127251,256,255,1,7d",
        "2011-11-24-22:42:04.388,2,127251,36,256,1,7d",
        "2011-11-24-22:42:04.388,2,-5,36,255,1,7d",
        "2011-11-24-22:42:04.388,2,127251,36,255,2,7d",
        "2011-11-24-22:42:04.388,2,127251,36,255,1,7dd",
        "2011-11-24,2,127251,36,255,1,7d",
        "2011-11-24-22:42:04.388,2,127251,36,255,224" + ",00" * 224,
    ],
)
def test_what_is_no_message_is_counted(line: str) -> None:
    batch, counts = read(Canboat(), canboat_line(b"\1") + line)
    assert (len(batch), counts.first_rejected) == (1, "line 2: malformed")


def test_what_a_gateway_says_of_itself_is_no_message_of_the_bus() -> None:
    batch, counts = read(Canboat(), canboat_line(b"\1", 0x40011) + canboat_line(b"\1"))
    assert len(batch) == 1
    assert counts == LogCounts(skipped=1)


def test_a_gateway_of_actisense_writes_sentences_of_nmea_0183_between_messages() -> None:
    batch, counts = read(Actisense(), "A000001.5 23FF7 1F513 01\n$GPRMC,123519,A\nA000001.500 23178 0EA00 01\n")
    assert (len(batch), counts.rejected) == (0, {"malformed": 2})
    batch, counts = read(Actisense(), "A235959.500 23FF7 1F513 01\n$GPRMC,123519,A\nA000001.500 23177 0EA00 01\n")
    assert batch.can_id.tolist() == [0x1DF51323 | EXTENDED_FLAG, 0x1CEA1723 | EXTENDED_FLAG]
    assert np.diff(batch.t_ns).tolist() == [2_000_000_000]
    assert counts == LogCounts(skipped=1)


def test_a_last_message_without_its_length_may_lack_bytes() -> None:
    last = frames_of(Actisense(), b"A173321.107 23FF7 1F513 012F")
    assert not Actisense().is_whole(b"A173321.107 23FF7 1F513 012F\n", last)
    last = frames_of(Canboat(), canboat_line(b"\1\2").encode())
    assert Canboat().is_whole(canboat_line(b"\1\2").encode(), last)


def test_times_of_day_go_on_over_midnight() -> None:
    text = "23:59:59.999 R 19F51323 01 2F 30 70 00 2F 30 70\r\n00:00:00.001 T 123 00\r\n"
    batch, counts = read(YachtDevices(), text)
    assert batch.can_id.tolist() == [0x19F51323 | EXTENDED_FLAG, 0x123]
    assert np.diff(batch.t_ns).tolist() == [2_000_000]
    assert counts == LogCounts()
