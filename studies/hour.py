"""An hour of a WLTC's bus from its file to results, beside the time of decoding it.

Two WLTCs of half an hour, as candump text and as BLF. What is timed is what the program does for a log in a folder:
reading, decoding, finding shifts and launches, estimating, and the records that are written. Beside it stand reading
and decoding alone, and both with what finds the shifts.

    python -m studies.hour
"""

import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from diag_service.batch.drives import drive_of
from diag_service.batch.tables import Entry
from diag_service.batch.worker import Analyst
from diag_service.settings.config import DiagnosisConfig
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats import open_log
from studies import bars
from studies.builders import new_decoder, new_stages
from studies.run import machine, parsed, study_parser, took_s

NS_PER_S: Final = 1_000_000_000
HOUR_NS: Final = 3600 * NS_PER_S
PAUSE_S: Final = 2.0  # bus time stands still between the drives: each is a segment of its own
SUFFIXES: Final = {"candump": ".log", "BLF": ".blf"}


def record_drive(folder: Path, *options: str) -> FrameBatch:
    """Return the frames of a drive with production scatter, as the emulator's users record them."""
    path = folder / "drive.log"
    command = [sys.executable, "-m", "ecu_emulator", "record", str(path), *options]
    subprocess.run(command, check=True, capture_output=True)
    return join(list(read_log(path)))


def write_hour(drive: FrameBatch, count: int, path: Path) -> float:
    """Write ``count`` frames of the drive, over and over; return how much bus time that is [s]."""
    t_s, last_s = (drive.t_ns - drive.t_ns[0]) / NS_PER_S, 0.0
    frames = EncodedFrames(t_s=t_s, can_id=drive.can_id, length=drive.length, data=drive.data)
    with open_log(path, start_ns=int(drive.t_ns[0])) as log:
        for first in range(0, count, len(drive)):
            later_s = first // len(drive) * (t_s[-1] + PAUSE_S)
            part = frames[: count - first]
            log.write(replace(part, t_s=part.t_s + later_s))
            last_s = float(part.t_s[-1] + later_s)
    return last_s


def decode(log: Path) -> None:
    """Read a log and make columns of all its frames."""
    decoder = new_decoder()
    with closing(read_log(log)) as reader:
        for _ in decoder.whole(reader):
            pass


def find_shifts(log: Path) -> None:
    """Do the same and cut out what shifts, launches and creeps are made of."""
    stages = new_stages()
    with closing(read_log(log)) as reader:
        for batch in reader:
            stages.segment(batch)
    stages.flush()


def analyse(log: Path) -> Entry:
    """Return what the program makes of a log in a folder, ready to be written."""
    return Analyst(DiagnosisConfig(vehicle="vehicle", calibration=nominal_calibration())).analyse(drive_of([log]))


STEPS: Final[tuple[Callable[[Path], object], ...]] = (decode, find_shifts, analyse)


def report(name: str, log: Path, rounds: int, bus_s: float) -> None:
    """Measure and print one format; the first pass compiles what is not compiled."""
    count = len(analyse(log).shifts)
    decode_s, find_s, result_s = (min(took_s(partial(step, log)) for _ in range(rounds)) for step in STEPS)
    hour_s = result_s * HOUR_NS / NS_PER_S / bus_s
    print(f"{name}: processor time [s], the least of {rounds} rounds")
    print(
        f"  decoded {decode_s:6.2f}, to shifts {find_s:6.2f}, to results {result_s:6.2f}"
        f"   ({count} events, {1e3 * (result_s - find_s) / count:.2f} ms each)"
    )
    print(f"  an hour to results {hour_s:.2f} s   {bars.HOUR.judged(hour_s)}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the hour once, measure, print."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--frames", type=int, help="of the drive, over and over (an hour)")
    parser.add_argument("--drive", default="wltc")
    parser.add_argument("--rounds", type=int, default=3)
    options = parsed(parser, arguments, frames=600_000, rounds=1)
    print(machine())
    with TemporaryDirectory() as name:
        drive = record_drive(Path(name), "--drive", options.drive)
        count = options.frames or int(len(drive) * HOUR_NS / (drive.t_ns[-1] - drive.t_ns[0] + PAUSE_S * NS_PER_S))
        for shown, suffix in SUFFIXES.items():
            log = Path(name) / f"hour{suffix}"
            bus_s = write_hour(drive, count, log)
            print(f"{count:,} frames of {options.drive}, {bus_s:.0f} s of bus")
            report(shown, log, options.rounds, bus_s)


if __name__ == "__main__":
    main()
