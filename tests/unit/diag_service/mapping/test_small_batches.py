"""Few frames at a time are decoded by another path than many: to the same bits, with the same counts."""

import numpy as np
import pytest

from canlog.database.loading import load_database
from canlog.decode.signal_table import InvalidCounts
from canlog.frames import EXTENDED_FLAG, FrameBatch
from dbc.contract import load_contract
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import PROFILE_FOLDER, load_profile, load_shipped
from diag_service.mapping.small_batches import SMALL_FRAMES
from tests.wire import drive, received


def damaged_drive() -> FrameBatch:
    """Return frames of which some have flipped bits, are short, come twice or not at all, or say not available."""
    batch = received(drive(9.0, seed=5))
    rng = np.random.default_rng(6)
    batch.data[rng.random(len(batch)) < 0.05, 3] ^= 0x55
    batch.length[rng.random(len(batch)) < 0.02] = 3
    rows = np.sort(np.concatenate((np.flatnonzero(rng.random(len(batch)) < 0.97), rng.integers(0, len(batch), 20))))
    return batch[rows]


def decoder() -> Decoder:
    return Decoder(load_contract(), load_profile())


def joined(parts: list[ColumnBatch]) -> dict[Signal, tuple[bytes, bytes, bytes]]:
    """Return all samples as bytes."""
    signals = {signal for part in parts for signal in part.columns}
    return {
        signal: (
            b"".join(part.columns[signal].t_ns.tobytes() for part in parts if signal in part.columns),
            b"".join(part.columns[signal].sequence.tobytes() for part in parts if signal in part.columns),
            b"".join(part.columns[signal].value.tobytes() for part in parts if signal in part.columns),
        )
        for signal in signals
    }


@pytest.mark.parametrize("size", [1, 10, 300, SMALL_FRAMES])
def test_small_batches_give_the_bits_of_large_ones(size: int) -> None:
    batch = damaged_drive()
    assert len(batch) > SMALL_FRAMES
    whole, pieces = decoder(), decoder()
    at_once = whole.feed(batch)
    in_pieces = [part for first in range(0, len(batch), size) for part in pieces.feed(batch[first : first + size])]
    assert joined(in_pieces) == joined(at_once)
    assert pieces.counts == whole.counts
    assert pieces.seen == whole.seen
    assert whole.counts.rejected
    bad_ns = np.concatenate([part.bad_frame_ns for part in in_pieces])
    assert np.array_equal(bad_ns, np.concatenate([part.bad_frame_ns for part in at_once]))


def test_a_block_reads_like_a_mapping() -> None:
    batch = received(drive(0.2, seed=1))
    small = decoder().feed(batch[:SMALL_FRAMES])[0].columns
    assert len(small) == len(list(small)) > 10
    assert all(len(small[signal].t_ns) for signal in small)
    with pytest.raises(KeyError):
        decoder().feed(batch[:1])[0].columns[Signal.BRAKE_PRESSURE]


def test_values_that_are_no_measurements_are_counted_alike_by_reason() -> None:
    count = SMALL_FRAMES + 500
    data = np.zeros((count, 8), np.uint8)
    data[:, 4] = np.arange(count) % 256  # the high byte of the engine speed, of which FB to FF say something else
    batch = FrameBatch(
        t_ns=np.arange(count) * 10_000_000,
        can_id=np.full(count, 0x0CF0_0400 | EXTENDED_FLAG, np.uint32),
        length=np.full(count, 8, np.uint8),
        data=data,
    )
    database = load_database(PROFILE_FOLDER / "j1939.dbc")
    whole, pieces = Decoder(database, load_shipped("j1939")), Decoder(database, load_shipped("j1939"))
    whole.feed(batch)
    for first in range(0, count, 100):
        pieces.feed(batch[first : first + 100])
    not_available = int(np.count_nonzero(data[:, 4] >= 0xFB))
    assert whole.counts.invalid == {Signal.ENGINE_SPEED: InvalidCounts(not_available=not_available)}
    assert pieces.counts == whole.counts
