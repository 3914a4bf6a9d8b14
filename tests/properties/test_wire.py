"""From reading to column: nothing is lost but half a step, faults never get through, and cutting changes nothing."""

from collections.abc import Collection, Sequence
from functools import cache
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.frames import FrameBatch, join
from clutch_model.units import m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import Profile, load_profile, load_shipped
from ecu_emulator.bus.frames import SIGNAL_OF, FrameEncoder
from tests.support.wire import CONTRACTS, CYCLE_CONTRACTS, DATABASE, drive, readings, received

DRIVE: Final = received(drive(0.7))
ROWS: Final = len(DRIVE)
ENDS: Final = frozenset(
    int(row)
    for contract in CYCLE_CONTRACTS.values()
    for row in np.flatnonzero(DRIVE.can_id == np.uint32(contract.can_id))[[0, -1]]
)
INNER: Final = sorted(set(range(ROWS)) - ENDS)
"""Frames whose loss the counter can show: not the first and not the last of their message."""

Samples = set[tuple[int, float]]


@cache
def profile() -> Profile:
    return load_profile()


def decode(batches: Sequence[FrameBatch]) -> tuple[list[ColumnBatch], FrameCounts]:
    decoder = Decoder(DATABASE, profile())
    columns = [part for batch in batches for part in decoder.feed(batch)]
    return columns + decoder.drain(), decoder.counts


def samples(parts: Sequence[ColumnBatch]) -> dict[Signal, Samples]:
    found: dict[Signal, Samples] = {signal: set() for signal in Signal}
    for part in parts:
        for signal, series in part.columns.items():
            found[signal].update(zip(series.t_ns.tolist(), series.value.tolist(), strict=True))
    return found


CLEAN: Final = samples(decode([DRIVE])[0])


def take(batch: FrameBatch, rows: Sequence[int]) -> FrameBatch:
    return batch[np.array(rows, np.int64)]


