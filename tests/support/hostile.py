"""Files that are made to do harm, and what refusing them takes: time and memory.

Endless loops, bombs, tables without an end, ten gigabytes of nothing behind a sound header. ``python -m
tests.support.hostile FILE ...`` reads each in a fork of its own, whose processor time and memory the system tells. The
limits are 10 s and 512 MiB, the interpreter and all libraries included.
"""

import json
import lzma
import os
import resource
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from types import MappingProxyType
from typing import Final

from canlog.errors import SourceError
from canlog.logs import read_log
from tests.support.patience import HANG_S

LINE: Final = b"(1.0) can0 123#11\n"
LINES: Final = LINE * 2_000
LIMIT_S = 10.0
LIMIT_BYTES = 512 * 2**20


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


TABLE_HEAD = b"Time [s],Engine Speed [rpm],Pressure [kPa]\n"
TABLE_ROWS = b"".join(b"%d.0,1000,%d\n" % (second, second % 7) for second in range(100))


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


HOSTILE: Final[Mapping[str, Callable[[Path], object]]] = MappingProxyType({
    "row.csv": written(lambda: TABLE_HEAD + TABLE_ROWS + b"101.0," + b"1," * (32 << 20) + b"\n" + TABLE_ROWS),
    "quotes.csv": written(lambda: TABLE_HEAD + TABLE_ROWS + b'"' * (16 << 20)),
    "bomb.log.xz": written(xz_bomb),
    "line.log": written(lambda: LINE + b"x" * (64 << 20)),
    "loop.mf4": written(mf4_loop),
    "hollow.blf": hollow(endless_blf),
    "hollow.mf4": hollow(mf4),
    "middle-hollow.log": hollow(lambda: LINES, has_end=True),
})  # fmt: skip
"""What makes each of them, by name."""


def refusals_of(paths: Sequence[Path]) -> list[Refusal]:
    """Have files read by forks of one process, and return what each took."""
    command = [sys.executable, "-m", "tests.support.hostile", *map(str, paths)]
    done = subprocess.run(command, stdout=subprocess.PIPE, timeout=HANG_S * len(paths), check=True)
    return [Refusal(**json.loads(line)) for line in done.stdout.splitlines()]


def what_is_said(path: str) -> str:
    """Read a log; return what there is to complain of."""
    try:
        reader = read_log(path)
        for _ in reader:
            pass
    except SourceError as exc:
        return str(exc)
    return str(reader.counts.first_fault)


def refusal_of(path: str) -> Refusal:
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (2 * int(LIMIT_S), 2 * int(LIMIT_S)))  # ends what is endless
            os.write(writing, what_is_said(path).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as pipe:
        said = pipe.read()
    _, _, used = os.wait4(child, 0)
    return Refusal(cpu_s=used.ru_utime + used.ru_stime, peak_bytes=1024 * used.ru_maxrss, said=said)


if __name__ == "__main__":
    vars(sys)["modules"]["asammdf"] = None  # as programs keep it from being loaded before it is needed
    with NamedTemporaryFile(suffix=".log") as sound:  # read first, so that no fork has to load what reads
        sound.write(LINES)
        sound.flush()
        what_is_said(sound.name)
    for one in sys.argv[1:]:
        print(json.dumps(asdict(refusal_of(one))))
