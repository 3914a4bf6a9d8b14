"""Any frames in any format, by writers that are not ours: frames, times, channels, directions, flags and counts."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG, FrameBatch, join
from canlog.logs import read_log
from canlog.logs.log_counts import LogCounts
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
