"""MF4 recordings that were not closed or are cut, as asammdf completes them: a beginning that is told, or none."""

from pathlib import Path

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from canlog.logs.log_counts import LogCounts
from ecu_emulator.log_formats import open_log
from tests.support.mf4_layouts import Layout, Recording, laid_out
from tests.support.traffic import START_NS, as_received, assert_same, random_frames

asammdf = pytest.importorskip("asammdf")

COUNT = 150
FRAMES = random_frames(COUNT)
EXPECTED = as_received(FRAMES)


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
    for is_finished in {True, layout is not Layout.PLAIN}:
        recording = laid_out(plain, layout, is_sorted=is_sorted, is_finished=is_finished)
        batch, counts = read(recording.contents, tmp_path)
        assert len(batch) == COUNT
        assert_beginning(batch)
        assert counts == LogCounts(frames=COUNT, unfinished=not is_finished)


@pytest.mark.parametrize("is_sorted", [True, False], ids=["sorted", "unsorted"])
def test_an_unfinished_file_that_ends_anywhere_gives_every_whole_record(
    plain: Path, is_sorted: bool, tmp_path: Path
) -> None:
    recording = laid_out(plain, Layout.PLAIN, is_sorted=is_sorted, is_finished=False)
    for cut, whole in cuts(recording)[::2]:
        batch, counts = read(recording.contents[:cut], tmp_path)
        assert_beginning(batch)
        assert len(batch) == whole
        assert counts.unfinished


def test_a_channel_outside_its_records_is_refused(plain: Path, tmp_path: Path) -> None:
    contents = bytearray(plain.read_bytes())
    with asammdf.MDF(plain) as mdf:
        (time, *_), *_ = (group.channels for group in mdf.groups)
        offset_at = time.address + 24 + 8 * time.links_nr + 4  # behind header, links, four small fields
    assert contents[offset_at : offset_at + 4] == time.byte_offset.to_bytes(4, "little")
    contents[offset_at : offset_at + 4] = (0x7FFF_0000).to_bytes(4, "little")
    with pytest.raises(SourceError, match=r"outside its records"):
        read(bytes(contents), tmp_path)
