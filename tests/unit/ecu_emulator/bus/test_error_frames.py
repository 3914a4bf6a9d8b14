"""Error frames on their way out: candump logs and live buses carry them, other logs refuse."""

from pathlib import Path

import numpy as np
from can.io import CanutilsLogReader

from ecu_emulator.bus.bus_faults import error_frames
from ecu_emulator.bus.frames import joined
from ecu_emulator.log_formats.record import open_log
from tests.support.wire import drive

SOUND = drive(0.02)
FRAMES = joined(SOUND, error_frames(np.array([0.021, 0.022])))


def test_a_candump_log_keeps_them(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with open_log(path) as log:
        log.write(FRAMES)
    with CanutilsLogReader(path) as reader:
        messages = list(reader)
    assert [message.is_error_frame for message in messages] == [False] * len(SOUND) + [True] * 2
    assert path.read_text(encoding="ascii").splitlines()[-1].endswith(" vcan0 20000088#0000040000000000")
