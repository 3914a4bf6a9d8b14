"""All signals of a database at once: the bits of cantools in every corner, and only from frames that carry them."""

from dataclasses import replace
from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal
from cantools.database.errors import DecodeError

from canlog.decode.codec import Codec, FrameFate, MessageValues
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from tests.support.batches import frames_at
from tests.support.cantools_oracle import reference, same_bits
from tests.support.wire import DATABASE

CORNERS = Path(__file__).parents[4] / "tests" / "data" / "corners.dbc"
ROWS = 200


def corners() -> Database:
    database = cantools.database.load_file(CORNERS, strict=True)
    assert isinstance(database, Database)
    return database


def frames(messages: list[Message], rows: int, seed: int) -> FrameBatch:
    """Return frames of all messages in turn, with random payloads of the right length and small multiplexer values."""
    rng = np.random.default_rng(seed)
    count = rows * len(messages)
    flags = [EXTENDED_FLAG if message.is_extended_frame else 0 for message in messages]
    ids = [message.frame_id | flag for message, flag in zip(messages, flags, strict=True)]
    length = np.tile([message.length for message in messages], rows)
    data = rng.integers(0, 256, (count, 64)).astype(np.uint8)
    data[np.arange(64) >= length[:, None]] = 0
    return frames_at(np.arange(count), np.tile(ids, rows), length, data)


def assert_as_cantools(message: Message, batch: FrameBatch, found: MessageValues) -> None:
    payloads = [batch.data[row, : message.length].tobytes() for row in found.rows]
    wanted = reference(message, payloads)
    assert found.signals.keys() == wanted.keys()
    for name, decoded in found.signals.items():
        is_good = np.ones(len(payloads), np.bool_) if decoded.is_good is None else decoded.is_good
        is_there = ~np.isnan(wanted[name])
        assert same_bits(decoded.value[is_there], wanted[name][is_there]), f"{message.name}.{name}"
        assert not (is_good & ~is_there).any(), f"{message.name}.{name}"
        assert np.array_equal(is_good, np.isfinite(wanted[name])), f"{message.name}.{name}"


@pytest.mark.parametrize("database", [DATABASE, corners()], ids=["own", "corners"])
def test_every_signal_has_the_bits_of_cantools(database: Database) -> None:
    codec = Codec(database.messages, check_range=False)
    batch = frames(database.messages, ROWS, seed=5)
    found = list(codec.decode(batch))
    assert [values.slot for values in found] == list(range(len(database.messages)))
    for values in found:
        assert len(values.rows) == ROWS
        assert not codec.tables[values.slot].refused
        assert_as_cantools(database.messages[values.slot], batch, values)


@pytest.mark.parametrize("database", [DATABASE, corners()], ids=["own", "corners"])
def test_short_frames_give_the_signals_that_fit_as_cantools_does(database: Database) -> None:
    codec = Codec(database.messages, check_range=False)
    batch = frames(database.messages, ROWS, seed=8)
    size = np.random.default_rng(8).integers(0, batch.length + 1).astype(np.uint8)
    batch.data[np.arange(64) >= size[:, None]] = 0
    batch = replace(batch, length=size)
    values = dict.fromkeys(range(len(database.messages)), 0)
    for found in codec.decode(batch):
        message = database.messages[found.slot]
        for place, row in enumerate(found.rows.tolist()):
            try:
                wanted = message.decode(
                    batch.data[row, : size[row]].tobytes(), decode_choices=False, allow_truncated=True
                )
            except DecodeError:  # a page of a multiplexer without signals
                continue
            assert isinstance(wanted, dict)
            there = {
                name: decoded.value[place].item()
                for name, decoded in found.signals.items()
                if decoded.is_present is None or decoded.is_present[place]
            }
            assert repr(there) == repr({name: float(str(wanted[name])) for name in there})
            assert there.keys() == wanted.keys()
            values[found.slot] += len(there)
    assert all(values.values())


@pytest.mark.parametrize(
    ("size", "is_fd", "fd_flag", "length", "fate"),
    [
        (8, False, 0, 8, FrameFate.DECODED),
        (20, False, 0, 8, FrameFate.TRANSPORTED),  # a first frame of ISO-TP, or a packet of J1939
        (20, False, 0, 12, FrameFate.SHORT),  # longer than any classic frame, though the log does not say that it is FD
        (20, True, 0, 8, FrameFate.SHORT),
        (20, False, FD_FLAG, 20, FrameFate.DECODED),
        (20, False, FD_FLAG, 12, FrameFate.SHORT),
        (20, False, 0, 20, FrameFate.DECODED),  # a log whose format does not tell CAN FD
        (100, True, FD_FLAG, 64, FrameFate.TRANSPORTED),
    ],
)
def test_messages_longer_than_their_frames_need_a_transport_protocol(
    size: int, is_fd: bool, fd_flag: int, length: int, fate: FrameFate
) -> None:
    message = Message(0x100, "M", size, [Signal("A", start=0, length=8)], is_fd=is_fd)
    batch = frames_at([0], 0x100, length, np.ones(64), flags=fd_flag)
    codec = Codec([message])
    assert np.flatnonzero(codec.match(batch).counts[0]).tolist() == [fate]
    assert len(list(codec.decode(batch))) == (fate is not FrameFate.TRANSPORTED)


@pytest.mark.parametrize(
    ("can_id", "fate"),
    [
        (0x18FECA03, FrameFate.SHORT),  # packets of a longer message have an identifier of their own
        (0x09F80501, FrameFate.TRANSPORTED),  # in data page 1, NMEA 2000 has fast packets
    ],
)
def test_a_frame_of_a_group_that_is_longer_is_short_or_a_piece_by_its_page(can_id: int, fate: FrameFate) -> None:
    message = Message(can_id, "M", 14, [Signal("A", start=0, length=8)], is_extended_frame=True, protocol="j1939")
    batch = frames_at([0], can_id | EXTENDED_FLAG, 8, np.ones(64))
    assert np.flatnonzero(Codec([message]).match(batch).counts[0]).tolist() == [fate]


def test_every_frame_has_one_fate_and_what_nobody_asked_for_is_left_out() -> None:
    first, second = (Signal(name, start=start, length=8) for name, start in (("A", 0), ("B", 8)))
    codec = Codec(
        [Message(0x100, "M", 8, [first, second]), Message(0x101, "Long", 20, [first]), Message(1, "None", 8, [])]
    )
    flagged = 0x100 | np.array([REMOTE_FLAG, ERROR_FLAG, REMOTE_FLAG | ERROR_FLAG])
    batch = frames_at(np.arange(10), [0x100, 0x100, 0x100, 0x101, 0x101, 1, 0x7FF, *flagged], [8, 8, 1, *[8] * 7])

    def fates(codec: Codec) -> list[dict[str, int]]:
        return [{fate.name: row[fate] for fate in FrameFate if row[fate]} for row in codec.match(batch).counts]

    own, long, none = {"DECODED": 2, "SHORT": 1}, {"TRANSPORTED": 2}, {"WITHOUT_SIGNALS": 1}
    nobody = {"UNKNOWN": 1, "REMOTE": 1, "ERROR": 2}
    assert fates(codec) == [own, long, none, nobody]
    assert fates(codec.only({(0, "B")})) == [own, {}, none, nobody | {"LEFT_OUT": 2}]
    assert fates(codec.only({(1, "A")})) == [{}, long, none, nobody | {"LEFT_OUT": 3}]
    assert [[*found.signals] for found in codec.only({(0, "B")}).decode(batch)] == [["B"], []]
