"""One compiled pass for few frames and for many: the bits of each signal's own table, however the stream is cut."""

import numpy as np
import pytest

from canlog.database.loading import load_database
from canlog.decode.signals import InvalidCounts, PayloadWords
from canlog.e2e.protection_check import FrameReason, FrameVerdicts
from canlog.frames import FrameBatch
from dbc.contract import load_contract
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping.decoder import Decoder, SamplePass
from diag_service.mapping.mapped_messages import MessageColumns, map_signals
from diag_service.mapping.profile import PROFILE_FOLDER, Profile, load_profile, load_shipped
from tests.support.batches import frames_at
from tests.support.wire import drive, received


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


@pytest.mark.parametrize("size", [1, 10, 300, 3000])
def test_small_batches_give_the_bits_of_large_ones(size: int) -> None:
    batch = damaged_drive()
    whole, pieces = decoder(), decoder()
    at_once = whole.feed(batch)
    in_pieces = [part for first in range(0, len(batch), size) for part in pieces.feed(batch[first : first + size])]
    assert joined(in_pieces) == joined(at_once)
    assert (pieces.counts, pieces.messages) == (whole.counts, whole.messages)
    assert pieces.seen == whole.seen
    assert whole.counts.rejected
    bad_ns = np.concatenate([part.bad_frame_ns for part in in_pieces])
    assert np.array_equal(bad_ns, np.concatenate([part.bad_frame_ns for part in at_once]))


def any_frames(messages: tuple[MessageColumns, ...], count: int, width: int) -> tuple[FrameBatch, FrameVerdicts]:
    """Return frames of any payload of some messages, each accepted, rejected or of nobody."""
    rng = np.random.default_rng(count + width)
    slot = rng.integers(-1, len(messages), count)
    reason = np.where(slot < 0, FrameReason.UNKNOWN_ID, rng.choice([FrameReason.OK, FrameReason.BAD_CRC], count))
    t_ns = np.cumsum(rng.integers(0, 10**7, count))
    batch = frames_at(t_ns, 1, width, rng.integers(0, 256, (count, width), dtype=np.uint8))
    sequence, missing = np.arange(count), np.zeros(count, np.int64)
    return batch, FrameVerdicts(reason=reason.astype(np.uint8), slot=slot, sequence=sequence, missing=missing)


@pytest.mark.parametrize("width", [8, 64])
@pytest.mark.parametrize("count", [0, 1, 17, 2000])
@pytest.mark.parametrize("profile", [load_profile(), load_shipped("j1939")], ids=lambda profile: profile.name)
def test_the_pass_gives_what_each_table_says_of_any_payload(profile: Profile, count: int, width: int) -> None:
    database = load_database(PROFILE_FOLDER / "j1939.dbc") if profile.name == "j1939" else load_contract()
    messages = map_signals(database, profile)
    batch, verdicts = any_frames(messages, count, width)
    found = SamplePass(messages).decode(batch, verdicts)
    for slot, mapped in enumerate(messages):
        rows = np.flatnonzero((verdicts.slot == slot) & (verdicts.reason == FrameReason.OK))
        assert np.array_equal(found.rows(slot), rows)
        for column in mapped.columns:
            wanted = column.table.decode(PayloadWords(batch.data, rows))
            good = np.ones(len(rows), np.bool_) if wanted.is_good is None else wanted.is_good
            assert found.invalid.get(column.signal, InvalidCounts()) == wanted.invalid
            if not good.any():
                assert column.signal not in found.samples
                continue
            series = found.samples[column.signal]
            assert series.t_ns.tolist() == batch.t_ns[rows[good]].tolist()
            assert series.sequence.tolist() == rows[good].tolist()
            assert series.value.tobytes() == column.to_si(wanted.value[good]).tobytes()
