"""Log readers under any bytes: they end, they count everything, and they invent nothing."""

import io

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.logs.asc import AscLog
from canlog.logs.blf import read_blf
from canlog.logs.candump import CandumpLog
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_log import reader_of
from ecu_emulator.log_formats.writers import BlfWriter, CandumpWriter, Header
from tests.support.traffic import START_NS, as_received, random_frames

FRAMES = random_frames(60)
EXPECTED = as_received(FRAMES)


def written(writer: type[BlfWriter] | type[CandumpWriter]) -> bytes:
    stream = io.BytesIO()
    log = writer(stream, Header(start_us=START_NS // 1000, channel="vcan0"))
    log.write(EXPECTED.t_ns // 1000, FRAMES)
    log.close()
    return stream.getvalue()


BLF = written(BlfWriter)
CANDUMP = written(CandumpWriter)
KNOWN = {
    (int(t_ns), int(can_id), bytes(data))
    for t_ns, can_id, data in zip(EXPECTED.t_ns, EXPECTED.can_id, EXPECTED.data, strict=True)
}
TEXT = st.lists(st.one_of(st.sampled_from(CANDUMP.splitlines()), st.binary(max_size=60)), max_size=20)


@settings(deadline=None)  # the first call loads compiled code
@given(TEXT)
def test_every_line_of_a_candump_log_is_accounted_for(lines: list[bytes]) -> None:
    text = b"".join(line + b"\n" for line in lines)
    counts = LogCounts()
    frames = sum(len(batch) for batch in reader_of(CandumpLog)(io.BytesIO(text), counts))
    assert frames == counts.frames
    assert counts.frames + counts.skipped + sum(counts.rejected.values()) == text.count(b"\n")


@settings(deadline=None)  # the first call loads compiled code
@given(st.lists(st.binary(max_size=60), max_size=20))
def test_any_text_passes_through_the_asc_reader(lines: list[bytes]) -> None:
    counts = LogCounts()
    frames = sum(len(batch) for batch in reader_of(AscLog)(io.BytesIO(b"base hex\n" + b"\n".join(lines)), counts))
    assert frames == counts.frames


@settings(deadline=None)  # the first call loads compiled code
@given(st.integers(0, len(CANDUMP)))
def test_a_candump_log_cut_anywhere_is_a_beginning_of_itself(cut: int) -> None:
    counts = LogCounts()
    batches = list(reader_of(CandumpLog)(io.BytesIO(CANDUMP[:cut]), counts))
    t_ns = np.concatenate([batch.t_ns for batch in batches]) if batches else np.empty(0, np.int64)
    data = np.concatenate([batch.data for batch in batches]) if batches else np.empty((0, 8), np.uint8)
    assert np.array_equal(t_ns, EXPECTED.t_ns[: len(t_ns)])
    assert np.array_equal(data, EXPECTED.data[: len(data)])
    assert counts.truncated == (counts.rejected == {LogReject.CUT_OFF: 1})


@settings(deadline=None)  # the first call loads compiled code
@given(st.integers(144, len(BLF) - 1), st.binary(min_size=1, max_size=40))
def test_a_blf_file_overwritten_anywhere_ends_and_invents_no_frame(place: int, damage: bytes) -> None:
    contents = BLF[:place] + damage + BLF[place + len(damage) :]
    counts = LogCounts()
    found = {
        (int(t_ns), int(can_id), bytes(data))
        for batch in read_blf(io.BytesIO(contents), counts)
        for t_ns, can_id, data in zip(batch.t_ns, batch.can_id, batch.data, strict=True)
    }
    assert found <= KNOWN
    # An object whose kind was overwritten is one of a kind that holds no frames.
    assert found == KNOWN or counts.rejected or counts.truncated or counts.skipped
