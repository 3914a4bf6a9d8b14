"""MF4 recordings that were not closed or are cut: what is there is read, what is missing is counted."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join
from canlog.logs import LogReject, read_log
from canlog.logs.log_counts import LogCounts
from ecu_emulator.log_formats.record import open_log
from tests.support.mf4_layouts import Layout, Recording, laid_out
from tests.support.traffic import START_NS, as_received, assert_same, random_frames

asammdf = pytest.importorskip("asammdf")

COUNT = 150
FRAMES = random_frames(COUNT)
EXPECTED = as_received(FRAMES)
PACKED = {Layout.ZIPPED, Layout.ZIPPED_LIST, Layout.TRANSPOSED_LIST}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of asammdf, finished and not packed."""
    folder = tmp_path_factory.mktemp("mf4")
    with open_log(folder / "drive.mf4", start_ns=START_NS) as log:
        log.write(FRAMES)
    with asammdf.MDF(folder / "drive.mf4") as mdf:
        mdf.save(folder / "plain.mf4", compression=0)
    return folder / "plain.mf4"


def read(contents: bytes, folder: Path) -> tuple[FrameBatch, LogCounts]:
    path = folder / "cut.mf4"
    path.write_bytes(contents)
    reader = read_log(path)
    batches = list(reader)
    return join(batches), reader.counts


def assert_beginning(batch: FrameBatch) -> None:
    assert_same(batch, EXPECTED[: len(batch)])


def cuts(recording: Recording) -> list[tuple[int, int]]:
    """Return places to cut at, and how many whole records are before each."""
    ends = np.array(recording.record_ends)
    wanted = {
        int(ends[-1]) - 1,  # inside the last record
        int(ends[-1]) - 300,
        int(ends[-1]) - recording.record_bytes + 1,
        int(ends[70]),  # at the end of one
        int(ends[70]) + 1,  # behind its record id, if it has one
        int(ends[70]) + recording.record_bytes - 1,
        *(int(end) + into for end in (ends[39], ends[79]) for into in (1, 8, 23, 24, 25, 47, 48)),  # in block headers
    }
    first = recording.data_at + recording.record_bytes + 300  # enough for a record, packed or not
    return [(cut, int((ends <= cut).sum())) for cut in sorted(wanted) if first < cut < int(ends[-1])]


@pytest.mark.parametrize("layout", Layout)
@pytest.mark.parametrize("is_sorted", [True, False], ids=["sorted", "unsorted"])
def test_whole_files_lose_nothing(plain: Path, layout: Layout, is_sorted: bool, tmp_path: Path) -> None:
    for is_finished, is_listed in ((True, True), (False, True), (False, False)):
        recording = laid_out(plain, layout, is_sorted=is_sorted, is_finished=is_finished, is_listed=is_listed)
        batch, counts = read(recording.contents, tmp_path)
        assert len(batch) == COUNT
        assert_beginning(batch)
        assert counts == LogCounts(frames=COUNT, unfinished=not is_finished)


@pytest.mark.parametrize("layout", Layout)
@pytest.mark.parametrize("is_sorted", [True, False], ids=["sorted", "unsorted"])
def test_a_finished_file_that_is_cut_gives_its_beginning_and_counts_the_rest(
    plain: Path, layout: Layout, is_sorted: bool, tmp_path: Path
) -> None:
    recording = laid_out(plain, layout, is_sorted=is_sorted, is_finished=True)
    for cut, whole in cuts(recording):
        batch, counts = read(recording.contents[:cut], tmp_path)
        assert_beginning(batch)
        assert len(batch) >= whole
        assert layout in PACKED or len(batch) == whole
        assert counts.truncated
        if len(batch) == COUNT:  # only a checksum is missing
            assert layout in PACKED
            continue
        assert counts.rejected == {LogReject.CUT_OFF: COUNT - len(batch)}
        assert counts.first_rejected == f"record {len(batch) + 1} of group 0: cut_off"


@pytest.mark.parametrize("is_listed", [True, False], ids=["listed", "not listed"])
@pytest.mark.parametrize("layout", Layout)
@pytest.mark.parametrize("is_sorted", [True, False], ids=["sorted", "unsorted"])
def test_an_unfinished_file_that_ends_anywhere_gives_every_whole_record(
    plain: Path, layout: Layout, is_sorted: bool, is_listed: bool, tmp_path: Path
) -> None:
    recording = laid_out(plain, layout, is_sorted=is_sorted, is_finished=False, is_listed=is_listed)
    for cut, whole in cuts(recording)[:: 1 if layout is Layout.PLAIN else 3]:
        batch, counts = read(recording.contents[:cut], tmp_path)
        assert_beginning(batch)
        assert len(batch) >= whole
        assert layout in PACKED or len(batch) == whole
        assert counts.unfinished
        assert set(counts.rejected.values()) <= {1}
        if layout is Layout.PLAIN:
            assert (counts.rejected == {LogReject.CUT_OFF: 1}) == (cut not in recording.record_ends)


def test_damage_between_records_ends_them_and_is_counted(plain: Path, tmp_path: Path) -> None:
    recording = laid_out(plain, Layout.PLAIN, is_sorted=False, is_finished=False)
    contents = bytearray(recording.contents)
    contents[recording.record_ends[99]] = 9  # the id of no kind of record
    batch, counts = read(bytes(contents), tmp_path)
    assert len(batch) == 100
    assert_beginning(batch)
    assert counts.truncated
    assert counts.rejected == {LogReject.DAMAGED: 1}


def test_a_file_that_ends_before_its_records_is_one_clear_error(plain: Path, tmp_path: Path) -> None:
    recording = laid_out(plain, Layout.PLAIN, is_sorted=True, is_finished=True)
    for cut in (63, 64, 100, 500, recording.data_at // 2, recording.data_at, recording.data_at + 24):
        with pytest.raises(SourceError, match=r"damaged|no CAN frame"):
            read(recording.contents[:cut], tmp_path)


def test_cuts_are_at_many_kinds_of_places(plain: Path) -> None:
    for layout in Layout:
        recording = laid_out(plain, layout, is_sorted=True, is_finished=True)
        assert len(cuts(recording)) >= (2 if layout is Layout.ZIPPED else 5)
        assert all(first <= second for first, second in pairwise(recording.record_ends))
