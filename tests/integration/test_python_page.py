"""The Python that README.md and pages of docs/ show runs as it stands, and files that they show are read.

Blocks for odxtools (docs/sovd.md) and python-OBD (docs/controller.md) are run where those libraries are:
tests/integration/test_sovd.py, tests/e2e/test_obd.py.
"""

import asyncio
import re
import runpy
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pytest
from udsoncan.configs import default_client_config

import canlog
import diag_service
import ecu_emulator
from clutch_results.prognosis import Prognosis
from diag_service.delivery import Outbox
from diag_service.mapping.profile import load_profile
from diag_service.store import ResultStore
from fleet_contract import Channel, read_message
from tests.integration.test_tester import vehicle
from tests.support.builders import shift_result
from tests.support.documents import ROOT, page_text
from tests.support.doip.tester import entity
from tests.support.histories import history
from tests.support.in_process import never_a_program
from tests.support.outboxes import STATE
from tests.support.patience import HANG_S
from tests.support.uds.wire import parked_controller
from workshop.controller.memory import TestResult as Result
from workshop.tester.description import load_file

PAGE, DIAGNOSTICS = "docs/python.md", "docs/controller.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DATABASE = 'VERSION ""\nBU_: A\nBO_ 256 Engine: 2 A\n SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" A\n'
FRAMES = 100_000
TOO_HOT = 0x27874B  # P2787, confirmed in one cycle
NO_PRESSURE = 0x084164  # P0841, confirmed in two: pending after the first


def block(page: str, word: str, language: str = "python") -> str:
    """Return the block of a page that holds a word."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^\1```", page_text(page), re.MULTILINE | re.DOTALL)
    (text,) = (text for _, text in found if word in text)
    return textwrap.dedent(text)


def moved(page: str, word: str, places: Mapping[str, str]) -> str:
    """Return the block of a page that holds a word, with other places than those of the page."""
    text = block(page, word)
    for old, new in places.items():
        assert old in text
        text = text.replace(old, new)
    return text


def run(text: str, names: dict[str, Any]) -> None:
    exec(compile(text, "a page", "exec"), names)  # noqa: S102 - what the pages are for


def played(page: str, least: int, names: dict[str, object]) -> dict[str, object]:
    """Run the blocks of a page in their order, and return the names that they leave."""
    blocks = BLOCK.findall(page_text(page))
    assert len(blocks) >= least
    for text in blocks:
        run(text, names)
    return names


def test_the_blocks_of_the_page_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with never_a_program():
        names = played(PAGE, 8, {"__name__": "__main__"})
        shutil.copy("recordings/drive.log", "drive.log")
        played("README.md", 1, {"__name__": "readme"})
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("10 shifts, ")
    assert "no such file.log" in out
    folders = names["folders"]
    assert isinstance(folders, diag_service.FolderAnalysis)
    assert list(folders.left_out) == ["recordings/notes.txt"]
    assert folders.unread == {}
    assert [list(drive.shifts) for drive in folders.drives] == [list(folders.shifts)]
    analysis = names["alone"]
    assert isinstance(analysis, diag_service.Analysis)
    assert analysis.to_json() == folders.drives[0].to_json()
    for made in ("drive.svg", "results.jsonl", "car1.toml", "recordings/drive.log"):
        assert (tmp_path / made).is_file(), made
    assert (tmp_path / "drive.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_the_page_of_the_library_runs_on_any_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("car.dbc").write_text(DATABASE, encoding="ascii")
    lines = (f"({1 + n / 1000:.6f}) can0 100#{n & 0xFF:02X}{n >> 8 & 0xFF:02X}\n" for n in range(FRAMES))
    Path("drive.log").write_text("".join(lines), encoding="ascii")
    names = played("docs/logs.md", 3, {})
    assert names["highest"] == 0.25 * 0xFFFF
    table, wide, log = names["table"], names["wide"], names["log"]
    assert isinstance(table, pa.Table)
    assert isinstance(wide, pl.DataFrame)
    assert isinstance(log, canlog.Log)
    assert (table.num_rows, wide.height, log.path) == (FRAMES, FRAMES, Path("drive.log"))


def test_the_block_of_the_prognosis_runs() -> None:
    found = played("docs/verdict.md", 1, {"results": history(60), "fills": ()})["found"]
    assert isinstance(found, Prognosis)
    assert found.change_fluid is not None


def test_a_block_that_starts_processes_is_a_file_that_they_can_import(drive_log: Path, tmp_path: Path) -> None:
    shutil.copy(drive_log, tmp_path / "drive.log")
    files = [text for text in BLOCK.findall(page_text(PAGE)) if "__main__" in text]
    assert files
    for number, text in enumerate(files):
        (tmp_path / f"file{number}.py").write_text(text, encoding="utf-8")
        command = [sys.executable, f"file{number}.py"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("package", [diag_service, ecu_emulator])
def test_every_public_name_is_documented(package: object) -> None:
    names: list[str] = vars(package)["__all__"]
    undocumented = [
        name for name in names if name != "__version__" and len((getattr(package, name).__doc__ or "").split()) < 4
    ]
    assert undocumented == []
    pages = page_text(PAGE) + page_text("docs/usage.md")
    records = {"ShiftEstimate", "Status", "Condition", "Scenario", "TruthLog", "read_truth", "CanlogError",
               "DiagServiceError", "EmulatorError", "PublishError", "ResultError", "ResultTable", "FolderAnalysis",
               "PaperAnalysis", "LiveDiagnosis", "Recording"}  # fmt: skip
    assert [name for name in names if name not in records and f"{name}" not in pages and name != "__version__"] == []


async def test_the_link_takes_what_the_outbox_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with closing(ResultStore.in_memory()) as store:
        for seq in (1, 2):
            store.add(shift_result(seq), STATE)
        outbox = Outbox(
            store, "car1", runpy.run_path(str(ROOT / "examples" / "spool_link.py"))["connect"], "spool.jsonl"
        )
        sender = asyncio.create_task(outbox.run())
        assert await outbox.close(sender) == 0
        assert store.unpublished_count("car1") == 0
    lines = (tmp_path / "spool.jsonl").read_bytes().splitlines()
    messages = [read_message(topic.decode(), payload) for topic, _, payload in (line.partition(b" ") for line in lines)]
    assert [one.data["seq"] for one in messages if one.address.channel is Channel.SHIFT] == [1, 2]


@pytest.fixture(name="patient")
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the library wait for a busy machine."""
    for name, value in {"request_timeout": HANG_S, "p2_timeout": HANG_S, "use_server_timing": False}.items():
        monkeypatch.setitem(default_client_config, name, value)


