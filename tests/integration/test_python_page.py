"""The Python of docs/python.md, canlog.md, prognosis.md and README.md runs as it stands, block after block."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest

import canlog
import diag_service
import ecu_emulator
from diag_service.diagnosis.prognosis import Prognosis
from tests.support.documents import page_text
from tests.support.histories import history
from tests.support.in_process import never_a_program

PAGE = "docs/python.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DATABASE = 'VERSION ""\nBU_: A\nBO_ 256 Engine: 2 A\n SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" A\n'
FRAMES = 100_000


def played(page: str, least: int, names: dict[str, object]) -> dict[str, object]:
    """Run the blocks of a page in their order, and return the names that they leave."""
    blocks = BLOCK.findall(page_text(page))
    assert len(blocks) >= least
    for number, block in enumerate(blocks, start=1):
        exec(compile(block, f"{page}, block {number}", "exec"), names)  # noqa: S102 - what the page is for
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
    assert page_text("docs/canlog.md").split("```python\n")[0].strip().count("\n") == 0  # it begins with lines of use
    names = played("docs/canlog.md", 3, {})
    assert names["highest"] == 0.25 * 0xFFFF
    table, wide, log = names["table"], names["wide"], names["log"]
    assert isinstance(table, pa.Table)
    assert isinstance(wide, pl.DataFrame)
    assert isinstance(log, canlog.Log)
    assert (table.num_rows, wide.height, log.path) == (FRAMES, FRAMES, Path("drive.log"))


def test_the_block_of_the_prognosis_runs() -> None:
    found = played("docs/prognosis.md", 1, {"results": history(60), "fills": ()})["found"]
    assert isinstance(found, Prognosis)
    assert found.change_fluid is not None


def test_a_block_that_starts_processes_is_a_file_that_they_can_import(drive_log: Path, tmp_path: Path) -> None:
    shutil.copy(drive_log, tmp_path / "drive.log")
    files = [block for block in BLOCK.findall(page_text(PAGE)) if "__main__" in block]
    assert files
    for number, block in enumerate(files):
        (tmp_path / f"file{number}.py").write_text(block, encoding="utf-8")
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
    pages = page_text(PAGE) + page_text("docs/testing.md") + page_text("docs/usage.md")
    records = {"ShiftEstimate", "Status", "Condition", "Scenario", "TruthLog", "read_truth", "CanlogError",
               "DiagServiceError", "EmulatorError", "PublishError", "ResultError", "ResultTable", "FolderAnalysis",
               "PaperAnalysis", "LiveDiagnosis", "Recording"}  # fmt: skip
    assert [name for name in names if name not in records and f"{name}" not in pages and name != "__version__"] == []
