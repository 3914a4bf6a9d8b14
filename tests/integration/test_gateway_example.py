"""The worked example: its test passes with a sound gateway and fails, saying why, with each of its faults."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.integration.test_python_page import BLOCK
from tests.support.documents import ROOT, page_text
from tests.support.patience import HANG_S

EXAMPLE = ROOT / "examples" / "gateway"
PLUGINS = ("ecu_emulator.pytest_plugin", "diag_service.pytest_plugin")
# One interpreter for all runs, which saves most of their cost; the gateway itself is a process each time.
RUNS = """
import contextlib, io, json, os, sys
import pytest
told = {}
for fault in ("none", "drop", "alter", "swap"):
    os.environ["GATEWAY_FAULT"] = fault
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        tests = ["test_gateway.py", *(["test_page.py"] if fault == "none" else [])]
        status = pytest.main(["-p", "no:cacheprovider", "--tb=line", *sys.argv[1:], *tests])
    told[fault] = [int(status), out.getvalue()]
print(json.dumps(told))
"""


@pytest.fixture(name="told", scope="module")
def _told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("gateway") / "gateway"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    _, lossy = BLOCK.findall(page_text("docs/testing.md"))
    (folder / "test_page.py").write_text(lossy, encoding="utf-8")
    plugins = [word for plugin in PLUGINS for word in ("-p", plugin)]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", RUNS, *plugins, "--vcan-bus", "udp_multicast"],
        cwd=folder, capture_output=True, text=True, timeout=HANG_S, check=False,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": ""},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return told


def test_a_sound_gateway_passes_and_the_bus_is_said(told: dict[str, Any]) -> None:
    status, out = told["none"]
    assert status == 0, out
    assert "2 passed" in out
    assert "vcan_bus: multicast UDP 239.74.163.2:" in out
    assert "since it was asked for (and 2 more like it)" in out


@pytest.mark.parametrize(
    ("fault", "words"), [("drop", "did not come"), ("alter", " came as "), ("swap", "in the wrong order")]
)
def test_a_fault_in_the_gateway_fails_the_test(told: dict[str, Any], fault: str, words: str) -> None:
    status, out = told[fault]
    assert status == 1, out
    assert "1 failed" in out
    assert words in out


def test_the_page_shows_the_test_of_the_example() -> None:
    shown, _ = BLOCK.findall(page_text("docs/testing.md"))
    text = (EXAMPLE / "test_gateway.py").read_text(encoding="utf-8")
    body = shown.partition("def test_")[2].strip().replace("timeout_s=300", "timeout_s=PATIENCE_S")
    assert body in text


def test_the_readme_names_the_faults_that_there_are() -> None:
    text = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    for fault in ("drop", "alter", "swap"):
        assert f"GATEWAY_FAULT={fault} pytest" in text


def test_the_kinds_of_bus(tmp_path: Path) -> None:
    (tmp_path / "test_bus.py").write_text(
        "def test_bus(vcan_bus, make_vcan_bus, recorded_frames):\n"
        "    import can\n"
        "    heard = recorded_frames()\n"
        "    with vcan_bus.open() as near, can.Bus(**vcan_bus.can_options) as far:\n"
        "        near.send(can.Message(arbitration_id=5, is_extended_id=False))\n"
        "        assert far.recv(timeout=60).arbitration_id == 5\n"
        "    assert [one.arbitration_id for one in heard.wait_for(1, 60)] == [5]\n"
        "    assert make_vcan_bus() != vcan_bus\n",
        encoding="utf-8",
    )
    program = (
        "import pytest, sys\n"
        "print([int(pytest.main(['-q', '-p', 'no:cacheprovider', *sys.argv[1:], '--vcan-bus', kind]))"
        " for kind in ('auto', 'udp_multicast', 'virtual')])"
    )
    plugins = [word for plugin in PLUGINS for word in ("-p", plugin)]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *plugins],
        cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, check=False,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": ""},
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "[0, 0, 0]", done.stdout + done.stderr
    assert "vcan_bus: virtual, since it was asked for (and 1 more like it)" in done.stdout
