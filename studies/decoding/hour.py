"""A long log made of one recorded drive, repeated with later times."""

import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np

from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.writers import BlfWriter, CandumpWriter, FrameWriter, Header, Mf4Writer

NS_PER_US: Final = 1_000
NS_PER_S: Final = 1_000_000_000
PAUSE_NS: Final = 2 * NS_PER_S  # bus time stands still between the drives: each is a segment of its own
CHANNEL: Final = "vcan0"
WRITERS: Final[dict[str, type[FrameWriter]]] = {".log": CandumpWriter, ".blf": BlfWriter, ".mf4": Mf4Writer}


def record_drive(folder: Path, *options: str) -> FrameBatch:
    """Return the frames of a drive with production scatter, as the emulator's users record them."""
    path = folder / "drive.log"
    command = [sys.executable, "-m", "ecu_emulator", "record", str(path), *options]
    subprocess.run(command, check=True, capture_output=True)
    return join(list(read_log(path)))


def write_drive(drive: FrameBatch, path: Path, *, later_ns: int = 0) -> None:
    """Write the frames of a drive in the format of a suffix, all so much later."""
    t_us = (drive.t_ns + later_ns) // NS_PER_US
    with path.open("wb") as file:
        writer = WRITERS[path.suffix](file, Header(start_us=int(t_us[0]), channel=CHANNEL))
        writer.write(t_us, _encoded(drive))
        writer.close()


def _encoded(drive: FrameBatch) -> EncodedFrames:
    return EncodedFrames(t_s=np.zeros(len(drive)), can_id=drive.can_id, length=drive.length, data=drive.data)


def write_hour(drive: FrameBatch, count: int, candump: Path, blf: Path) -> float:
    """Write ``count`` frames of the drive, over and over, in both formats; return how much bus time that is [s]."""
    first_us = int(drive.t_ns[0]) // NS_PER_US
    header = Header(start_us=first_us, channel=CHANNEL)
    round_us = (int(drive.t_ns[-1] - drive.t_ns[0]) + PAUSE_NS) // NS_PER_US
    t_us = drive.t_ns // NS_PER_US
    frames = _encoded(drive)
    with ExitStack() as files:
        writers = (
            CandumpWriter(files.enter_context(candump.open("wb")), header),
            BlfWriter(files.enter_context(blf.open("wb")), header),
        )
        written, last_us = 0, first_us
        while written < count:
            part = slice(0, min(len(drive), count - written))
            times_us = t_us[part] + written // len(drive) * round_us
            for writer in writers:
                writer.write(times_us, frames[part])
            written, last_us = written + len(times_us), int(times_us[-1])
        for writer in writers:
            writer.close()
    return (last_us - first_us) / 1e6
