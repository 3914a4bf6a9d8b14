"""A short drive as logs and tables of every kind, damaged in many ways, and what must not come of that.

Whatever is done, reading ends, nothing breaks, counts match what was done where that can be known, no accepted
estimate is further than four of its standard deviations from the truth or from that of the sound recording, and none
reaches over a jump of time.
"""

import gzip
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from canlog.arrays import FloatArray, Int64Array
from canlog.errors import SourceError
from canlog.frames import MAX_GAP_NS, FrameBatch, empty_batch, join
from canlog.logs import LogCounts, read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import FrictionEstimate, ShiftEstimate, Status
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.profile import load_profile
from diag_service.mapping.survey import proposed_profile
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.drive.recording import Drive
from ecu_emulator.log_formats.record import DEFAULT_START_NS, open_log
from ecu_emulator.log_formats.table import TableOptions, write_table
from tests.support.builders import drive_scenario
from tests.support.capture_grammars import CAPTURE_GRAMMARS
from tests.support.log_grammars import Frame

DURATION_S: Final = 10.0  # three shifts
MOST_STD: Final = 4.0  # an estimate may be off, by its own account

Generator = np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of one recording."""

    estimates: tuple[ShiftEstimate, ...]
    frames: FrameBatch  # as far as they were read
    counts: LogCounts
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """A table: when its rows were written [s], and what stands in them; NaN is a blank cell."""

    times_s: FloatArray
    heads: tuple[tuple[str, str], ...]  # name and unit
    cells: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Damaged:
    """A damaged recording, and what must be true of it, as far as that can be known."""

    contents: bytes | EncodedFrames | Rows
    counts: Mapping[str, int] = field(default_factory=dict)
    is_beginning: bool = False  # the frames are the first ones of the sound recording
    must_be_noticed: bool = False
    jump: tuple[int, int] | None = None  # the first of the moved times [ns], and by how much; no shift reaches over it


@cache
def drive() -> tuple[EncodedFrames, tuple[dict[str, float], ...]]:
    """Return the frames of three shifts, and the friction of the clutches."""
    driven = Drive(drive_scenario("ideal"))
    truth = driven.truth
    friction = tuple({"mu_c": truth.mu_c[clutch], "mu_s": truth.mu_s[clutch]} for clutch in (0, 1))
    return next(driven.stretches(DURATION_S)).frames, friction


@cache
def short_table() -> Rows:
    """Return the short drive as a scan tool records it."""
    with tempfile.TemporaryDirectory() as folder:
        log, path = Path(folder) / "drive.log", Path(folder) / "drive.csv"
        write_recorded(log, drive()[0])
        write_table(log, TableOptions(path=path, rate_hz=50.0, jitter_s=0.002, skew_ratio=0.5), 1)
        head, *lines = path.read_text(encoding="utf-8").splitlines()
    numbers = np.array([line.split(",") for line in lines], np.float64)
    named = [text.removesuffix("]").partition(" [")[::2] for text in head.split(",")[1:]]
    return Rows(times_s=numbers[:, 0] / 1e3, heads=tuple((name, unit) for name, unit in named), cells=numbers[:, 1:])


def times_us(frames: EncodedFrames) -> Int64Array:
    """Return when frames were sent, in microseconds of the drive."""
    rounded: Int64Array = np.rint(frames.t_s * 1e6).astype(np.int64)
    return rounded


def write_recorded(path: Path, frames: EncodedFrames) -> None:
    """Write a format that the emulator records, plain or as gzip."""
    plain = path.with_suffix("") if path.suffix == ".gz" else path
    with open_log(plain) as log:
        log.write(frames)
    if plain != path:
        path.write_bytes(gzip.compress(plain.read_bytes(), 6, mtime=0))


def write_sqlite(path: Path, frames: EncodedFrames) -> None:
    """Write the database of python-can."""
    columns = (times_us(frames) + DEFAULT_START_NS // 1000).tolist(), frames.can_id.tolist(), frames.length.tolist()
    rows = [(t_us / 1e6, can_id, 0, 0, 0, length, data[:length].tobytes())
            for t_us, can_id, length, data in zip(*columns, frames.data, strict=True)]  # fmt: skip
    with closing(sqlite3.connect(":memory:")) as database:
        database.execute("CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)")
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        database.commit()
        path.write_bytes(database.serialize())


def write_capture(path: Path, frames: EncodedFrames) -> None:
    """Write what Wireshark writes."""
    columns = times_us(frames).tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data
    sent = [Frame(t_us=t_us, can_id=can_id, is_extended=False, length=length, data=data[:length].tobytes())
            for t_us, can_id, length, data in zip(*columns, strict=True)]  # fmt: skip
    CAPTURE_GRAMMARS["pcapng"].write(path, sent)


def write_csv(path: Path, rows: Rows) -> None:
    """Write a table of texts."""
    lines = [",".join(["Time [ms]", *(f"{name} [{unit}]" if unit else name for name, unit in rows.heads)])]
    for time_s, cells in zip(rows.times_s.tolist(), rows.cells.tolist(), strict=True):
        lines.append(",".join([f"{1e3 * time_s:.0f}", *("" if np.isnan(one) else f"{one:.10g}" for one in cells)]))
    path.write_text("\n".join([*lines, ""]))


def write_parquet(path: Path, rows: Rows) -> None:
    """Write it as columns, with units as pandas keeps none: in the names."""
    columns = {f"{name} [{unit}]": rows.cells[:, k] for k, (name, unit) in enumerate(rows.heads)}
    pq.write_table(pa.table({"Time [s]": rows.times_s} | columns), path)


LOGS: Final[Mapping[str, Callable[[Path, EncodedFrames], None]]] = MappingProxyType({
    ".log": write_recorded, ".blf": write_recorded, ".mf4": write_recorded,
    ".log.gz": write_recorded, ".db": write_sqlite, ".pcapng": write_capture,
})  # fmt: skip
TABLES: Final[Mapping[str, Callable[[Path, Rows], None]]] = MappingProxyType(
    {".csv": write_csv, ".parquet": write_parquet}
)
TEXTS: Final = frozenset({".log"})
TELL_ANY_CUT: Final = frozenset({".blf", ".log.gz"})  # say how long they are, or have an end of their own


def flip_bits(_: str, sound: bytes, rng: Generator) -> Damaged:
    """Flip up to 20 bits anywhere."""
    contents = bytearray(sound)
    for place in rng.integers(0, len(contents), int(rng.integers(1, 20))):
        contents[place] ^= 1 << int(rng.integers(8))
    return Damaged(contents=bytes(contents))


def cut(suffix: str, sound: bytes, rng: Generator) -> Damaged:
    """End the file anywhere: what is left is the beginning of what was there."""
    size = int(rng.integers(1, len(sound)))
    is_inside_line = suffix in TEXTS and sound[size - 1 : size] != b"\n"
    is_told = is_inside_line or suffix in TELL_ANY_CUT
    return Damaged(contents=sound[:size], is_beginning=suffix in LOGS, must_be_noticed=is_told)


def replace_piece(_: str, sound: bytes, rng: Generator) -> Damaged:
    """Put up to 5,000 bytes of anything in the place of as many others, or between them."""
    first, size = int(rng.integers(0, len(sound))), int(rng.integers(0, 5_000))
    return Damaged(contents=sound[:first] + rng.bytes(int(rng.integers(0, 5_000))) + sound[first + size :])


def repeat_piece(_: str, sound: bytes, rng: Generator) -> Damaged:
    """Write a piece twice: frames come again, and time jumps back."""
    first, size = int(rng.integers(0, len(sound))), int(rng.integers(50, 200_000))
    return Damaged(contents=sound[: first + size] + sound[first:])


def garble(suffix: str, sound: bytes, rng: Generator) -> Damaged:
    """Put bytes that are no text in the place of some lines; a binary file has them anywhere."""
    if suffix not in TEXTS:
        return replace_piece(suffix, sound, rng)
    lines, count, frames = sound.splitlines(keepends=True), int(rng.integers(1, 40)), len(drive()[0])
    for number in rng.choice(frames, count, replace=False).tolist():
        lines[number] = b"\x01" + rng.choice(np.r_[0x01:0x09, 0x80:0x100], 20).astype(np.uint8).tobytes() + b"\n"
    counts = {"frames": frames - count, "rejected": count}
    return Damaged(contents=b"".join(lines), counts=counts, must_be_noticed=True)


def of_frames(frames: EncodedFrames, jump: tuple[int, int] | None = None) -> Damaged:
    """Return a sound file of these frames, and what must be counted in it."""
    steps_us = np.diff(times_us(frames))
    same = (frames.can_id[1:] == frames.can_id[:-1]) & (frames.data[1:] == frames.data[:-1]).all(axis=1)
    counts = {
        "frames": len(frames),
        "rejected": 0,
        "jumps_back": int(np.count_nonzero(steps_us < 0)),
        "jumps_ahead": int(np.count_nonzero(steps_us * 1000 > MAX_GAP_NS)),
        "repeated": int(np.count_nonzero(same & (steps_us == 0))),
    }
    return Damaged(contents=frames, counts=counts, jump=jump)


def taken(suffix: str, rows: Int64Array) -> Damaged:
    """Return some frames, or rows of a table, in the order that is asked for."""
    if suffix in LOGS:
        sent, _ = drive()
        return of_frames(
            EncodedFrames(t_s=sent.t_s[rows], can_id=sent.can_id[rows], length=sent.length[rows], data=sent.data[rows])
        )
    table = short_table()
    changed = replace(table, times_s=table.times_s[rows], cells=table.cells[rows])
    return Damaged(contents=changed, counts={"rejected": 0})


def count_of(suffix: str) -> int:
    """Return how many frames or rows there are."""
    return len(drive()[0]) if suffix in LOGS else len(short_table().times_s)


def swap(suffix: str, _: bytes, rng: Generator) -> Damaged:
    """Swap the places of two frames or rows, times and all."""
    rows = np.arange(count_of(suffix))
    first, second = rng.choice(len(rows), 2, replace=False)
    rows[[first, second]] = rows[[second, first]]
    return taken(suffix, rows)


def repeat(suffix: str, _: bytes, rng: Generator) -> Damaged:
    """Write some twice."""
    rows = np.arange(count_of(suffix))
    return taken(suffix, np.sort(np.concatenate((rows, rng.choice(rows, int(rng.integers(1, 50)), replace=False)))))


def lose(suffix: str, _: bytes, rng: Generator) -> Damaged:
    """Leave out some, alone and in a row."""
    is_kept = np.ones(count_of(suffix), np.bool_)
    is_kept[rng.choice(len(is_kept), int(rng.integers(1, 30)), replace=False)] = False
    first = int(rng.integers(len(is_kept)))
    is_kept[first : first + int(rng.integers(0, 60))] = False
    return taken(suffix, np.flatnonzero(is_kept))


def jump_ahead(suffix: str, _: bytes, rng: Generator) -> Damaged:
    """From some frame or row on, be later: by .3 s to an hour."""
    return jump(suffix, rng, round(float(np.exp(rng.uniform(np.log(0.3), np.log(3600.0)))), 3))


def jump_back(suffix: str, _: bytes, rng: Generator) -> Damaged:
    """From some frame or row on, be earlier, but not before the start."""
    return jump(suffix, rng, -round(float(rng.uniform(0.2, 0.45)), 3))


def jump(suffix: str, rng: Generator, by_s: float) -> Damaged:
    """Move everything from some frame or row on."""
    count = count_of(suffix)
    row = int(rng.integers(count // 20, count))
    later_s = np.where(np.arange(count) >= row, by_s, 0.0)
    if suffix in TABLES:
        moved = replace(short_table(), times_s=short_table().times_s + later_s)
        return Damaged(contents=moved, counts={"rejected": 0})
    frames, _ = drive()
    moved_us = np.rint(1e6 * (frames.t_s + later_s)).astype(np.int64)
    first_ns = DEFAULT_START_NS + int(moved_us[row]) * 1000
    return of_frames(replace(frames, t_s=moved_us / 1e6), (first_ns, round(by_s * 1e9)))


def spoil_cells(suffix: str, sound: bytes, rng: Generator) -> Damaged:
    """Leave a tenth of a table's cells blank, and let one column keep its value from some row on."""
    if suffix in LOGS:
        return garble(suffix, sound, rng)
    table = short_table()
    cells, row, column = table.cells.copy(), *(int(rng.integers(size)) for size in table.cells.shape)
    cells[row:, column] = cells[row, column]
    cells[rng.random(cells.shape) < 0.1] = np.nan
    return Damaged(contents=replace(table, cells=cells), counts={"rejected": 0})


