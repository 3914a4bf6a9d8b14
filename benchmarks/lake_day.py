"""What an hour on the road takes in a lake and of a processor: shifts alone, and with all decoded signals.

One WLTC of half an hour goes through ``diag-service analyze --lake``, and twice as many logs as half of them, so that
what the start of the program costs falls out.

    python -m benchmarks.lake_day
"""

import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmarks.measuring import machine, took_s
from tests.support.service import PROGRAM, environment

FEW, MANY = 1, 3  # logs: the difference of two runs is what their logs cost
TRACE_S: Final = 1800.0
HOUR_S: Final = 3600.0
SUFFIXES: Final = (".log", ".blf", ".mf4")


def recorded(folder: Path, suffix: str, count: int) -> int:
    """Drive a WLTC, one vehicle for each log, into a folder; return the size of all logs [bytes]."""
    folder.mkdir()
    for seed in range(1, count + 1):
        log = folder / f"drive{seed}{suffix}"
        command = [sys.executable, "-m", "ecu_emulator", "record", str(log), "--drive", "wltc", "--seed", str(seed)]
        subprocess.run(command, check=True, capture_output=True)
    return sum(log.stat().st_size for log in folder.glob(f"*{suffix}"))


def into_lake(logs: Path, lake: Path, *options: str) -> None:
    """Analyse the logs of a folder."""
    command = [*PROGRAM, "analyze", str(logs), "--lake", str(lake), *options]
    subprocess.run(command, check=True, capture_output=True, env=environment())


def stored(lake: Path, room: str) -> int:
    """Return the size of one kind of parts [bytes]."""
    return sum(part.stat().st_size for part in (lake / room).rglob("*.parquet"))


def main() -> None:
    """Measure and print, per hour of driving."""
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        for suffix in SUFFIXES:
            size = recorded(folder / f"size{suffix}", suffix, 1)
            print(f"log {suffix:5} {size / 1e6 * HOUR_S / TRACE_S:8.1f} MB an hour")
        few, many = folder / "few", folder / "many"
        recorded(few, ".blf", FEW)
        recorded(many, ".blf", MANY)
        hours = (MANY - FEW) * TRACE_S / HOUR_S
        for title, options in (("shifts", ()), ("shifts and signals", ("--signals", "*"))):
            short, whole = folder / f"{title} few", folder / f"{title} many"
            start_s = took_s(partial(into_lake, few, short, *options))
            took = took_s(partial(into_lake, many, whole, *options)) - start_s
            sizes = {room: (stored(whole, room) - stored(short, room)) / hours for room in ("shifts", "signals")}
            parts = ", ".join(f"{room} {size / 1e6:.2f} MB" for room, size in sizes.items() if size)
            print(f"{title}: {parts}; {took / hours:.1f} s of a core, each an hour of driving")


if __name__ == "__main__":
    main()
