"""Kills a controller at every step of keeping its memory: ``python -m tests.support.uds.killed_keeper FOLDER``.

One JSON line per kill: after which acknowledgements it came, and which codes the next start finds confirmed.
"""

import json
import os
import pathlib
import signal
import sys
from pathlib import Path
from types import FrameType

from ecu_emulator.diagnostics import controller as controller_module
from ecu_emulator.diagnostics import memory_file
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.table_file import shipped_table

OLD, NEW = 0x27874B, 0x02184B  # confirmed before, and by the drive that is killed
FILES = (memory_file.__file__, controller_module.__file__)
BELOW = (os.__file__, pathlib.__file__)  # what these do to the disk within a step
DISK = {"open", "fdopen", "write_text", "write_bytes", "replace", "rename", "unlink", "touch"}
STEPS = {"__enter__", "__exit__", "__init__", "load", "save", "_sync_folder", "_change", "_kept", "_save"}


def controller(store: MemoryFile) -> Controller:
    return Controller(
        shipped_table(), values=lambda: {"vehicle_speed_m_s": 0.0}, clock=lambda: 0.0, chance=bytes, store=store
    )


def drive(path: Path, acknowledge: int) -> None:
    """Start, let a second code fail, clear all; a byte is written after each that has returned."""
    with MemoryFile(path, shipped_table()) as store:
        one = controller(store)
        os.write(acknowledge, b"s")
        one.report(NEW, TestResult.FAILED)
        os.write(acknowledge, b"f")
        if one.ask(b"\x14\xff\xff\xff") == b"\x54":
            os.write(acknowledge, b"c")


class Killer:
    """A trace function that kills its own process before the line with this number is run, of those in ``STEPS``."""

    def __init__(self, lines_left: int) -> None:
        self.lines_left = lines_left

    def __call__(self, frame: FrameType, event: str, _argument: object) -> "Killer | None":
        is_step = frame.f_code.co_filename in FILES and frame.f_code.co_name in STEPS
        is_in_one = frame.f_back is not None and frame.f_back.f_trace is not None
        if not is_step and not (is_in_one and frame.f_code.co_filename in BELOW and frame.f_code.co_name in DISK):
            return None
        if event == "line":
            self.lines_left -= 1
            if self.lines_left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
        return self


def killed_at(line: int, path: Path) -> tuple[bool, str]:
    """Return whether the process was killed, and what it had acknowledged."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        sys.settrace(Killer(line))
        drive(path, writer)
        os._exit(0)
    os.close(writer)
    _, status = os.waitpid(child, 0)
    acknowledged = os.read(reader, 16).decode()
    os.close(reader)
    return os.WIFSIGNALED(status), acknowledged


def main(folder: Path) -> None:
    path = folder / "memory.json"
    with MemoryFile(path, shipped_table()) as store:
        controller(store).report(OLD, TestResult.FAILED)
    before = path.read_bytes()
    line, was_killed = 0, True
    while was_killed:
        line += 1
        path.write_bytes(before)
        was_killed, acknowledged = killed_at(line, path)
        with MemoryFile(path, shipped_table()) as store:
            memory = controller(store).state.memory
        confirmed = sorted(number for number, record in memory.records.items() if record.status & 0x08)
        print(json.dumps({"line": line, "acknowledged": acknowledged, "confirmed": confirmed}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
