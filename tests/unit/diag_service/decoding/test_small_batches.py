"""Few frames at a time are decoded by another path than many: to the same bits, with the same counts."""

import numpy as np
import pytest

from dbc.contract import DBC_PATH
from diag_service.columns import ColumnBatch, Signal
from diag_service.decoding.mapping import Decoder
from diag_service.decoding.small_batches import SMALL_FRAMES
from diag_service.definitions.database import load_database
from diag_service.definitions.profile import load_profile
from diag_service.frames import FrameBatch
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
    return Decoder(load_database(DBC_PATH), load_profile())


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
