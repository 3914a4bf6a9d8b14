"""All signals of a database at once: the bits of cantools in every corner, and only from frames that carry them."""

from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal

from diag_service.decoding.codec import Codec, MessageValues
from diag_service.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from tests.cantools_oracle import reference, same_bits
from tests.wire import DATABASE

CORNERS = Path(__file__).parents[3] / "data" / "corners.dbc"
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
    return FrameBatch(
        t_ns=np.arange(count), can_id=np.tile(ids, rows).astype(np.uint32), length=length.astype(np.uint8), data=data
    )


def assert_as_cantools(message: Message, batch: FrameBatch, found: MessageValues) -> None:
    payloads = [batch.data[row, : message.length].tobytes() for row in found.rows]
    wanted = reference(message, payloads)
    assert found.signals.keys() == wanted.keys()
    for name, decoded in found.signals.items():
        is_good = np.ones(len(payloads), np.bool_) if decoded.is_good is None else decoded.is_good
        is_there = ~np.isnan(wanted[name])
        assert same_bits(decoded.value[is_there], wanted[name][is_there]), f"{message.name}.{name}"
        assert not (is_good & ~is_there).any(), f"{message.name}.{name}"
        signal = message.get_signal_by_name(name)
        if signal.choices is None:  # else some of the values are codes
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


def test_every_page_of_a_multiplexer_is_met() -> None:
    message = corners().get_message_by_name("LongFrame")
    batch = frames([message], 6, seed=1)
    batch.data[:, 54] = [200, 3, 0, 255, 200, 3]
    (found,) = Codec([message], check_range=False).decode(batch)
    assert_as_cantools(message, batch, found)
    assert found.signals["FarPage"].is_good is not None
    assert found.signals["FarPage"].is_good.tolist() == [True, False, False, False, True, False]


def test_frames_that_do_not_carry_the_message_are_left_out() -> None:
    message = DATABASE.messages[0]
    ids = [message.frame_id | flag for flag in (0, REMOTE_FLAG, ERROR_FLAG, EXTENDED_FLAG, 0)]
    batch = FrameBatch(
        t_ns=np.arange(5),
        can_id=np.array(ids, np.uint32),
        length=np.array([8, 8, 8, 8, 7], np.uint8),
        data=np.zeros((5, 8), np.uint8),
    )
    (found,) = Codec(DATABASE.messages).decode(batch)
    assert found.rows.tolist() == [0]


def test_signal_that_cannot_be_decoded_does_not_take_the_others_along() -> None:
    signals = [Signal("Wide", start=0, length=80), Signal("Narrow", start=80, length=8)]
    (table,) = Codec([Message(0x100, "M", 64, signals, is_fd=True)]).tables
    assert table.signals.keys() == {"Narrow"}
    assert table.refused == {"Wide": "M.Wide has 80 bits; up to 64 are understood"}
