"""How long a command takes from its start to its end where nothing is compiled yet, and where all is.

    python -m benchmarks.start

A short drive is recorded and analysed by programs of their own, first with an empty kernel cache, then with a full one.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

WARM_RUNS = 5
GOALS_S = {"cold": 15.0, "warm": 2.0}  # of analyze


def seconds_of(command: Sequence[str], cache: Path) -> float:
    """Return how long a program takes whose kernels are kept in ``cache`` [s]."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    environment.pop("NUMBA_CACHE_DIR", None)
    began_s = time.perf_counter()
    subprocess.run([sys.executable, "-m", *command], env=environment, check=True, capture_output=True)
    return time.perf_counter() - began_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--warm-runs", type=int, default=WARM_RUNS, metavar="N", help="default: %(default)s")
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "drive.log"
        commands = {
            "ecu-emulator record": [
                "ecu_emulator",
                "record",
                str(log),
                "--scenario",
                "noise_only",
                "--cycles",
                "1",
                "--force",
            ],
            "diag-service analyze": ["diag_service", "analyze", str(log), "--json"],
        }
        print(f"{'one cycle of ten shifts':24}  cold s  warm s (median of {options.warm_runs})")
        for label, command in commands.items():
            cache = folder / command[0]  # of its own: the programs share some kernels
            cold_s = seconds_of(command, cache)
            warm_s = statistics.median(seconds_of(command, cache) for _ in range(options.warm_runs))
            print(f"{label:24} {cold_s:7.1f} {warm_s:7.2f}")
        print(f"goals for analyze: cold {GOALS_S['cold']:.0f} s, warm {GOALS_S['warm']:.0f} s")


if __name__ == "__main__":
    main()