def damage(row: int, kind: str, batch: FrameBatch, bits: Sequence[int]) -> None:
    """Spoil one frame in place: flip bits, or cut it short."""
    if kind == "flip":
        for bit in bits:
            batch.data[row, bit // 8] ^= np.uint8(1 << bit % 8)
    elif kind == "short":
        batch.length[row] = bits[0] % 8
        batch.data[row, batch.length[row] :] = 0


def frozen(row: int, wrong: Collection[int]) -> int:
    """Return the last frame of the same message that arrived in order: a stuck sender repeats it."""
    earlier = np.flatnonzero(DRIVE.can_id[:row] == DRIVE.can_id[row])
    return int(earlier[~np.isin(earlier, list(wrong))][-1])


few_bits = st.lists(st.integers(0, 63), min_size=1, max_size=2, unique=True)  # this CRC catches any two
faults = st.dictionaries(
    st.sampled_from(INNER), st.tuples(st.sampled_from(["flip", "short", "freeze", "drop"]), few_bits), max_size=12
)
"""Fewer than a counter period: a stuck counter cannot be told from a loss of exactly one period."""


def spoiled(wrong: dict[int, tuple[str, list[int]]]) -> FrameBatch:
    batch = take(DRIVE, range(ROWS))
    for row, (kind, bits) in wrong.items():
        damage(row, kind, batch, bits)
        if kind == "freeze":
            batch.data[row] = DRIVE.data[frozen(row, wrong)]
    return take(batch, [row for row in range(ROWS) if wrong.get(row, ("",))[0] != "drop"])


@given(faults)
def test_faults_never_reach_a_column(wrong: dict[int, tuple[str, list[int]]]) -> None:
    parts, counts = decode([spoiled(wrong)])
    for signal, got in samples(parts).items():
        assert got <= CLEAN[signal]
    spoiled_times = {(int(DRIVE.can_id[row]), int(DRIVE.t_ns[row])) for row in wrong}
    assert counts.decoded <= ROWS - len(spoiled_times)
    assert counts.is_balanced


@given(faults)
def test_every_frame_sent_is_decoded_rejected_or_missing(wrong: dict[int, tuple[str, list[int]]]) -> None:
    _, counts = decode([spoiled(wrong)])
    assert counts.decoded + sum(counts.rejected.values()) + counts.missing == ROWS
    assert counts.missing == sum(kind == "drop" for kind, _ in wrong.values())


@given(st.integers(0, len(INNER) - 1), st.integers(1, 300))
def test_a_gap_of_any_length_is_counted_to_the_frame(first: int, length: int) -> None:
    gone = set(INNER[first : first + length])
    _, counts = decode([take(DRIVE, [row for row in range(ROWS) if row not in gone])])
    assert counts.missing == len(gone)
    assert not counts.rejected


@st.composite
def cut_streams(draw: st.DrawFn) -> list[FrameBatch]:
    """Draw a stream with faults, copies and a jump of bus time, cut anywhere."""
    batch = spoiled(draw(faults))
    copied = sorted([*range(len(batch)), *draw(st.lists(st.integers(0, len(batch) - 1), max_size=5))])
    batch = take(batch, copied)
    jump = draw(st.integers(0, len(batch)))
    batch.t_ns[jump:] += draw(st.sampled_from([0, -(10**9), 5 * 10**9]))
    cuts = sorted(draw(st.lists(st.integers(0, len(batch)), max_size=12)))
    return [batch[start:stop] for start, stop in zip([0, *cuts], [*cuts, len(batch)], strict=True)]


def joined(parts: Sequence[ColumnBatch]) -> list[dict[str, list[float]]]:
    """Return what was decoded, one table per segment."""
    segments: list[dict[str, list[float]]] = [{}]
    for part in parts:
        if part.breaks_before:
            segments.append({})
        for signal, series in part.columns.items():
            for name, column in (("t", series.t_ns), ("sequence", series.sequence), ("value", series.value)):
                segments[-1].setdefault(f"{signal.value} {name}", []).extend(column.tolist())
        segments[-1].setdefault("bad", []).extend(part.bad_frame_ns.tolist())
    return segments


@given(cut_streams())
def test_cutting_the_stream_changes_nothing(pieces: list[FrameBatch]) -> None:
    at_once, counts = decode([join(pieces)])
    in_pieces, piecewise_counts = decode(pieces)
    assert joined(in_pieces) == joined(at_once)
    assert piecewise_counts == counts


@settings(max_examples=25)
@given(st.integers(0, 2**32))
def test_sequence_numbers_only_grow(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kept = np.flatnonzero(rng.random(ROWS) < rng.uniform(0.2, 1.0))
    batch = take(DRIVE, kept.tolist())
    batch.t_ns[:] = np.sort(batch.t_ns + rng.integers(0, 30_000, len(batch)) * 1000)
    parts, counts = decode([batch])
    for part in parts:
        for series in part.columns.values():
            assert (np.diff(series.sequence) > 0).all()
    assert counts.missing >= 0


HALF_STEP: Final = {
    "rad_s": float(rad_s_from_rpm(0.125)),
    "m_s": float(m_s_from_km_h(0.02)),
    "pa": float(pa_from_bar(0.1)),
    "ratio": 0.002,
    "nm": 0.5,
    "k": 0.5,
    "m": 0.5,
}
FINER: Final = {"vehicle_speed_m_s": float(m_s_from_km_h(0.005)), "ambient_temperature_k": 0.25}
FINER_PRESSURE_PA: Final = float(pa_from_bar(0.005))


def half_step(quantity: str) -> float:
    """Return half the resolution with which a quantity is sent."""
    if quantity.startswith("clutch") and quantity.endswith("_pa"):
        return FINER_PRESSURE_PA
    kind = next((kind for kind in ("rad_s", "m_s", "ratio", "nm", "pa", "k", "m") if quantity.endswith(f"_{kind}")), "")
    return FINER.get(quantity, HALF_STEP.get(kind, 0.5))


@pytest.mark.parametrize("name", sorted(CYCLE_CONTRACTS))
@given(seed=st.integers(0, 2**32))
@settings(max_examples=20)
def test_what_is_sent_arrives_within_half_a_step(name: str, seed: int) -> None:
    t_s = np.arange(20) * CONTRACTS[name].cycle_ms / 1000.0
    sent = readings(name, t_s, np.random.default_rng(seed))
    parts, counts = decode([received(FrameEncoder(DATABASE).encode(sent))])
    assert counts.invalid_values == 0
    canonical = {signal.value: signal for signal in load_shipped("dct").sources}
    for quantity in sent.values.keys() & canonical.keys():
        arrived = np.concatenate([part.columns[canonical[quantity]].value for part in parts])
        slack = 1e-9 * (1.0 + np.abs(arrived))
        assert (np.abs(arrived - sent.values[quantity]) <= half_step(quantity) + slack).all(), SIGNAL_OF[quantity]
