"""Any frames in any format, by writers that are not ours: frames, times, channels, directions, flags and counts.

And such logs changed anywhere: reading ends in frames by the columns' rules, in counts of every line, or in one error.
"""

import struct
import tempfile
import zlib
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from canlog.errors import SourceError
from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG, FrameBatch, join
from canlog.logs import read_log
from canlog.logs.detection import TEXT_LOGS
from canlog.logs.log_counts import LogCounts
from canlog.logs.text_kernels import IS_LENGTH
from canlog.logs.text_log import LOOK_AHEAD_BYTES, ends_by_returns
from tests.support import measurements
from tests.support.capture_grammars import CAPTURE_GRAMMARS
from tests.support.log_grammars import CODE_OF_LENGTH, GRAMMARS, PACKERS, Frame, Grammar
from tests.support.wild_grammars import CONSOLE_GAPS, WILD_GRAMMARS

NO_JUMP_US = 900_000  # a longer gap is counted, too
LEAST_GAP_US = 200  # more frames than that no bus carries


@st.composite
def frames(draw: st.DrawFn) -> list[Frame]:
    """Return frames at rising times, each of any kind that CAN has."""
    t_us = draw(st.integers(0, 3_000))
    found = []
    for _ in range(draw(st.integers(1, 25))):
        is_extended, is_fd = draw(st.booleans()), draw(st.booleans())
        kind = draw(st.sampled_from(["data"] * 4 + ["remote", "error"]))
        length = draw(st.sampled_from(list(CODE_OF_LENGTH) if is_fd and kind == "data" else range(9)))
        found.append(
            Frame(
                t_us=t_us,
                can_id=draw(st.integers(0, 0x1FFF_FFFF if is_extended else 0x7FF)),
                is_extended=is_extended,
                length=length,
                data=draw(st.binary(min_size=length, max_size=length)),
                is_remote=kind == "remote",
                is_error=kind == "error",
                is_fd=is_fd,
                is_fast=draw(st.booleans()),
                is_passive=draw(st.booleans()),
                is_sent=draw(st.booleans()),
                channel=draw(st.integers(0, 19)),
            )
        )
        t_us += draw(st.integers(LEAST_GAP_US, NO_JUMP_US // 100))
    return found


def row(frame: Frame, grammar: Grammar) -> tuple[int, int, int, str, int, int]:
    """Return a frame as the columns must have it."""
    kind = (EXTENDED_FLAG if frame.is_extended else 0) | (REMOTE_FLAG if frame.is_remote else 0)
    fd_flags = FD_FLAG | BRS_FLAG * frame.is_fast | ESI_FLAG * frame.is_passive if frame.is_fd else 0
    return (
        (grammar.start_us + frame.t_us) * 1000,
        ERROR_FLAG if frame.is_error else frame.can_id | kind,
        frame.length,
        frame.data.ljust(frame.length, b"\0").hex(),
        fd_flags | (TX_FLAG if frame.is_sent else 0),
        frame.channel + grammar.first_channel if grammar.channels > 1 else -1,
    )


def rows(batch: FrameBatch, grammar: Grammar) -> list[tuple[int, int, int, str, int, int]]:
    assert not np.any(batch.data[np.arange(batch.width) >= batch.length[:, None]])
    return [
        (int(t_ns), int(can_id), int(length), bytes(data[:length]).hex(), int(flags), int(channel))
        for t_ns, can_id, length, data, flags, channel in zip(
            batch.t_ns, batch.can_id, batch.length, batch.data, batch.flags,
            batch.channel.astype(int) if grammar.channels > 1 else np.full(len(batch), -1), strict=True,
        )
    ]  # fmt: skip


ALL_GRAMMARS = {**GRAMMARS, **WILD_GRAMMARS, **CAPTURE_GRAMMARS}


@pytest.mark.parametrize("name", ALL_GRAMMARS)
@settings(max_examples=12, deadline=None)
@given(drawn=frames(), packer=st.sampled_from(sorted(PACKERS)))
def test_what_is_written_is_read(name: str, drawn: list[Frame], packer: str) -> None:
    grammar = ALL_GRAMMARS[name]
    first_us = drawn[0].t_us if grammar.starts_with_a_frame else 0
    written = [grammar.sayable(replace(frame, t_us=frame.t_us - first_us)) for frame in drawn]
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"drive.{name.split(maxsplit=1)[0]}"
        grammar.write(path, written)
        if packer != "plain":
            path.write_bytes(PACKERS[packer](path.read_bytes()))
        reader = read_log(path)
        batch = join(list(reader))
    assert reader.format == name.split(maxsplit=1)[0]
    assert rows(batch, grammar) == [row(frame, grammar) for frame in written]
    notes = reader.counts.notes if grammar.leaves_open else ()
    assert reader.counts == LogCounts(frames=len(written), skipped=reader.counts.skipped, notes=notes)


@settings(max_examples=12, deadline=None)
@given(drawn=frames())
def test_gaps_between_frames_are_added_up(drawn: list[Frame]) -> None:
    start_us = drawn[0].t_us
    written = [CONSOLE_GAPS.sayable(replace(frame, t_us=frame.t_us - start_us)) for frame in drawn]
    gaps_us = [0, *(later.t_us - sooner.t_us for sooner, later in pairwise(written))]
    assume(sum(later < sooner for sooner, later in pairwise(gaps_us)) * 5 > len(gaps_us))  # else it is taken for -t z
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.txt"
        CONSOLE_GAPS.write(path, written)
        reader = read_log(path)
        batch = join(list(reader))
    assert rows(batch, CONSOLE_GAPS) == [row(frame, CONSOLE_GAPS) for frame in written]
    assert reader.counts == LogCounts(frames=len(written), skipped=0, notes=reader.counts.notes)
    assert "candump -t d" in reader.counts.notes[0]


CONTAINER = struct.Struct("<4sHHLLH6xL4x")
FORMATS = sorted({name.split(maxsplit=1)[0] for name in ALL_GRAMMARS})
PARTS = ("blf objects", *(name for name in PACKERS if name != "plain"), "signals", "measured")
SIGNALS = (
    b"Time [ms],Speed [rpm],Cut,Note\n" + b"".join(b"%d,%d.5,on,ok\n" % (37 * row, 900 + row) for row in range(30)),
    b"a recorder\nZeit;Druck\ns;kPa\n" + b"".join(b"%d,5;%d,86\n" % (row, row) for row in range(30)),
    b"Time\tA\tA\n" + b"".join(b'23:59:%02d\t"%d"\t\n' % (row, row) for row in range(30)),
)
ALPHABET = st.sampled_from(b"0123456789ABCDEFabcdefx#()., \t\r\n;*:-_=TRrd$\0\xff").map(lambda value: bytes([value]))


def written(name: str) -> bytes:
    """Return a log of a few frames of every kind."""
    grammar = ALL_GRAMMARS[name]
    kinds = [
        Frame(t_us=9_000 * number, can_id=0x123 + number, is_extended=number % 2 == 1, length=length, is_fd=length > 8,
              data=bytes(range(length)), is_remote=number == 5, is_error=number == 6, channel=number % 3)
        for number, length in enumerate((0, 3, 8, 12, 64, 2, 8, 8))
    ]  # fmt: skip
    with tempfile.NamedTemporaryFile(suffix=f".{name.split(maxsplit=1)[0]}") as file:
        grammar.write(Path(file.name), [grammar.sayable(frame) for frame in kinds])
        return Path(file.name).read_bytes()


@cache
def sounds(name: str) -> tuple[bytes, ...]:
    """Return sound files of a format, of a packer, or of signals."""
    if name in FORMATS:
        return tuple(written(one) for one in ALL_GRAMMARS if one.split(maxsplit=1)[0] == name)
    if name in PACKERS:
        return (PACKERS[name](written("candump")),)
    if name == "blf objects":  # as BLF stores them unpacked
        log = written("blf")
        objects = zlib.decompress(log[144 + CONTAINER.size : 144 + CONTAINER.unpack_from(log, 144)[3]])
        head = CONTAINER.pack(b"LOBJ", 16, 1, CONTAINER.size + len(objects), 10, 0, len(objects))
        return (log[:144] + head + objects,)
    if name == "measured":
        times_s = np.arange(10) / 10.0
        with tempfile.NamedTemporaryFile(suffix=".mf4") as file:
            heat = measurements.Measured("Heat", "degC", 80.0 + times_s, invalid=times_s > 0.5)
            measurements.written(Path(file.name), [(times_s, [heat])])
            return (Path(file.name).read_bytes(),)
    return SIGNALS


def altered(sound: bytes) -> st.SearchStrategy[bytes]:
    """Return logs of pieces of a sound one, of characters of the grammars, and of anything."""
    lines = st.sampled_from(sound.splitlines(keepends=True))
    places = st.tuples(st.integers(0, len(sound)), st.integers(0, 200))
    pieces = places.map(lambda place: sound[place[0] : place[0] + place[1]])
    mixed = st.lists(st.one_of(lines, pieces, ALPHABET, st.binary(max_size=40)), max_size=30).map(b"".join)
    changes = st.lists(st.tuples(st.integers(0, len(sound) - 1), st.integers(0, 255)), max_size=8)
    return st.one_of(
        mixed, mixed.map(lambda rest: sound[:200] + rest), changes.map(lambda found: changed(sound, found))
    )


def changed(sound: bytes, changes: list[tuple[int, int]]) -> bytes:
    """Return a log with some of its bytes changed."""
    found = bytearray(sound)
    for place, value in changes:
        found[place] = value
    return bytes(found)


@pytest.mark.parametrize("name", [*FORMATS, *PARTS])
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_what_is_changed_anywhere_ends_in_frames_counts_or_one_error(name: str, data: st.DataObject) -> None:
    text = data.draw(st.one_of([altered(one) for one in sounds(name)]))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive"
        path.write_bytes(text)
        try:
            reader = read_log(path)
            batches = list(reader)
        except SourceError as error:
            refusal = str(error)
        else:
            refusal = ""
    assert "\n" not in refusal
    if refusal:
        return
    for batch in batches:
        assert (batch.t_ns % 1000 == 0).all()
        assert IS_LENGTH[batch.length].all()
        assert ((batch.length <= 8) | (batch.flags & FD_FLAG != 0)).all()
        is_standard = (batch.can_id & np.uint32(EXTENDED_FLAG | ERROR_FLAG)) == 0
        assert ((batch.can_id & np.uint32(0x1FFF_FFFF))[is_standard] <= 0x7FF).all()
        assert not batch.data[np.arange(batch.width) >= batch.length[:, None]].any()
    counts = reader.counts
    assert sum(len(batch) for batch in batches) == counts.frames
    if reader.format in TEXT_LOGS and name not in PACKERS:
        whole = (text.replace(b"\r", b"\n") if ends_by_returns(text[:LOOK_AHEAD_BYTES]) else text).count(b"\n")
        accounted = counts.frames + counts.skipped + sum(counts.rejected.values())
        assert whole <= accounted
        assert accounted <= whole + 1 or counts.notes  # a line of several frames is said
