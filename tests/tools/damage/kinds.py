"""The ways in which a recording is damaged, each with what can be known of the result."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.record import DEFAULT_START_NS
from tests.tools.damage.expected import Expected, Jump, expected_of
from tests.tools.damage.garbling import GARBLERS
from tests.tools.damage.recordings import (
    CLOCK_US,
    NS_PER_US,
    US_PER_S,
    WRITERS,
    short_drive,
    times_us,
)

Generator = np.random.Generator

TEXTS = frozenset({"candump", "asc", "trc", "csv", "gvret", "busmaster", "crtd", "console", "columns", "clx000"})
TELLS_ANY_CUT = frozenset({"blf", "gzip"})  # say how long they are, or have an end of their own


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A sound recording, and where to put the damaged one."""

    log_format: str
    path: Path
    contents: bytes
    target: Path

    def put(self, contents: bytes) -> None:
        """Write the damaged file."""
        self.target.write_bytes(contents)

    def put_frames(self, frames: EncodedFrames, jump: Jump | None = None) -> Expected:
        """Write a file of the same format that holds these frames; return what must be counted."""
        WRITERS[self.log_format](self.target, frames)
        return expected_of(frames, CLOCK_US.get(self.log_format, 1), jump)


Damage = Callable[[Recording, Generator], Expected]


def flip_bits(recording: Recording, rng: Generator) -> Expected:
    """Flip up to 20 bits anywhere."""
    contents = bytearray(recording.contents)
    for place in rng.integers(0, len(contents), int(rng.integers(1, 20))):
        contents[place] ^= 1 << int(rng.integers(8))
    recording.put(bytes(contents))
    return Expected()


def cut(recording: Recording, rng: Generator) -> Expected:
    """End the file anywhere: what is left is the beginning of what was there."""
    size = int(rng.integers(1, len(recording.contents)))
    recording.put(recording.contents[:size])
    is_inside_line = recording.log_format in TEXTS and recording.contents[size - 1 : size] != b"\n"
    return Expected(is_beginning=True, must_be_noticed=is_inside_line or recording.log_format in TELLS_ANY_CUT)


def insert_garbage(recording: Recording, rng: Generator) -> Expected:
    """Put in up to 5,000 bytes of anything."""
    contents, place = recording.contents, int(rng.integers(0, len(recording.contents)))
    recording.put(contents[:place] + rng.bytes(int(rng.integers(1, 5_000))) + contents[place:])
    return Expected()


def remove_piece(recording: Recording, rng: Generator) -> Expected:
    """Take out up to 5,000 bytes."""
    contents, place = recording.contents, int(rng.integers(0, len(recording.contents)))
    recording.put(contents[:place] + contents[place + int(rng.integers(1, 5_000)) :])
    return Expected()


def repeat_piece(recording: Recording, rng: Generator) -> Expected:
    """Write a piece twice: frames come again, and time jumps back."""
    contents, place = recording.contents, int(rng.integers(0, len(recording.contents)))
    piece = contents[place : place + int(rng.integers(50, 200_000))]
    recording.put(contents[: place + len(piece)] + piece + contents[place + len(piece) :])
    return Expected()


def swap_pieces(recording: Recording, rng: Generator) -> Expected:
    """Swap two pieces of up to 500 bytes."""
    contents, size = recording.contents, int(rng.integers(1, 500))
    first, second = sorted(int(place) for place in rng.integers(0, len(contents) - 2 * size, 2))
    second += size
    middle = contents[first + size : second]
    recording.put(
        contents[:first] + contents[second : second + size] + middle + contents[first : first + size]
        + contents[second + size :]
    )  # fmt: skip
    return Expected()


def garble(recording: Recording, rng: Generator) -> Expected:
    """Make nonsense of some lines, objects, rows or records, and leave the others as they are."""
    count = int(rng.integers(1, 40))
    frame_count = GARBLERS[recording.log_format](recording.path, recording.target, rng, count)
    return Expected(frames=frame_count - count, rejected=count, must_be_noticed=True)


def swap_frames(recording: Recording, rng: Generator) -> Expected:
    """Swap the places of two frames, times and all."""
    frames = short_drive()
    rows = np.arange(len(frames))
    first, second = rng.choice(len(frames), 2, replace=False)
    rows[[first, second]] = rows[[second, first]]
    return recording.put_frames(taken(frames, rows))


def repeat_frames(recording: Recording, rng: Generator) -> Expected:
    """Write some frames twice."""
    frames = short_drive()
    twice = rng.choice(len(frames), int(rng.integers(1, 50)), replace=False)
    return recording.put_frames(taken(frames, np.sort(np.concatenate((np.arange(len(frames)), twice)))))


def lose_frames(recording: Recording, rng: Generator) -> Expected:
    """Leave out some frames, alone and in a row."""
    frames = short_drive()
    is_kept = np.ones(len(frames), np.bool_)
    is_kept[rng.choice(len(frames), int(rng.integers(1, 50)), replace=False)] = False
    first = int(rng.integers(len(frames)))
    is_kept[first : first + int(rng.integers(0, 300))] = False
    return recording.put_frames(taken(frames, np.flatnonzero(is_kept)))


def jump_ahead(recording: Recording, rng: Generator) -> Expected:
    """From some frame on, be later: by 50 ms, which is a silence, up to an hour."""
    most_ms = 3.6e6
    return jump(recording, rng, int(1_000 * np.exp(rng.uniform(np.log(50.0), np.log(most_ms)))))


def jump_back(recording: Recording, rng: Generator) -> Expected:
    """From some frame on, be earlier, but not before the start."""
    return jump(recording, rng, None)


def jump(recording: Recording, rng: Generator, by_us: int | None) -> Expected:
    """Move everything from some frame on; where no distance is given, back."""
    frames = short_drive()
    t_us = times_us(frames)
    row = int(rng.integers(len(frames) // 20, len(frames)))
    by_us = -1_000 * int(rng.integers(1, t_us[row] // 1_000)) if by_us is None else by_us // 1_000 * 1_000
    moved_us = t_us.copy()
    moved_us[row:] += by_us
    to_ns = DEFAULT_START_NS + int(moved_us[row]) * NS_PER_US
    return recording.put_frames(replace(frames, t_s=moved_us / US_PER_S), Jump(to_ns=to_ns, by_ns=by_us * NS_PER_US))


def taken(frames: EncodedFrames, rows: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> EncodedFrames:
    """Return some frames in the order that is asked for."""
    return EncodedFrames(
        t_s=frames.t_s[rows], can_id=frames.can_id[rows], length=frames.length[rows], data=frames.data[rows]
    )


DAMAGES: Mapping[str, Damage] = MappingProxyType(
    {
        damage.__name__: damage
        for damage in (
            flip_bits, cut, insert_garbage, remove_piece, repeat_piece, swap_pieces, garble, swap_frames,
            repeat_frames, lose_frames, jump_ahead, jump_back,
        )
    }
)  # fmt: skip
