"""The emulator and a tester as processes on one bus: the tester asks for everything while the frames go out."""

import json
import os
import signal
import subprocess
import sys
from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from tests.support.patience import HANG_S
from tests.support.replay import free_bus

Bus: TypeAlias = tuple[list[str], dict[str, str]]  # words of the command line, and variables


@contextmanager
def emulator(bus: Sequence[str], variables: dict[str, str], *more: str) -> Iterator["subprocess.Popen[str]"]:
    words = [sys.executable, "-m", "ecu_emulator", "run", *bus, "--cycles", "50", "--json", "--diagnostics", *more]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **variables}
    ) as program:
        assert program.stderr is not None
        assert any("sending on" in line for line in program.stderr)  # and no error before
        try:
            yield program
        finally:
            program.kill()


def asked(bus: Sequence[str], variables: dict[str, str], *more: str) -> dict[str, Any]:
    told = subprocess.run(
        [sys.executable, "-m", "tests.support.uds.udsoncan_client", *bus, *more],
        check=False, capture_output=True, text=True, timeout=HANG_S, env={**os.environ, **variables},
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    found: dict[str, Any] = json.loads(told.stdout)
    return found


def udp_bus() -> Bus:
    place = free_bus()
    return ["-i", "udp_multicast", "-c", place.group], place.variables


def test_a_workshop_tester_asks_a_car_that_drives(tmp_path: Path) -> None:
    memory, bus = tmp_path / "tcu.json", udp_bus()
    with emulator(*bus, "--diagnostic-memory", str(memory)) as program:
        told = asked(*bus)
        program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=HANG_S)
    speed, gears, engine, fluid = told.pop("live").values()
    assert told == {
        "vin": "WDCTEMUL3TED00047",
        "supported": 25,
        "by mask": 0,
        "confirmed": [],
        "snapshots": 0,
        "extended data": 1,
        "locked": 0x7F,
        "session": 3,
        "no key": 0x33,
        "written": "CLUTCHSHOP",
        "while driving": [0x88, 0x88, 0x88, 0x22],
        "routine": 0x31,
        "default": 1,
    }
    assert speed > 100  # more than 1 km/h: the drive begins rolling
    assert all(1 <= gear <= 6 for gear in gears)
    assert 600 * 4 < engine < 7000 * 4
    assert 0 < fluid < 255
    assert program.returncode == 0, err
    assert json.loads(out)["foreign_frames"] == 0
    assert json.loads(memory.read_text(encoding="utf-8"))["kept"]["written"] == {
        str(0xF198): b64encode(b"CLUTCHSHOP").decode()
    }
