"""A log through a pipe beside the same log as a file: ``cat LOG | diag-service analyze -`` and ``analyze LOG``.

Whole programs are timed, in turns, and their starts are taken off: what is left is reading and analysing.
"""

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

GOAL_RATIO: Final = 0.5  # of the file's speed
FRAMES_PER_CYCLE: Final = 25_000  # at least
COMMANDS: Final = {
    "analyze": ("analyze", "--json"),
    "inspect": ("inspect", "--json"),
    "decode": ("decode", "-o", "-", "--format", "arrow", "--layout", "long"),
}


def seconds_of(words: tuple[str, ...], log: Path, *, is_piped: bool) -> float:
    """Return how long a command takes from its start to its end [s]."""
    program = [sys.executable, "-m", "diag_service", *words]
    began_s = time.perf_counter()
    if is_piped:
        with subprocess.Popen(["cat", str(log)], stdout=subprocess.PIPE) as writer:
            subprocess.run(
                [*program, "-"], stdin=writer.stdout, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True
            )
    else:
        subprocess.run([*program, str(log)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return time.perf_counter() - began_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000, metavar="N", help="default: %(default)s")
    parser.add_argument("--command", choices=[*COMMANDS, "all"], default="all", help="default: %(default)s")
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each, in turns (default: %(default)s)")
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        long, short = Path(name) / "long.log", Path(name) / "short.log"
        cycles = str(options.frames // FRAMES_PER_CYCLE + 1)
        record = [sys.executable, "-m", "ecu_emulator", "record", str(long), "--scenario", "noise_only"]
        subprocess.run([*record, "--cycles", cycles], check=True, capture_output=True)
        lines = long.read_bytes().splitlines(keepends=True)[: options.frames]
        long.write_bytes(b"".join(lines))
        short.write_bytes(b"".join(lines[:100]))
        print(f"{len(lines)} frames, {long.stat().st_size / 1e6:.0f} MB of candump; medians of {options.runs} runs")
        print(f"{'command':8} {'file s':>7} {'pipe s':>7} {'start s':>8} {'file M/s':>9} {'pipe M/s':>9} {'ratio':>6}")
        for command, words in COMMANDS.items():
            if options.command not in {command, "all"}:
                continue
            for log in (short, long):  # compiled and in memory before anything is timed
                seconds_of(words, log, is_piped=False)
            turns = [
                (
                    seconds_of(words, long, is_piped=False),
                    seconds_of(words, long, is_piped=True),
                    seconds_of(words, short, is_piped=False),
                )
                for _ in range(options.runs)
            ]
            file_s, pipe_s, start_s = (statistics.median(column) for column in zip(*turns, strict=True))
            speeds = [len(lines) / (whole_s - start_s) / 1e6 for whole_s in (file_s, pipe_s)]
            ratio = speeds[1] / speeds[0]
            print(
                f"{command:8} {file_s:7.2f} {pipe_s:7.2f} {start_s:8.2f} {speeds[0]:9.2f} {speeds[1]:9.2f} {ratio:6.2f}"
            )
    print(f"goal: at least {GOAL_RATIO:.2f} of the file's speed")


if __name__ == "__main__":
    main()
