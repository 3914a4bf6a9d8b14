"""Files that are made to do harm, and what refusing them takes: time and memory of all processes that work on them.

Endless loops, bombs of every compression, sizes that no CAN message has, tables without an end, ten gigabytes of
nothing behind a sound header, devices, pipes and folders in place of files. Each is read by a process of its own; what
it and its children use is sampled while they run. The limits are 10 s of processor time and 512 MiB, the interpreter
and all libraries included.

    python -m tests.tools.hostile
"""

import argparse
import os
import socket
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.support import measurements
from tests.tools.hostile_archives import LINE, LINES, PACKED, QUICKLY_REFUSED, deflated, xz_bomb

LIMIT_S = 10.0
LIMIT_BYTES = 512 * 2**20
HANG_S = 60.0
SAMPLE_S = 0.02
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
PSS_MARK = "Pss:"

READ_LOG = """
import sys
sys.modules["asammdf"] = None  # as programs keep it from being loaded before it is needed
from canlog.errors import SourceError
from canlog.logs import read_log
try:
    reader = read_log(sys.argv[1])
    frames = sum(len(batch) for batch in reader)
    said = reader.counts.first_fault
except SourceError as exc:
    said = str(exc)
print(said)
"""
READ = """
import sys
from importlib import import_module
from pathlib import Path
module, _, name = sys.argv[2].partition(":")
try:
    getattr(import_module(module), name)(Path(sys.argv[1]))
    print()
except Exception as exc:
    if not type(exc).__module__.endswith(".errors"):
        raise
    print(exc)
"""
DBC_HEAD = 'VERSION ""\nBU_: A\n'
ENDLESS_VIEW = (
    "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (VALUES(0) UNION ALL SELECT i + 1 FROM n) SELECT i AS ts,"
    " 1 AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 0 AS dlc, '' AS data FROM n"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """What it took to refuse a file, and what was said."""

    cpu_s: float
    wall_s: float
    peak_bytes: int
    said: str

    @property
    def is_good(self) -> bool:
        """Whether something was said, in one line, within the limits."""
        is_clear = bool(self.said) and "\n" not in self.said
        return is_clear and self.cpu_s <= LIMIT_S and self.peak_bytes <= LIMIT_BYTES


def blf(inner: bytes, method: int, inflated_bytes: int) -> bytes:
    body = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(inner), 10, method, inflated_bytes) + inner
    return struct.pack("<4sL", b"LOGG", 144).ljust(144, b"\0") + body


def endless_blf() -> bytes:
    """Return a file whose object has no size: readers that believe it never end."""
    inner = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 0, 1) + bytes(300)
    return blf(inner, 0, len(inner))


def mf4(*blocks: bytes) -> bytes:
    """Return a file whose header names the block at 168 as its first data group."""
    head = b"MDF     4.10    clutchdi".ljust(28, b"\0") + struct.pack("<H", 410)
    links = struct.pack("<6Q", 168, 0, 0, 0, 0, 0)
    return head.ljust(64, b"\0") + struct.pack("<4s4xQQ", b"##HD", 104, 6) + links + bytes(32) + b"".join(blocks)


def mf4_loop() -> bytes:
    """Return a file whose first data group names itself as the next."""
    return mf4(struct.pack("<4s4xQQ", b"##DG", 64, 4) + struct.pack("<4Q", 168, 0, 0, 0) + bytes(8))


def mf4_channel_loop() -> bytes:
    """Return a file with a channel that names itself as the next, in a group with a billion records."""
    group, channel = 168 + 64, 168 + 64 + 104
    dg = struct.pack("<4s4xQQ", b"##DG", 64, 4) + struct.pack("<4Q", 0, group, 0, 0) + bytes(8)
    cg = struct.pack("<4s4xQQ", b"##CG", 104, 6) + struct.pack("<6Q", 0, channel, 0, 0, 0, 0)
    cg += struct.pack("<QQHH4xLL", 0, 10**9, 0, 0, 16, 0)
    cn = struct.pack("<4s4xQQ", b"##CN", 160, 8) + struct.pack("<8Q", channel, 0, 0, 0, 0, 0, 0, 0)
    cn += struct.pack("<BBBBLLLLBBH", 0, 0, 0, 0, 0, 8, 0, 0, 0, 0, 0) + bytes(48)
    return mf4(dg, cg, cn)


def sqlite_file(*statements: str) -> bytes:
    with closing(sqlite3.connect(":memory:")) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
        return bytes(database.serialize())


def dbc(body: str) -> bytes:
    return (DBC_HEAD + body).encode()


def kcd_bomb() -> bytes:
    message = '<Message id="0x1" name="m" length="4000000000"><Signal name="s" offset="0" length="8"/></Message>'
    return (
        '<?xml version="1.0"?><NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/>'
        f'<Bus name="b">{message}</Bus></NetworkDefinition>'
    ).encode()


ENTITIES = (
    b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]>'
    b"<NetworkDefinition>&c;</NetworkDefinition>"
)
TABLE_HEAD = b"Time [s],Engine Speed [rpm],Pressure [kPa]\n"
TABLE_ROWS = b"".join(b"%d.0,1000,%d\n" % (second, second % 7) for second in range(100))


