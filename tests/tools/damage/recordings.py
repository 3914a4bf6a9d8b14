"""A short drive in every log format there is, and what the service makes of a log."""

import gzip
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from canlog.arrays import Int64Array
from canlog.errors import SourceError
from canlog.frames import FrameBatch, empty_batch, join
from canlog.logs import LogCounts, read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import ShiftEstimate
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.drive.recording import Drive
from ecu_emulator.log_formats.record import DEFAULT_START_NS, open_log
from tests.support.builders import drive_scenario
from tests.support.capture_grammars import CAPTURE_GRAMMARS
from tests.support.log_grammars import GRAMMARS, Frame, Grammar
from tests.support.wild_grammars import WILD_GRAMMARS

RECORDED = MappingProxyType(
    {
        "candump": ".log",
        "blf": ".blf",
        "asc": ".asc",
        "mf4": ".mf4",
        "trc": ".trc",
        "csv": ".csv",
        "gvret": ".gvret.csv",
    }
)
"""Formats that the emulator records, by name, with their suffixes."""

DURATION_S = 10.0  # three shifts
SCENARIO = "ideal"
US_PER_S = 1_000_000
NS_PER_US = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of one recording."""

    estimates: tuple[ShiftEstimate, ...]
    frames: FrameBatch  # as far as they were read
    counts: LogCounts
    error: str = ""


@cache
def short_drive() -> EncodedFrames:
    """Return the frames of three shifts."""
    return next(Drive(drive_scenario(SCENARIO)).stretches(DURATION_S)).frames


@cache
def true_friction() -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Return what the estimates of the short drive should be, clutch 1 first."""
    truth = Drive(drive_scenario(SCENARIO)).truth
    first, second = ({"mu_c": truth.mu_c[clutch], "mu_s": truth.mu_s[clutch]} for clutch in (0, 1))
    return first, second


def times_us(frames: EncodedFrames) -> Int64Array:
    """Return when frames were sent, in microseconds of the drive."""
    rounded: Int64Array = np.rint(frames.t_s * US_PER_S).astype(np.int64)
    return rounded


def write_recorded(path: Path, frames: EncodedFrames) -> None:
    """Write a format that the emulator records."""
    with open_log(path) as log:
        log.write(frames)


def write_gzip(path: Path, frames: EncodedFrames) -> None:
    """Write candump inside gzip."""
    plain = path.with_suffix("")
    write_recorded(plain, frames)
    path.write_bytes(gzip.compress(plain.read_bytes(), 6, mtime=0))


def write_sqlite(path: Path, frames: EncodedFrames) -> None:
    """Write the database of python-can."""
    path.unlink(missing_ok=True)
    rows = [
        ((DEFAULT_START_NS // NS_PER_US + t_us) / US_PER_S, can_id, 0, 0, 0, length, data[:length].tobytes())
        for t_us, can_id, length, data in zip(
            times_us(frames).tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
        )
    ]
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)")
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        database.commit()


def as_sent(frames: EncodedFrames) -> list[Frame]:
    """Return frames one by one, as the grammars of random logs take them."""
    columns = times_us(frames).tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data
    return [
        Frame(t_us=t_us, can_id=can_id, is_extended=False, length=length, data=data[:length].tobytes())
        for t_us, can_id, length, data in zip(*columns, strict=True)
    ]


Writer = Callable[[Path, EncodedFrames], None]


def writer_of(grammar: Grammar) -> Writer:
    """Return what writes a format that the emulator does not record."""
    return lambda path, frames: grammar.write(path, as_sent(frames))


OTHERS: Mapping[str, tuple[str, Grammar]] = MappingProxyType(
    {
        "busmaster": (".bus.log", GRAMMARS["busmaster"]),
        "crtd": (".crtd", GRAMMARS["crtd"]),
        "console": (".txt", WILD_GRAMMARS["candump-console -ta"]),
        "columns": (".table", WILD_GRAMMARS["columns with commas"]),
        "clx000": (".clx.txt", WILD_GRAMMARS["clx000 with days"]),
        "pcap": (".pcap", CAPTURE_GRAMMARS["pcap"]),
        "pcapng": (".pcapng", CAPTURE_GRAMMARS["pcapng"]),
    }
)
"""Formats that others write, by name, with their suffixes and grammars."""

WRITERS: Mapping[str, Writer] = MappingProxyType(
    {
        **dict.fromkeys(RECORDED, write_recorded),
        **{name: writer_of(grammar) for name, (_, grammar) in OTHERS.items()},
        "sqlite": write_sqlite,
        "gzip": write_gzip,
    }
)
"""How every format is written."""

SUFFIXES: Mapping[str, str] = MappingProxyType(
    {**RECORDED, **{name: suffix for name, (suffix, _) in OTHERS.items()}, "sqlite": ".db", "gzip": ".log.gz"}
)
CLOCK_US: Mapping[str, int] = MappingProxyType(
    {"busmaster": 100, "clx000": 1_000}
)  # the step of a format's times; else 1


def frame_decoder() -> Decoder:
    """Return a decoder of the frames of our own bus."""
    return Decoder(load_contract(), load_profile())


def analyse(path: Path, decoder: Callable[[], Decoder] = frame_decoder) -> Outcome:
    """Read and diagnose a recording."""
    calibration = nominal_calibration()
    stages = Stages(
        decoder(),
        calibration,
        Posterior.fresh(calibration),
        ConditionMemory.fresh(),
    )
    estimates: list[ShiftEstimate] = []
    batches: list[FrameBatch] = [empty_batch()]
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
