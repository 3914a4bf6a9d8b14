"""The emulator with its ELM327 adapter, and a scan tool that is not ours, as processes."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.patience import HANG_S
from workshop.controller.controller import MemoryFile
from workshop.controller.memory import TestResult
from workshop.controller.table import shipped_table
from workshop_tests.controller.bench import Bench


def confirmed(path: Path, code: str) -> None:
    """Leave a memory with a confirmed code."""
    bench = Bench(table=shipped_table())
    bench.monitor(code, TestResult.FAILED)
    with MemoryFile(path, bench.table) as store:
        store.save(bench.state)


def test_a_scan_tool_asks_a_car_that_drives(tmp_path: Path) -> None:
    memory = tmp_path / "tcu.json"
    confirmed(memory, "P2787")
    words = [sys.executable, "-m", "ecu_emulator", "run", "-i", "virtual", "-c", "obd", "--cycles", "50", "--json"]
    words += ["--diagnostics", "--diagnostic-memory", str(memory), "--elm327", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        try:
            said = next(line for line in program.stderr if "ELM327" in line)
            place = re.fullmatch(r"ELM327 adapter at 127\.0\.0\.1:(\d+)\n", said)
            assert place is not None, said
            told = asked(place[1])
            program.send_signal(signal.SIGINT)
            out, err = program.communicate(timeout=HANG_S)
        finally:
            program.kill()
    values = told.pop("values")
    supported = told.pop("supported")
    assert 600 < told.pop("page_rpm") < 7000
    assert {"RPM", "SPEED", "STATUS", "PIDS_A", "PIDS_B", "PIDS_C", "DISTANCE_SINCE_DTC_CLEAR"} <= set(supported)
    assert told == {
        "state": "Car Connected",
        "protocol": "ISO 15765-4 (CAN 11/500)",
        "lamp": True,
        "count": 1,
        "confirmed": ["P2787"],
        "pending": ["P2787"],
        "vin": "WDCTEMUL3TED00047",
        "calibration": "DCTCAL-0100",
        "clear": None,  # it drives
    }
    assert 600 < values["RPM"] < 7000
    assert 0 < values["SPEED"] < 250
    assert values["COOLANT_TEMP"] == pytest.approx(90, abs=40)
    assert all(value is not None for value in values.values())
    assert program.returncode == 0, err
    counts = json.loads(out)["diagnostics"]["elm327"]
    assert (counts["clients"], counts["refused_clients"], counts["overlong_lines"]) == (
        2,
        0,
        0,
    )  # its own and the one of the page
    assert counts["lines"] > 20


def asked(port: str) -> dict[str, Any]:
    told = subprocess.run(
        [sys.executable, "-m", "tests.support.uds.python_obd_client", port],
        check=False, capture_output=True, text=True, timeout=HANG_S,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    found: dict[str, Any] = json.loads(told.stdout)
    return found
