"""Logs with faults: strictness, jumps of time, overlapping logs, generated damage, and files made to do harm."""

import gzip
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import join
from canlog.logs import LogReject, merged_by_time, read_log
from canlog.logs.log_counts import FREE_BYTES, LogCounts
from diag_service.errors import ConfigError
from diag_service.service.drive import open_drive
from ecu_emulator.log_formats import open_log
from tests.support.damage import DAMAGES, analyse, decoder_of, untrue
from tests.support.damage import record as record_drive
from tests.support.hostile import HOSTILE, refusals_of
from tests.support.traffic import START_NS, as_received, assert_same, random_frames

FRAMES = random_frames(3_000)


def write(path: Path, *lines: bytes) -> Path:
    path.write_bytes(b"".join(line + b"\n" for line in lines))
    return path


def line(t_s: float, can_id: int = 0x123, data: bytes = b"11") -> bytes:
    return b"(%.6f) can0 %03X#%s" % (t_s, can_id, data)


def test_jumps_of_time_and_repeated_frames_are_counted_and_the_first_is_named(tmp_path: Path) -> None:
    lines = [line(10.0), line(10.5), line(9.5), line(9.5), line(9.5, data=b"12"), line(12.0), line(12.1)]
    reader = read_log(write(tmp_path / "drive.log", *lines))
    assert sum(len(batch) for batch in reader) == 7
    assert reader.counts == LogCounts(
        frames=7, jumps_back=1, jumps_ahead=1, first_jump="frame 3: time jumps by -1.000000 s", repeated=1
    )


def test_rows_that_come_less_often_than_once_a_second_are_no_jumps(tmp_path: Path) -> None:
    rows = (b"%.1f,%d,%d" % (2.5 * number, 900 + number, 100 + number) for number in range(40))
    reader = read_log(write(tmp_path / "slow.csv", b"Time [s],Speed [rpm],Pressure [kPa]", *rows))
    assert sum(len(batch) for batch in reader) == 80
    assert (reader.counts.jumps_ahead, reader.counts.jumps_back) == (0, 0)


@pytest.mark.parametrize(
    ("lines", "fault"),
    [
        ([line(1.0), b"garbage", line(1.1)], "line 2: malformed"),
        ([line(1.0), line(0.5)], "frame 2: time jumps by -0.500000 s"),
        ([line(1.0), line(3.0)], "frame 2: time jumps by .2.000000 s"),
    ],
)
def test_a_strict_reader_stops_at_the_first_fault_and_says_where(
    lines: list[bytes], fault: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "drive.log", *lines)
    assert join(list(read_log(path)))
    with pytest.raises(SourceError, match=fault) as caught:
        list(read_log(path, is_strict=True))
    assert str(caught.value).count(str(path)) == 1


def test_logs_that_overlap_are_merged_by_time(tmp_path: Path) -> None:
    paths = [tmp_path / "a.log", tmp_path / "b.blf", tmp_path / "c.mf4"]
    rows = [slice(0, 2_000, 2), slice(1, 2_000, 2), slice(2_000, 3_000)]
    for path, part in zip(paths, rows, strict=True):
        with open_log(path, start_ns=START_NS) as log:
            log.write(FRAMES[part])
    merged = join(list(merged_by_time([iter(read_log(path)) for path in reversed(paths)])))
    expected = as_received(FRAMES)
    assert np.array_equal(merged.t_ns, expected.t_ns)
    assert set(zip(merged.t_ns.tolist(), merged.can_id.tolist(), strict=True)) == set(
        zip(expected.t_ns.tolist(), expected.can_id.tolist(), strict=True)
    )


def test_the_same_recording_twice_is_an_error(tmp_path: Path) -> None:
    first, second = (write(tmp_path / name, line(1.0), line(1.1)) for name in ("a.log", "b.log"))
    with pytest.raises(ConfigError, match="same recording"), open_drive([first, second]):
        pass
    with pytest.raises(ConfigError, match="twice"), open_drive([first, first]):
        pass


def test_what_is_made_to_do_harm_is_refused_within_limits(tmp_path: Path) -> None:
    for name, make in HOSTILE.items():
        make(tmp_path / name)
    found = refusals_of([tmp_path / name for name in HOSTILE])
    assert {name: one for name, one in zip(HOSTILE, found, strict=True) if not one.is_good} == {}


@pytest.mark.parametrize("suffix", [".log", ".blf", ".mf4", ".csv"])
def test_damage_is_survived_and_makes_no_estimate_untrue(suffix: str, tmp_path: Path) -> None:
    path, broken = tmp_path / f"sound{suffix}", tmp_path / f"damaged{suffix}"
    record_drive(path)
    decoder, contents, accepted = decoder_of(path), path.read_bytes(), 0
    for seed in range(3):
        for number, damage in enumerate(DAMAGES):
            broken.write_bytes(damage(contents, np.random.default_rng([seed, number])))
            estimates, error = analyse(broken, decoder)
            assert ([*untrue(estimates)], "\n" in error) == ([], False), damage.__name__
            accepted += sum(estimate.friction is not None for estimate in estimates)
    assert accepted > 0


def test_a_pressure_that_is_held_through_a_shift_makes_no_friction(tmp_path: Path) -> None:
    table = tmp_path / "held.csv"
    record_drive(table)
    decoder = decoder_of(table)
    whole, _ = analyse(table, decoder)
    head, *rows = (line.split(",") for line in table.read_text("utf-8").splitlines())
    held = next(place for place, name in enumerate(head) if name.startswith("Clutch 2 Pressure"))
    for row in rows:
        if float(row[0]) > float(rows[0][0]) + 3_280.0:  # from just before it lets go of second gear
            row[held] = "914.16"
    table.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n", "utf-8")
    for estimates, least in ((whole, 2), (analyse(table, decoder)[0], 1)):
        found = [one.friction for one in estimates if one.friction is not None]
        assert len(found) >= least
        assert all(one.mu_c > 0.05 for one in found)


def record(path: Path) -> None:
    """Write sixty thousand frames."""
    with open_log(path.with_suffix("") if path.suffix == ".gz" else path, start_ns=START_NS) as log:
        log.write(random_frames(60_000))
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(path.with_suffix("").read_bytes()))


@pytest.mark.parametrize("suffix", [".log", ".blf", ".mf4", ".log.gz"])
def test_a_file_that_shrinks_while_it_is_read_is_counted_as_cut(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive{suffix}"
    record(path)
    contents = path.read_bytes()
    for is_begun in (False, True):
        path.write_bytes(contents)
        reader = read_log(path)
        frames = len(next(reader)) if is_begun else 0
        with path.open("r+b") as file:
            file.truncate(3_000)
        with suppress(SourceError):  # if nothing is left
            frames += sum(len(batch) for batch in reader)
        assert frames == reader.counts.frames
        assert reader.counts.truncated
        assert reader.counts.rejected[LogReject.CUT_OFF] >= 1


def test_zeros_behind_a_log_are_left_unread_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "drive.blf"
    with open_log(path, start_ns=START_NS) as log:
        log.write(FRAMES)
    with path.open("r+b") as file:
        file.truncate(2 * FREE_BYTES)
    reader = read_log(path)
    assert_same(list(reader), as_received(FRAMES))
    assert reader.counts.rejected[LogReject.GIVEN_UP] == 1
    assert reader.counts.truncated
