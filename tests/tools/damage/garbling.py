"""Nonsense in the place of single frames: what belongs to the format around them stays sound."""

import gzip
import sqlite3
import struct
import zlib
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.writers import (
    CONTAINER_HEADER,
    DEFLATED,
    FILE_HEADER,
    LOG_CONTAINER,
    OBJECT,
    OBJECT_MAGIC,
)
from tests.tools.damage.recordings import short_drive, write_recorded

Generator = np.random.Generator
Garbler = Callable[[Path, Path, Generator, int], int]  # sound file, damaged file, how many; frames of the sound one

NO_LENGTH = 77  # bytes that no frame has


def garble_lines(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
    """Put bytes that are no text in the place of some lines."""
    contents, frame_count = garbled_lines(sound.read_bytes(), rng, count)
    damaged.write_bytes(contents)
    return frame_count


def garble_gzip(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
    """Do the same with the text inside."""
    contents, frame_count = garbled_lines(gzip.decompress(sound.read_bytes()), rng, count)
    damaged.write_bytes(gzip.compress(contents, 6))
    return frame_count


def garbled_lines(contents: bytes, rng: Generator, count: int) -> tuple[bytes, int]:
    """Return a text with nonsense in it, and how many frames it had."""
    frame_count = len(short_drive())
    lines = contents.splitlines(keepends=True)
    is_footer = lines[-1][:3].lower() == b"end"
    last = len(lines) - is_footer
    for number in rng.choice(np.arange(last - frame_count, last), count, replace=False).tolist():
        nonsense = rng.choice(np.r_[0x01:0x09, 0x80:0x100], int(rng.integers(1, 60))).astype(np.uint8)
        lines[number] = b"\x01" + nonsense.tobytes() + b"\n"
    return b"".join(lines), frame_count


def garble_blf(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
    """Take from objects inside the containers what they are found by, of no two that are neighbours."""
    contents = sound.read_bytes()
    objects = np.frombuffer(b"".join(inflated_containers(contents)), OBJECT).copy()
    rows = 2 * rng.choice(len(objects) // 2 - 1, count, replace=False) + 1
    objects["magic"][rows] = b"GONE"
    deflated = zlib.compress(objects.tobytes())
    size_bytes = CONTAINER_HEADER.size + len(deflated)
    header = CONTAINER_HEADER.pack(OBJECT_MAGIC, 16, 1, size_bytes, LOG_CONTAINER, DEFLATED, objects.nbytes)
    fields = list(FILE_HEADER.unpack_from(contents))
    fields[10] = FILE_HEADER.size + size_bytes
    damaged.write_bytes(FILE_HEADER.pack(*fields) + header + deflated)
    return len(objects)


def inflated_containers(contents: bytes) -> list[bytes]:
    """Return what the containers of a sound BLF file hold."""
    found, place = [], FILE_HEADER.size
    while place < len(contents):
        (size_bytes,) = struct.unpack_from("<L", contents, place + 8)
        found.append(zlib.decompress(contents[place + CONTAINER_HEADER.size : place + size_bytes]))
        place += size_bytes + size_bytes % 4
    return found


def garble_capture(first: int, step: int, place: int) -> Garbler:
    """Return what gives packets of a capture, each of so many bytes, a length that no frame has."""

    def garble(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
        contents, frame_count = bytearray(sound.read_bytes()), len(short_drive())
        for row in rng.choice(frame_count, count, replace=False).tolist():
            contents[first + row * step + place] = NO_LENGTH
        damaged.write_bytes(bytes(contents))
        return frame_count

    return garble


def garble_mf4(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
    """Give records a length that no frame has."""
    del sound
    frames = short_drive()
    length = frames.length.copy()
    length[rng.choice(len(frames), count, replace=False)] = NO_LENGTH
    write_recorded(damaged, EncodedFrames(t_s=frames.t_s, can_id=frames.can_id, length=length, data=frames.data))
    return len(frames)


def garble_sqlite(sound: Path, damaged: Path, rng: Generator, count: int) -> int:
    """Put text, nothing or too much into columns of rows."""
    damaged.write_bytes(sound.read_bytes())
    frame_count = len(short_drive())
    nonsense = ("ts = 'soon'", "ts = NULL", "arbitration_id = -5", "dlc = 77", "data = x'00'", "data = 'text'")
    with closing(sqlite3.connect(damaged)) as database:
        for row in (1 + rng.choice(frame_count, count, replace=False)).tolist():
            change = nonsense[int(rng.integers(len(nonsense)))]
            database.execute(f"UPDATE messages SET {change} WHERE rowid = ?", (row,))  # noqa: S608 - texts of ours
        database.commit()
    return frame_count


GARBLERS: Mapping[str, Garbler] = MappingProxyType(
    {
        **dict.fromkeys(
            ("candump", "asc", "trc", "csv", "gvret", "busmaster", "crtd", "console", "columns", "clx000"), garble_lines
        ),
        "gzip": garble_gzip,
        "blf": garble_blf,
        "mf4": garble_mf4,
        "pcap": garble_capture(24, 32, 20),
        "pcapng": garble_capture(548, 56, 32),
        "sqlite": garble_sqlite,
    }
)