DAMAGES: Final = (
    flip_bits, cut, replace_piece, repeat_piece, garble, swap, repeat, lose, jump_ahead, jump_back, spoil_cells,
)  # fmt: skip


def frame_decoder() -> Decoder:
    """Return a decoder of the frames of our own bus."""
    return Decoder(load_contract(), load_profile())


def decoder_of(table: Path) -> Callable[[], Decoder]:
    """Return what makes decoders by the profile that is proposed for a sound table."""
    profile = table.with_suffix(".toml")
    profile.write_text(proposed_profile(table), encoding="utf-8")
    return interpret(None, profile).decoder


def analyse(path: Path, decoder: Callable[[], Decoder] = frame_decoder) -> Outcome:
    """Read and diagnose a recording."""
    calibration = nominal_calibration()
    stages = Stages(decoder(), calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    estimates, batches = list[ShiftEstimate](), [empty_batch()]
    error, counts = "", LogCounts()
    try:
        reader = read_log(path)
        try:
            for batch in reader:
                batches.append(batch)
                estimates += [stages.conclude(event).estimate for event in stages.segment(batch)]
            estimates += [stages.conclude(event).estimate for event in stages.flush()]
        finally:
            counts = reader.counts
    except SourceError as exc:
        error = str(exc)
    return Outcome(estimates=tuple(estimates), frames=join(batches), counts=counts, error=error)


def is_noticed(damaged: Outcome, sound: Outcome) -> bool:
    """Return whether anything says that the recording is not what it was."""
    return damaged.error != "" or damaged.counts != sound.counts


def faults(expected: Damaged, damaged: Outcome, sound: Outcome) -> Iterator[str]:
    """Yield what must not be, in words."""
    if "\n" in damaged.error:
        yield "an error of several lines"
    for name, wanted in expected.counts.items():
        value = sum(damaged.counts.rejected.values()) if name == "rejected" else getattr(damaged.counts, name)
        if value != wanted:
            yield f"{name}: {value} instead of {wanted} {damaged.error}"
    if expected.must_be_noticed and not is_noticed(damaged, sound):
        yield "nothing says that the recording is damaged"
    first = sound.frames[: len(damaged.frames)]
    columns = ("t_ns", "can_id", "length", "data")
    if expected.is_beginning and not all(
        np.array_equal(getattr(damaged.frames, one), getattr(first, one)) for one in columns
    ):
        yield "frames that the sound recording does not begin with"
    for estimate in damaged.estimates:
        if estimate.status is Status.VALID and estimate.friction is not None:
            yield from _wrong_estimate(estimate, estimate.friction, sound)
            if expected.jump is not None and not _is_on_one_side(estimate, sound, *expected.jump):
                yield f"the shift at {estimate.start_ns} ns reaches over a jump of time"


def _wrong_estimate(estimate: ShiftEstimate, friction: FrictionEstimate, sound: Outcome) -> Iterator[str]:
    """Yield how an estimate contradicts the truth, or that of the same shift of the sound recording."""
    where = f"of the shift {estimate.from_gear}-{estimate.to_gear} at {estimate.start_ns} ns"
    gears = (estimate.from_gear, estimate.to_gear)
    others = [other.friction for other in sound.estimates if (other.from_gear, other.to_gear) == gears]
    for name, true in drive()[1][estimate.clutch - 1].items():
        value, std = getattr(friction, name), getattr(friction, f"std_{name}")
        if abs(value - true) > MOST_STD * std:
            yield f"{name} {where} is {value:.4f}, std {std:.4f}; the truth is {true:.4f}"
        for other in others:
            random_std = max(getattr(one, f"random_std_{name}") for one in (friction, other or friction))
            if other is not None and abs(value - getattr(other, name)) > MOST_STD * random_std:
                was = f"{getattr(other, name):.4f}, random std {random_std:.4f}"
                yield f"{name} {where} is {value:.4f}; without damage it was {was}"


def _is_on_one_side(estimate: ShiftEstimate, sound: Outcome, to_ns: int, by_ns: int) -> bool:
    """Return whether a shift of the sound recording was found as a whole, or what comes of it after the jump."""
    start_ns, end_ns = estimate.start_ns, estimate.end_ns
    return any(
        (start_ns, end_ns) == (other.start_ns, other.end_ns)
        or (end_ns == other.end_ns + by_ns and start_ns >= max(other.start_ns + by_ns, to_ns))
        for other in sound.estimates
    )
