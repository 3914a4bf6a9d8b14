"""A short drive in every log format there is, and what the service makes of a log."""

import gzip
import sqlite3
import struct
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
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


def write_busmaster(path: Path, frames: EncodedFrames) -> None:
    """Write a log of BUSMASTER; its clock counts tenths of milliseconds."""
    start = datetime.fromtimestamp(DEFAULT_START_NS / 1e9, UTC).astimezone()
    day_us = ((start.hour * 60 + start.minute) * 60 + start.second) * US_PER_S
    head = (
        "***BUSMASTER Ver 3.2.2***\n"
        f"***START DATE AND TIME {start.day}:{start.month}:{start.year} {start:%H:%M:%S}:000***\n***SYSTEM MODE***\n"
    )
    path.write_text(head + "".join(busmaster_line(day_us + t_us, row) for t_us, row in rows_of(frames)), "ascii")


def busmaster_line(t_us: int, row: EncodedFrames) -> str:
    """Return the line of one frame."""
    seconds, rest_us = divmod(t_us, US_PER_S)
    clock = f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}:{rest_us // 100:04}"
    payload = row.data[0, : row.length[0]].tobytes().hex(" ").upper()
    return f"{clock} Rx 1 0x{row.can_id[0]:X} s {row.length[0]} {payload}\n"


def write_crtd(path: Path, frames: EncodedFrames) -> None:
    """Write a log of the Open Vehicles project."""
    start_us = DEFAULT_START_NS // NS_PER_US
    lines = [
        f"{(start_us + t_us) // US_PER_S}.{t_us % US_PER_S:06} 1R11 {row.can_id[0]:X} "
        f"{row.data[0, : row.length[0]].tobytes().hex(' ').upper()}\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text(f"{start_us // US_PER_S}.000000 CXX short drive\n" + "".join(lines), "ascii")


def write_console(path: Path, frames: EncodedFrames) -> None:
    """Write what ``candump -t a -x`` prints."""
    start_us = DEFAULT_START_NS // NS_PER_US
    lines = [
        f" ({(start_us + t_us) // US_PER_S:010}.{t_us % US_PER_S:06})  can0  RX - -  {row.can_id[0]:03X}   "
        f"[{row.length[0]}]  {row.data[0, : row.length[0]].tobytes().hex(' ').upper()}\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("".join(lines), "ascii")


def write_columns(path: Path, frames: EncodedFrames) -> None:
    """Write a table whose header names its columns."""
    start_us = DEFAULT_START_NS // NS_PER_US
    lines = [
        f"{(start_us + t_us) // US_PER_S}.{t_us % US_PER_S:06};{row.can_id[0]:X};{row.length[0]};"
        f"{row.data[0, : row.length[0]].tobytes().hex(' ')}\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("Time [s];CAN ID;DLC;Data\n" + "".join(lines), "ascii")


def write_carbus(path: Path, frames: EncodedFrames) -> None:
    """Write a trace of CARBUS Analyzer, whose times begin again every minute."""
    lines = [
        f"{t_us // US_PER_S % 60:02},{t_us % US_PER_S:06}\t1\t00000004\t{row.can_id[0]:03X}\t{row.length[0]}\t"
        f"{row.data[0, : row.length[0]].tobytes().hex(' ').upper():23}\t00000000\t        \t\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("@ TEXT @ 3 @ 64 @ 0 @ 0 @ 0 @ 00:00:00.000 @\n" + "".join(lines), "ascii")


def write_canhacker(path: Path, frames: EncodedFrames) -> None:
    """Write a trace of CANHacker, in milliseconds of the minute."""
    lines = [
        f"{t_us // US_PER_S % 60:02}.{t_us % US_PER_S // 1_000:03} {row.can_id[0]:08X} {row.length[0]} "
        f"{row.data[0, : row.length[0]].tobytes().hex(' ').upper()} \n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("Time   ID     DLC Data                    Comment\n" + "".join(lines), "ascii")


def write_microchip(path: Path, frames: EncodedFrames) -> None:
    """Write a log of Microchip's CAN Bus Analyzer, in milliseconds."""
    start = datetime.fromtimestamp(DEFAULT_START_NS / 1e9, UTC).astimezone()
    head = (
        "//---\nMicrochip Technology Inc.\nCAN BUS Analyzer\n"
        f"Logging Started: {start.day}/{start.month}/{start.year} {start:%H:%M:%S}\n//---\n"
    )
    lines = [
        f"{t_us // 1_000};RX;0x{row.can_id[0]:X};{row.length[0]};"
        f"{''.join(f'0x{byte:02X};' for byte in row.data[0, : row.length[0]].tolist())}\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text(head + "".join(lines), "ascii")


def write_clx000(path: Path, frames: EncodedFrames) -> None:
    """Write a log of a CLX000, whose times have the day of the month, and milliseconds."""
    start = datetime.fromtimestamp(DEFAULT_START_NS / 1e9, UTC).astimezone()
    lines = []
    for t_us, row in rows_of(frames):
        moment = start + timedelta(microseconds=t_us)
        data = row.data[0, : row.length[0]].tobytes().hex()
        lines.append(f"{moment:%dT%H%M%S}{moment.microsecond // 1_000:03};0;{row.can_id[0]:x};{data}\n")
    head = f'# Logger type: CL2000\n# Time: {start:%Y%m%dT%H%M%S}\n# Value separator: ";"\nTimestamp;Type;ID;Data\n'
    path.write_text(head + "".join(lines), "ascii")


def write_canking(path: Path, frames: EncodedFrames) -> None:
    """Write a text of Kvaser's CanKing."""
    lines = [
        f" 0    {row.can_id[0]:08X}       {row.length[0]:3}  "
        f"{row.data[0, : row.length[0]].tobytes().hex(' ').upper()} {t_us // US_PER_S:7}.{t_us % US_PER_S:06} R\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n" + "".join(lines))


def write_yacht_devices(path: Path, frames: EncodedFrames) -> None:
    """Write what gateways of Yacht Devices send: milliseconds of the day, and no header."""
    lines = [
        f"{t_us // 3600 // US_PER_S:02}:{t_us // 60 // US_PER_S % 60:02}:{t_us // US_PER_S % 60:02}."
        f"{t_us % US_PER_S // 1_000:03} R {row.can_id[0]:03X} "
        f"{row.data[0, : row.length[0]].tobytes().hex(' ').upper()}\n"
        for t_us, row in rows_of(frames)
    ]
    path.write_text("".join(lines))


def write_pcap(path: Path, frames: EncodedFrames) -> None:
    """Write a capture of SocketCAN in pcap, little-endian."""
    start_us = DEFAULT_START_NS // NS_PER_US
    pieces = [struct.pack("<LHHLLLL", 0xA1B2C3D4, 2, 4, 0, 0, 262_144, 227)]
    for t_us, row in rows_of(frames):
        seconds, part_us = divmod(start_us + t_us, US_PER_S)
        packet = struct.pack(">LB3x", row.can_id[0], row.length[0]) + row.data[0, :8].tobytes()
        pieces.append(struct.pack("<LLLL", seconds, part_us, len(packet), len(packet)) + packet)
    path.write_bytes(b"".join(pieces))


def write_pcapng(path: Path, frames: EncodedFrames) -> None:
    """Write a capture of SocketCAN in pcapng, big-endian."""
    start_us = DEFAULT_START_NS // NS_PER_US
    pieces = [struct.pack(">LLLHHqL", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)]
    pieces.append(struct.pack(">LLHHLL", 1, 20, 227, 0, 0, 20))
    for t_us, row in rows_of(frames):
        high, low = divmod(start_us + t_us, 1 << 32)
        packet = struct.pack(">LB3x", row.can_id[0], row.length[0]) + row.data[0, :8].tobytes()
        pieces.append(struct.pack(">7L", 6, 48, 0, high, low, 16, 16) + packet + struct.pack(">L", 48))
    path.write_bytes(b"".join(pieces))


def rows_of(frames: EncodedFrames) -> list[tuple[int, EncodedFrames]]:
    """Return frames one by one, with their times."""
    return [(t_us, frames[row : row + 1]) for row, t_us in enumerate(times_us(frames).tolist())]


Writer = Callable[[Path, EncodedFrames], None]
WRITERS: Mapping[str, Writer] = MappingProxyType(
    {
        **dict.fromkeys(RECORDED, write_recorded),
        "sqlite": write_sqlite,
        "busmaster": write_busmaster,
        "crtd": write_crtd,
        "console": write_console,
        "columns": write_columns,
        "carbus": write_carbus,
        "canhacker": write_canhacker,
        "microchip": write_microchip,
        "clx000": write_clx000,
        "canking": write_canking,
        "pcap": write_pcap,
        "pcapng": write_pcapng,
        "yacht-devices": write_yacht_devices,
        "gzip": write_gzip,
    }
)
"""How every format is written."""

SUFFIXES: Mapping[str, str] = MappingProxyType(
    {
        **RECORDED,
        "sqlite": ".db",
        "busmaster": ".bus.log",
        "crtd": ".crtd",
        "console": ".txt",
        "columns": ".table",
        "carbus": ".carbus.trc",
        "canhacker": ".hacker.trc",
        "microchip": ".can",
        "clx000": ".clx.txt",
        "canking": ".king.txt",
        "pcap": ".pcap",
        "pcapng": ".pcapng",
        "yacht-devices": ".yd.txt",
        "gzip": ".log.gz",
    }
)
CLOCK_US: Mapping[str, int] = MappingProxyType(
    {"busmaster": 100, "canhacker": 1_000, "microchip": 1_000, "clx000": 1_000, "yacht-devices": 1_000}
)  # the step of a format's times; else 1
START_NS: Mapping[str, int] = MappingProxyType(
    {"carbus": 0, "canhacker": 0, "canking": 0, "yacht-devices": 0}
)  # where a format has no date
MOST_JUMP_MS: Mapping[str, float] = MappingProxyType(
    {"carbus": 25_000.0, "canhacker": 25_000.0}
)  # that a clock of one minute can tell


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
