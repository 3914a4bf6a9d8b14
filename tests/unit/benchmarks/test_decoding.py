"""What the decoding benchmark decodes is what it says."""

from pathlib import Path

import numpy as np

from benchmarks.decode import decode_all, decode_each, iterate_shifts
from benchmarks.decoding.hour import write_hour
from benchmarks.decoding.layout import database, random_batches
from canlog.decode.codec import Codec
from canlog.frames import join
from canlog.logs import read_log
from tests.support.wire import drive, received


def test_ten_messages_with_64_signals() -> None:
    messages = database().messages
    assert len(messages) == 10
    assert sum(len(message.signals) for message in messages) == 64
    assert {signal.byte_order for message in messages for signal in message.signals} == {"big_endian", "little_endian"}
    assert sum(message.is_multiplexed() for message in messages) == 2


def test_both_sides_decode_every_frame() -> None:
    batches, codec = random_batches(100_000), Codec(database().messages)
    assert [len(batch) for batch in batches] == [65_536, 100_000 - 65_536]
    assert sum(len(found.rows) for batch in batches for found in codec.decode(batch)) == 100_000
    decode_all(batches, codec)
    frames = [
        (int(can_id), row.tobytes()) for can_id, row in zip(batches[0].can_id[:50], batches[0].data, strict=False)
    ]
    decode_each(frames, database())


def test_long_log_is_the_drive_again_and_again_in_both_formats(tmp_path: Path) -> None:
    batch = received(drive(1.0))
    count = 2 * len(batch) + 7
    logs = tmp_path / "hour.log", tmp_path / "hour.blf"
    duration_s = write_hour(batch, count, *logs)
    round_ns = batch.t_ns[-1] - batch.t_ns[0] + 2_000_000_000
    for path in logs:
        found = join(list(read_log(path)))
        assert len(found) == count
        assert np.array_equal(found.data[: len(batch)], batch.data)
        assert np.array_equal(found.data[len(batch) : 2 * len(batch)], batch.data)
        assert np.array_equal(found.t_ns[len(batch) : 2 * len(batch)], batch.t_ns + round_ns)
        assert duration_s == (found.t_ns[-1] - found.t_ns[0]) / 1e9


def test_batches_are_counted_while_shifts_are_looked_for(tmp_path: Path) -> None:
    logs = tmp_path / "hour.log", tmp_path / "hour.blf"
    write_hour(received(drive(0.5)), 400, *logs)
    seen: list[int] = []
    list(iterate_shifts(logs[0], seen.append))
    assert seen == [1]