@pytest.mark.usefixtures("patient")
def test_a_tester_on_the_bus(capsys: pytest.CaptureFixture[str]) -> None:
    controller = parked_controller()
    for _ in range(20):
        for number in (TOO_HOT, NO_PRESSURE):
            controller.report(number, Result.FAILED)
    with vehicle("page", controller):
        run(
            moved(DIAGNOSTICS, "PythonIsoTpConnection", {"vcan0": "page", "socketcan": "virtual"}), {"__name__": "page"}
        )
    said = capsys.readouterr().out
    assert "WDCTEMUL3TED00047" in said
    assert all(f"0x{number:06x}" in said.lower() for number in (TOO_HOT, NO_PRESSURE))


@pytest.mark.usefixtures("patient")
def test_a_tester_over_ip() -> None:
    with entity() as (_, server):
        ports = f"tcp_port={server.place.port}, udp_port={server.place.port}"
        run(moved(DIAGNOSTICS, "doipclient", {"0x1011)": f"0x1011, {ports})"}), {})
        assert server.counts["requests"] == 1


def test_a_description_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "gearbox.toml"
    path.write_text(block("docs/own-car.md", 'name = "gearbox"', "toml"), encoding="utf-8")
    described = load_file(path).description
    assert (described.name, described.request_id, described.response_id) == ("gearbox", 0x7E1, 0x7E9)
    values = described.values(described.find_data("oil"), bytes.fromhex("04 B0 01") + b"A7")
    assert values == {"temperature [degC]": 80.0, "state": "warm", "batch": "A7"}
    assert described.trouble_text(0x02184B) == "Transmission Fluid Over Temperature Condition"


def test_asked_signals_of_a_profile_are_read_as_shown(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(block("docs/own-car.md", "did = ", "toml"), encoding="utf-8")
    profile = load_profile(path)
    (asked,) = profile.asked.values()
    assert (asked.number, asked.request_id, asked.is_signed) == (0x38EB, 0x7E1, True)
    assert {signal.value for signal in profile.sources} == {"clutch1_pressure_pa", "engine_speed_rad_s"}
