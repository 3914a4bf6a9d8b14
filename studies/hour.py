"""An hour of a WLTC's bus from its file to results, beside the time of decoding it, now and before a change.

Two WLTCs of half an hour, as candump text and as BLF. What is timed is what the program does for a log in a folder:
reading, decoding, finding shifts and launches, estimating, and the records that are written. Beside it stand reading
and decoding alone, and both with what finds the shifts. ``--before`` names a folder with another version of this
project, which is timed in turns with this one:

    git worktree add ../before COMMIT
    python -m studies.hour --before ../before
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import studies.decoding.timed_hour as program
from studies import bars
from studies.decoding.hour import NS_PER_S, PAUSE_NS, record_drive, write_hour
from studies.measuring import machine

ROUNDS: Final = 3
HOUR_NS: Final = 3600 * NS_PER_S
HERE: Final = Path(__file__).parents[1]
DECODE, FIND, ANALYSE = "decode", "find_shifts", "analyse"

Times = dict[str, float]


def measured(tree: Path, log: Path) -> Times:
    """Return the times of one version in a process of its own."""
    command = [sys.executable, "-P", str(Path(program.__file__)), str(log.absolute())]
    variables = {**os.environ, "PYTHONPATH": str(tree.absolute())}
    said = subprocess.run(command, check=True, capture_output=True, text=True, env=variables, cwd=tree).stdout
    times: Times = json.loads(said)
    return times


def least(rounds: Sequence[Times]) -> Times:
    """Return the least time of each step."""
    return {name: min(one[name] for one in rounds) for name in rounds[0]}


def told(name: str, found: dict[str, Times]) -> str:
    """Return what a format takes, a line for each version."""
    lines = [f"{name}: processor time [s], the least of {ROUNDS} rounds"]
    event_ms = {version: 1e3 * (times[ANALYSE] - times[FIND]) / times["events"] for version, times in found.items()}
    lines += [
        f"  {version:7} decoded {times[DECODE]:6.2f}, to shifts {times[FIND]:6.2f}, to results {times[ANALYSE]:6.2f}"
        f"   ({times['events']:.0f} events, {event_ms[version]:.2f} ms each)"
        for version, times in found.items()
    ]
    result_s = found["now"][ANALYSE]
    lines.append(f"  an hour to results {result_s:.2f} s   {bars.HOUR.judged(result_s)}")
    if "before" in found:
        result_ratio = found["before"][ANALYSE] / result_s
        event_ratio = event_ms["before"] / event_ms["now"]
        lines += [f"  before over now: to results {result_ratio:.2f}, each event once it is found {event_ratio:.2f}"]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the hour once, measure in turns, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, help="of the drive, over and over (an hour)")
    parser.add_argument("--drive", default="wltc")
    parser.add_argument("--before", type=Path, metavar="FOLDER", help="of another version of this project")
    options = parser.parse_args(arguments)
    trees = {"now": HERE} if options.before is None else {"before": options.before, "now": HERE}
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        candump, blf = folder / "hour.log", folder / "hour.blf"
        drive = record_drive(folder, "--drive", options.drive)
        count = options.frames or int(len(drive) * HOUR_NS / (drive.t_ns[-1] - drive.t_ns[0] + PAUSE_NS))
        duration_s = write_hour(drive, count, candump, blf)
        print(f"{count:,} frames of {options.drive}, {duration_s:.0f} s of bus")
        for log, shown in ((candump, "candump"), (blf, "BLF")):
            rounds = [{version: measured(tree, log) for version, tree in trees.items()} for _ in range(ROUNDS)]
            print(told(shown, {version: least([one[version] for one in rounds]) for version in trees}), flush=True)


if __name__ == "__main__":
    main()
