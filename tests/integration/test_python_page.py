"""The Python of docs/python.md runs as it stands, block after block, and shows what there is; README.md's as well."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import diag_service
import ecu_emulator
from tests.support.documents import page_text
from tests.support.in_process import never_a_program

PAGE = "docs/python.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_blocks_of_the_page_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    blocks = BLOCK.findall(page_text(PAGE))
    assert len(blocks) >= 8
    with never_a_program():
        for number, block in enumerate(blocks, start=1):
            exec(compile(block, f"{PAGE}, block {number}", "exec"), names)  # noqa: S102 - what the page is for
        shutil.copy("recordings/drive.log", "drive.log")
        (of_the_readme,) = BLOCK.findall(page_text("README.md"))
        exec(compile(of_the_readme, "README.md", "exec"), {"__name__": "readme"})  # noqa: S102 - likewise
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
