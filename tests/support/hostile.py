"""Files that are made to do harm, and what refusing them takes: time and memory of all processes that work on them.

Endless loops, bombs, tables without an end, ten gigabytes of nothing behind a sound header. Each is read by a process
of its own; what it and its children use is sampled while they run. The limits are 10 s of processor time and 512 MiB,
the interpreter and all libraries included.
"""

import lzma
import os
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

LINE: Final = b"(1.0) can0 123#11\n"
LINES: Final = LINE * 2_000
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """What it took to refuse a file, and what was said."""

    cpu_s: float
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


def sqlite_file(*statements: str) -> bytes:
    with closing(sqlite3.connect(":memory:")) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
        return bytes(database.serialize())


TABLE_HEAD = b"Time [s],Engine Speed [rpm],Pressure [kPa]\n"
TABLE_ROWS = b"".join(b"%d.0,1000,%d\n" % (second, second % 7) for second in range(100))


def parquet_bomb() -> bytes:
    """Return a table of few bytes and many rows: one value, said once for all."""
    group, groups = 1 << 20, 47
    same = pa.DictionaryArray.from_arrays(pa.array(np.zeros(group, np.int8)), pa.array([1.5]))
    written = pa.BufferOutputStream()
    table = pa.table([same] * 2, names=["time", "Signal"])
    with pq.ParquetWriter(written, table.schema, compression="zstd") as writer:
        for _ in range(groups):
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


def xz_bomb() -> bytes:
    packer = lzma.LZMACompressor(preset=0)
    block = LINE * 60_000
    return b"".join(packer.compress(block) for _ in range(100)) + packer.flush()


def written(contents: Callable[[], bytes]) -> Callable[[Path], object]:
    """Return what makes a file of such contents."""
    return lambda path: path.write_bytes(contents())


def hollow(contents: Callable[[], bytes], *, has_end: bool = False) -> Callable[[Path], object]:
    """Return what makes a file of a sound beginning, behind which comes nothing, or the same again at the end."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.write(contents())
            file.truncate(10 * 2**30)
            if has_end:
                file.seek(0, os.SEEK_END)
                file.write(contents())

    return make


MESSAGES: Final = "CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)"
HUGE_CELL: Final = "INSERT INTO messages VALUES (1.0, 1, 0, 0, 0, 8, zeroblob(50000000))"
HOSTILE: Final[Mapping[str, Callable[[Path], object]]] = MappingProxyType({
    "row.csv": written(lambda: TABLE_HEAD + TABLE_ROWS + b"101.0," + b"1," * (32 << 20) + b"\n" + TABLE_ROWS),
    "quotes.csv": written(lambda: TABLE_HEAD + TABLE_ROWS + b'"' * (16 << 20)),
    "bomb.parquet": written(parquet_bomb),
    "bomb.arrows": written(arrow_bomb),
    "bomb.log.xz": written(xz_bomb),
    "line.log": written(lambda: LINE + b"x" * (64 << 20)),
    "loop.mf4": written(mf4_loop),
    "cell.db": written(lambda: sqlite_file(MESSAGES, HUGE_CELL)),
    "hollow.blf": hollow(endless_blf),
    "hollow.mf4": hollow(mf4),
    "middle-hollow.log": hollow(lambda: LINES, has_end=True),
})  # fmt: skip
"""What makes each of them, by name."""


def refusal_of(path: Path) -> Refusal:
    """Have a file read by a process of its own, and return what that took."""
    began_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", READ_LOG, str(path)],
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
    return Refusal(cpu_s=sum(cpu_s.values()), peak_bytes=peak_bytes, said=said)


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
