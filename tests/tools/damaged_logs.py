"""Damaged forms of log files, read for some time: only ``CanlogError`` may come, and nothing may hang.

python -m tests.tools.damaged_logs --seconds 600 vcds_group.csv buschannel_array.mf4
"""

import argparse
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from canlog.errors import CanlogError
from canlog.logs import read_log, table_columns

HANG_S = 120
MOST_BYTES = 60_000  # of a text: damage that nothing sees is of no use
JUNK = (
    *(
        b"",
        b"nan",
        b"1e309",
        b"-",
        b";",
        b",",
        b'"',
        b"\0",
        b"\xff\xfe",
        b"0x",
        b"1,5",
        b"Time",
        b"9" * 400,
        b"\xb5\xb0",
    ),
    *(b"\r", b"\n", b"\t", b"inf", b"2026-02-30", b"%DataLog%", b"{", b"'"),
)
ENCODINGS = ("utf-16", "utf-16-le", "cp1252", "utf-8-sig")


class HangError(BaseException):
    """Reading took too long."""


def other_byte(data: bytes, at: int, rng: random.Random) -> bytes:
    return data[:at] + rng.randbytes(1) + data[at + 1 :]


def cut(data: bytes, at: int, _: random.Random) -> bytes:
    return data[:at]


def with_junk(data: bytes, at: int, rng: random.Random) -> bytes:
    return data[:at] + rng.choice(JUNK) + data[at:]


def without_some(data: bytes, at: int, rng: random.Random) -> bytes:
    return data[:at] + data[at + rng.randrange(1, 64) :]


def with_some_again(data: bytes, at: int, rng: random.Random) -> bytes:
    end = at + rng.randrange(1, 256)
    return data[:end] + data[at:end] + data[end:]


def other_lines(data: bytes, at: int, rng: random.Random) -> bytes:
    """Drop a line, or put it somewhere else as well."""
    lines = data.split(b"\n")
    line = lines.pop(at % len(lines))
    for _ in range(2 * rng.randrange(2)):
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def other_cell(data: bytes, at: int, rng: random.Random) -> bytes:
    lines, comma = data.split(b"\n"), rng.choice((b",", b";", b"\t"))
    cells = lines[at % len(lines)].split(comma)
    cells[rng.randrange(len(cells))] = rng.choice(JUNK)
    lines[at % len(lines)] = comma.join(cells)
    return b"\n".join(lines)


def other_encoding(data: bytes, _: int, rng: random.Random) -> bytes:
    return data.decode("utf-8", "replace").encode(rng.choice(ENCODINGS), "replace")


DAMAGES: tuple[Callable[[bytes, int, random.Random], bytes], ...] = (
    *(other_byte, cut, with_junk, without_some, with_some_again, other_lines, other_cell, other_encoding),
)


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return a file with one damage or several."""
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        data = rng.choice(DAMAGES)(data, rng.randrange(len(data)), rng) if data else data
    return data


def outcome(path: Path) -> str:
    """Read a file, and return how that ended."""
    signal.alarm(HANG_S)
    try:
        table_columns(path)
        with read_log(path) as reader:
            for _ in reader:
                pass
    except CanlogError:
        return "refused"
    except HangError:
        return "HANGS"
    except Exception as exc:  # noqa: BLE001 - whatever it is, it is wrong
        return f"WRONG: {type(exc).__name__}: {exc}"
    finally:
        signal.alarm(0)
    return "read"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--seconds", type=float, default=600.0, help="of each")
    arguments = parser.parse_args()

    def hangs(_: int, __: FrameType | None) -> None:
        raise HangError

    signal.signal(signal.SIGALRM, hangs)
    for log in arguments.logs:
        data, rng, counts = log.read_bytes(), random.Random(log.name), Counter[str]()  # noqa: S311 - a draw that repeats
        if log.suffix == ".csv":
            data = data[:MOST_BYTES]
        end_s = time.monotonic() + arguments.seconds
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / log.name
            while time.monotonic() < end_s:
                path.write_bytes(damaged(data, rng))
                counts[outcome(path)] += 1
        print(f"{log.name}: {', '.join(f'{count} {what}' for what, count in counts.most_common())}", flush=True)


if __name__ == "__main__":
    main()
