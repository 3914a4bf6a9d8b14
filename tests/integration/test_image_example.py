"""The worked example, outside the checkout with the wheel alone and what its users have: pytest.

Its test passes with a sound gateway and fails, saying why, with each of its faults. The environment is that of the
image (tests/plugins/image.py), to which pytest is added.
"""

import json
import shutil
from pathlib import Path
from typing import Any

from tests.integration.test_python_page import BLOCK
from tests.support.documents import ROOT, page_text
from tests.support.image.plain import PlainImage
from tests.support.plain_install import distributions_of, linked
from tests.support.starvation import AHEAD

EXAMPLE = ROOT / "examples" / "gateway"
# One interpreter for all runs, which saves most of their cost; the gateway itself is a process each time.
RUNS = """
import contextlib, io, json, os, sys
from clutchdiag_io.program import choose_kernel_cache
choose_kernel_cache()  # what the image has compiled
sys.modules.setdefault("asammdf", None)  # python-can loads it where it is installed, and that pandas
import pytest
quick = "test_gateway.py::test_every_frame_comes_out_as_it_went_in"
virtual = ["--vcan-bus", "virtual"]  # frames have the times of the car there, whatever else the machine does
runs = {
    "none": ["test_gateway.py", "test_page.py", *virtual],
    "alter": [quick, *virtual],
    "swap": [quick, *virtual],
    "process": [quick, "--vcan-bus", "udp_multicast"],
    "drop": [quick, *virtual],
}
kinds = {kind: ["test_bus.py", "--vcan-bus", kind] for kind in ("auto", "udp_multicast", "virtual")}
told = {}
for name, words in {**runs, **kinds}.items():
    os.environ["GATEWAY_FAULT"] = name if name in ("alter", "swap", "drop") else "none"
    for module in ("conftest", "gateway", "test_gateway"):
        sys.modules.pop(module, None)
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = pytest.main([*sys.argv[1:], "--tb=line", *words])
    told[name] = [int(status), out.getvalue()]
import canlog, diag_service, ecu_emulator
told["homes"] = [one.__file__ for one in (canlog, diag_service, ecu_emulator)]
print(json.dumps(told))
"""
FAULTS = {"drop": "did not come", "alter": " came as ", "swap": "in the wrong order"}
ANY_BUS = """
import can
def test_bus(vcan_bus, make_vcan_bus, recorded_frames):
    heard = recorded_frames()
    with vcan_bus.open() as near, can.Bus(**vcan_bus.can_options) as far:
        near.send(can.Message(arbitration_id=5, is_extended_id=False))
        assert far.recv(timeout=300).arbitration_id == 5
    assert [one.arbitration_id for one in heard.wait_for(1, 300)] == [5]
    assert make_vcan_bus() != vcan_bus
"""


def shown_tests() -> list[str]:
    """Return the tests that docs/python.md shows."""
    return [text for text in BLOCK.findall(page_text("docs/python.md")) if "def test_" in text]


def runs_of_the_example(image: PlainImage, tmp_path: Path) -> dict[str, Any]:
    """Return status and output of each run of RUNS."""
    folder = tmp_path / "gateway"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    _, lossy = shown_tests()
    (folder / "test_page.py").write_text(lossy, encoding="utf-8")
    (folder / "test_bus.py").write_text(ANY_BUS, encoding="utf-8")
    tools = linked(folder.with_name("tools"), distributions_of(["pytest"]))
    done = image.run(
        *AHEAD, "python", "-W", "error", "-c", RUNS, "-p", "no:cacheprovider",
        "--assert=plain",  # rewriting our packages, as pytest does with plugins, takes seconds
        folder=folder, PYTHONPATH=str(tools), PYTEST_ADDOPTS="",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return told


def test_it_passes_with_a_sound_gateway_and_fails_with_each_fault_on_every_kind_of_bus(
    image: PlainImage, tmp_path: Path
) -> None:
    told = runs_of_the_example(image, tmp_path)
    assert [home for home in told["homes"] if not Path(home).is_relative_to(image.root)] == []
    status, out = told["none"]
    assert status == 0, out
    assert "3 passed" in out
    assert "vcan_bus: virtual, since it was asked for (and 4 more like it)" in out
    status, out = told["process"]
    assert status == 0, out
    assert "1 passed" in out
    assert "vcan_bus: multicast UDP 239.74.163.2:" in out
    for fault, words in FAULTS.items():
        status, out = told[fault]
        assert status == 1, out
        assert "1 failed" in out
        assert " passed" not in out
        assert words in out
    for kind in ("auto", "udp_multicast", "virtual"):
        status, out = told[kind]
        assert status == 0, out
        assert "vcan_bus: " in out
        assert kind != "virtual" or "vcan_bus: virtual, since it was asked for (and 1 more like it)" in out


def test_the_page_shows_the_test_of_the_example() -> None:
    shown, _ = shown_tests()
    text = (EXAMPLE / "test_gateway.py").read_text(encoding="utf-8")
    body = shown.partition("def test_")[2].strip().replace("timeout_s=300", "timeout_s=PATIENCE_S")
    assert body in text


def test_the_readme_names_the_faults_that_there_are() -> None:
    text = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    for fault in FAULTS:
        assert f"GATEWAY_FAULT={fault} pytest" in text
