"""How much memory ``decode`` needs for a log of ten gigabytes, made as it is read: candump text through a pipe.

A bus of a hundred messages with 700 signals over and over, its times running on. The largest memory of the program is
what the kernel says of it (VmHWM); its children, which parse the database, end before the log is read.

With ``--lazy`` it is Python that reads, by ``canlog.read(...).batches()``, and a file on the disk.

    python -m studies.decoded_memory [--gigabytes 10] [--layout wide] [--layout messages] [--lazy]
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final

import numpy as np

from studies.decoding.wide_bus import frames, write_database, write_log
from studies.measuring import machine
from canlog.arrays import UInt8Array

FRAMES: Final = 651_360  # of one round
GOAL_MB: Final = 500.0
SECONDS: Final = slice(1, 11)  # place of the whole seconds in a line, ten digits
LAYOUTS: Final = ("wide", "messages")
LAZY: Final = """
import sys, canlog
rows = 0
for batch in canlog.read(sys.argv[1], sys.argv[2]).batches():
    rows += batch.num_rows
print(rows)
"""


def lines_of(folder: Path) -> UInt8Array:
    """Return one round as text, shape (frames, characters): every frame has eight bytes, so every line is as long."""
    text = write_log(folder / "round.log", frames(FRAMES)).read_bytes()
    return np.frombuffer(text, np.uint8).reshape(FRAMES, -1).copy()


def rounds(lines: UInt8Array, size_bytes: int) -> Iterator[UInt8Array]:
    """Yield the text over and over until there is enough of it, each time later."""
    weights = 10 ** np.arange(9, -1, -1, dtype=np.int64)
    seconds = (lines[:, SECONDS].astype(np.int64) - ord("0")) @ weights
    lasts_s = int(seconds[-1] - seconds[0]) + 2
    for _ in range(-(-size_bytes // lines.size)):
        yield lines
        seconds += lasts_s
        lines[:, SECONDS] = seconds[:, None] // weights % 10 + ord("0")


def peak_mb(pid: int) -> float:
    """Return the largest memory that a running program has had; 0 when it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0.0
    return next((int(line.split()[1]) * 1024 / 1e6 for line in status.splitlines() if line.startswith("VmHWM:")), 0.0)


def report(lines: UInt8Array, folder: Path, size_bytes: int, layout: str) -> float:
    """Decode so much text, print what it took, and return the largest memory [MB]."""
    output = folder / f"{layout}.tables"
    words = ["decode", "-", "--dbc", str(folder / "bus.dbc"), "-o", str(output), "--layout", layout]
    words += ["--force", "--format", "parquet"]
    began_s, sent_bytes, largest_mb = time.perf_counter(), 0, 0.0
    with subprocess.Popen(
        [sys.executable, "-m", "diag_service", *words], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
    ) as program:
        to_program: IO[bytes] = program.stdin or sys.stdout.buffer
        for text in rounds(lines, size_bytes):
            to_program.write(text.data)
            sent_bytes += text.size
            largest_mb = max(largest_mb, peak_mb(program.pid))
        to_program.close()
        while program.poll() is None:
            largest_mb = max(largest_mb, peak_mb(program.pid))
            time.sleep(0.01)
    if program.returncode:
        raise RuntimeError(f"decode ended with {program.returncode}")
    size_mb = sum(file.stat().st_size for file in ([output] if output.is_file() else output.iterdir())) / 1e6
    verdict = "met" if largest_mb < GOAL_MB else "MISSED"
    print(
        f"{layout}: {sent_bytes / 1e9:.2f} GB of text, {sent_bytes // lines.shape[1]} frames, in "
        f"{time.perf_counter() - began_s:.0f} s; files {size_mb:.0f} MB; largest memory "
        f"{largest_mb:.0f} MB   needed < {GOAL_MB:.0f} MB: {verdict}",
        flush=True,
    )
    return largest_mb


def report_lazy(lines: UInt8Array, folder: Path, size_bytes: int) -> float:
    """Read a file of so much text batch by batch, print what it took, and return the largest memory [MB]."""
    log, largest_mb, began_s = folder / "long.log", 0.0, time.perf_counter()
    with log.open("wb") as file:
        for text in rounds(lines, size_bytes):
            file.write(text.data)
    words = [sys.executable, "-c", LAZY, str(log), str(folder / "bus.dbc")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as program:
        while program.poll() is None:
            largest_mb = max(largest_mb, peak_mb(program.pid))
            time.sleep(0.05)
        rows = int(program.stdout.read()) if program.stdout else 0
    verdict = "met" if largest_mb < GOAL_MB else "MISSED"
    print(
        f"batches: {log.stat().st_size / 1e9:.2f} GB of text, {rows} rows, in {time.perf_counter() - began_s:.0f} s; "
        f"largest memory {largest_mb:.0f} MB   needed < {GOAL_MB:.0f} MB: {verdict}",
        flush=True,
    )
    return largest_mb


def main() -> int:
    """Run the benchmark; status 1 if too much memory was needed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=10.0, help="of text (%(default)s)")
    parser.add_argument("--layout", action="append", choices=LAYOUTS, help="of the table (both)")
    parser.add_argument("--lazy", action="store_true", help="read by Python instead, batch by batch")
    options = parser.parse_args()
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_database(folder / "bus.dbc")
        size_bytes = round(options.gigabytes * 1e9)
        lines = lines_of(folder)
        if options.lazy:
            largest = [report_lazy(lines, folder, size_bytes)]
        else:
            largest = [report(lines.copy(), folder, size_bytes, layout) for layout in options.layout or LAYOUTS]
    return 0 if max(largest) < GOAL_MB else 1


if __name__ == "__main__":
    sys.exit(main())