def parquet_bomb(columns: int = 2, rows: int = 50_000_000) -> bytes:
    """Return a table of few bytes and many rows: one value, said once for all."""
    group = 1 << 20
    same = pa.DictionaryArray.from_arrays(pa.array(np.zeros(group, np.int8)), pa.array([1.5]))
    names = ["time", *(f"Signal {number}" for number in range(1, columns))]
    written = pa.BufferOutputStream()
    table = pa.table([same] * columns, names=names)
    with pq.ParquetWriter(written, table.schema, compression="zstd") as writer:
        for _ in range(rows // group):
            writer.write_table(table)
    found: bytes = written.getvalue().to_pybytes()
    return found


def arrow_bomb() -> bytes:
    """Return a stream whose one batch unpacks to gigabytes."""
    written = pa.BufferOutputStream()
    zeros = pa.array(np.zeros(1 << 26))
    table = pa.table([zeros] * 3, names=["time", "Engine Speed", "Pressure"])
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(written, table.schema, options=options) as writer:
        writer.write_table(table)
    found: bytes = written.getvalue().to_pybytes()
    return found


def nested_parquet() -> bytes:
    """Return a table whose cells are lists in lists in lists, beside a time and a signal."""
    cells: Any = [1.0]
    for _ in range(60):
        cells = [cells]
    written = pa.BufferOutputStream()
    pq.write_table(pa.table({"time": np.arange(50.0), "speed": np.arange(50.0), "deep": [cells] * 50}), written)
    found: bytes = written.getvalue().to_pybytes()
    return found


def measured_bomb() -> bytes:
    """Return a measurement of ten million rows that are all the same."""
    with NamedTemporaryFile(suffix=".mf4") as file:
        same = np.zeros(10_000_000)
        measurements.written(Path(file.name), [(same, [measurements.Measured("Speed", "rpm", same)])])
        return Path(file.name).read_bytes()


HOSTILE: Mapping[str, Callable[[], bytes]] = {
    "row.csv": lambda: TABLE_HEAD + TABLE_ROWS + b"101.0," + b"1," * (32 << 20) + b"\n" + TABLE_ROWS,
    "cells.csv": lambda: TABLE_HEAD + TABLE_ROWS + b"101.0," + b"9" * (64 << 20) + b"\n" + TABLE_ROWS,
    "columns.csv": lambda: b"Time [s]" + b",Speed [rpm]" * 500_000 + b"\n" + (b"1.0" + b",5" * 500_000 + b"\n") * 4,
    "quotes.csv": lambda: TABLE_HEAD + TABLE_ROWS + b'"' * (16 << 20),
    "bomb.parquet": parquet_bomb,
    "columns.parquet": lambda: parquet_bomb(columns=400, rows=1 << 20),
    "nested.parquet": nested_parquet,
    "bomb.arrows": arrow_bomb,
    "endless.blf": endless_blf,
    "bomb.blf": lambda: blf(deflated(bytes(1 << 20), 80, 15), 2, 1 << 30),
    **PACKED,
    "line.log": lambda: LINE + b"x" * (64 << 20),
    "lines.asc": lambda: b"base hex  timestamps absolute\n" + b"1.0 1 123 Rx d 9 zz\n" * 1_000_000,
    "loop.mf4": mf4_loop,
    "channels.mf4": mf4_channel_loop,
    "measured.mf4": measured_bomb,
    "view.db": lambda: sqlite_file(ENDLESS_VIEW),
    "cell.db": lambda: sqlite_file(
        "CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)",
        "INSERT INTO messages VALUES (1.0, 1, 0, 0, 0, 8, zeroblob(50000000))",
    ),
    "signal.dbc": lambda: dbc('BO_ 1 m: 8 A\n SG_ s : 0|4000000000@1+ (1,0) [0|0] "" A\n'),
    "message.dbc": lambda: dbc('BO_ 1 m: 4000000000 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'),
    "message.kcd": kcd_bomb,
    "entities.kcd": lambda: ENTITIES,
    "message.sym": lambda: (
        b'FormatVersion=6.0 // x\nTitle="x"\n\n{SENDRECEIVE}\n\n[m]\nID=100h\nLen=4000000000\nVar=s unsigned 0,8\n'
    ),
}


def listen_at(path: Path) -> None:
    """Leave a socket there."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


HOLE_BYTES = 10 * 2**30
# Sound beginnings, behind which comes nothing; and the same between two sound pieces.
HOLLOW: Mapping[str, Callable[[], bytes]] = {
    "hollow.log": lambda: LINES,
    "hollow.asc": lambda: b"date Thu Jan 1 10:00:00.005 am 2026\nbase hex  timestamps absolute\n",
    "hollow.trc": lambda: b";$FILEVERSION=1.1\n;$STARTTIME=46000.5\n",
    "hollow.csv": lambda: b"timestamp,arbitration_id,extended,remote,error,dlc,data\n",
    "hollow.gvret": lambda: b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n",
    "hollow.busmaster": lambda: b"***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n",
    "hollow.crtd": lambda: b"1000.000100 R11 402 FA 01 C3 A0 96 00 07 01\n" * 2_000,
    "hollow.blf": endless_blf,
    "hollow.mf4": mf4,
    "unfinished.mf4": lambda: mf4().replace(b"MDF     ", b"UnFinMF ", 1),
    "hollow.db": lambda: sqlite_file("CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)"),
    "hollow.gz": lambda: deflated(LINES, 1, 31)[:-20],
    "hollow.xz": lambda: xz_bomb()[:1_000],
    "hollow.dbc": lambda: dbc(""),
    "hollow.profile": lambda: b'name = "hollow"\n',
    "hollow.calibration": lambda: b"",
}
DATABASE = "canlog.database.loading:load_database"
READERS: Mapping[str, str] = {
    ".dbc": DATABASE,
    ".kcd": DATABASE,
    ".sym": DATABASE,
    ".profile": "diag_service.mapping.profile:load_profile",
    ".calibration": "clutch_model.calibration:read_calibration",
    ".config": "diag_service.settings.options:read_settings",
    ".password": "fleet_link.address:read_secret",
    ".scenario": "ecu_emulator.scenario.scenario_file:load_scenario",
    ".truth": "ecu_emulator.truth:read_truth",
}  # by suffix; everything else is a log
PLACES: Mapping[str, Callable[[Path], None]] = {
    "zero": lambda path: path.symlink_to("/dev/zero"),
    "random": lambda path: path.symlink_to("/dev/urandom"),
    "pipe": os.mkfifo,
    "folder": Path.mkdir,
    "socket": listen_at,
}  # that are no files
NO_FILES = tuple(
    f"{place}{suffix}" for place in PLACES for suffix in (*READERS, ".log") if suffix not in {".kcd", ".sym"}
)
ALL = (*HOSTILE, *HOLLOW, *(f"middle-{name}" for name in HOLLOW), *NO_FILES)
SLOW = frozenset(
    {
        "lines.asc",
        *(name for name in PACKED if name not in QUICKLY_REFUSED),
    }
)  # take all the time that they are given, or seconds until they are packed


def make(name: str, path: Path) -> None:
    """Make one of ``ALL``."""
    kind, _, _ = name.partition(".")
    if name in HOSTILE:
        path.write_bytes(HOSTILE[name]())
    elif name in NO_FILES:
        PLACES[kind](path)
        if kind == "pipe":
            path.chmod(0o600)
    else:
        beginning = HOLLOW[name.removeprefix("middle-")]()
        with path.open("wb") as file:
            file.write(beginning)
            file.truncate(HOLE_BYTES)
            if name.startswith("middle-"):
                file.seek(0, os.SEEK_END)
                file.write(beginning)


def refusal_of(path: Path) -> Refusal:
    """Have a file read by a process of its own, and return what that took."""
    reader = READERS.get(path.suffix)
    began_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", READ_LOG if reader is None else READ, str(path), str(reader)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    cpu_s: dict[int, float] = {}
    peak_bytes = 0
    while process.poll() is None and time.monotonic() - began_s < HANG_S:
        used_bytes = 0
        for pid in session_of(process.pid):
            with suppress(OSError, ValueError, IndexError):
                cpu_s[pid] = processor_s(pid)
                used_bytes += memory_bytes(pid)
        peak_bytes = max(peak_bytes, used_bytes)
        time.sleep(SAMPLE_S)
    process.kill()
    said = process.communicate()[0].strip()
    return Refusal(cpu_s=sum(cpu_s.values()), wall_s=time.monotonic() - began_s, peak_bytes=peak_bytes, said=said)


def session_of(leader: int) -> list[int]:
    """Return the processes of a session."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            if os.getsid(int(entry.name)) == leader:
                found.append(int(entry.name))
    return found


def processor_s(pid: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def memory_bytes(pid: int) -> int:
    """Return the memory of a process, its share of what it shares with others."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(PSS_MARK))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=ALL, metavar="FILE", action="append", help="default: all")
    options = parser.parse_args()
    bad_count = 0
    print(f"{'file':24} {'bytes':>11} {'CPU s':>6} {'wall s':>6} {'MiB':>5}  what is said")
    with TemporaryDirectory() as folder:
        for name in options.only or ALL:
            path = Path(folder) / name
            make(name, path)
            size_bytes = path.lstat().st_size
            taken = refusal_of(path)
            bad_count += not taken.is_good
            said = taken.said.replace(f"{folder}/", "")
            print(
                f"{name:24} {size_bytes:11} {taken.cpu_s:6.2f} {taken.wall_s:6.2f} "
                f"{taken.peak_bytes / 2**20:5.0f}  {'' if taken.is_good else 'BAD: '}{said}",
                flush=True,
            )
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
    print(f"{bad_count} not refused within {LIMIT_S:.0f} s of processor time and {LIMIT_BYTES >> 20} MiB")
    return 1 if bad_count else 0


if __name__ == "__main__":
    sys.exit(main())
