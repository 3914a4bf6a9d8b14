"""The Python of docs/canlog.md runs as it stands; a log that is read batch by batch is the table, and keeps nothing."""

import re
from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest

import canlog
from tests.support.documents import page_text

PAGE = "docs/canlog.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DATABASE = 'VERSION ""\nBU_: A\nBO_ 256 Engine: 2 A\n SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" A\n'
FLAGS = "".join(f' SG_ Flag{k} : {k}|1@1+ (1,0) [0|1] "" A\n' for k in range(16))  # sixteen values in a frame
FRAMES = 100_000
HIGHEST = 0.25 * 0xFFFF


@pytest.fixture(name="drive")
def _drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "car.dbc").write_text(DATABASE, encoding="ascii")
    lines = (
        f"({1 + number / 1000:.6f}) can0 100#{number & 0xFF:02X}{number >> 8 & 0xFF:02X}\n" for number in range(FRAMES)
    )
    (tmp_path / "drive.log").write_text("".join(lines), encoding="ascii")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "drive.log"


def test_the_page_runs_as_it_stands(drive: Path) -> None:
    names: dict[str, object] = {}
    blocks = BLOCK.findall(page_text(PAGE))
    assert page_text(PAGE).split("```python\n")[0].strip().count("\n") == 0  # it begins with the lines of use
    assert len(blocks) == 3
    for number, block in enumerate(blocks, start=1):
        exec(compile(block, f"{PAGE}, block {number}", "exec"), names)  # noqa: S102 - what the page is for
    assert names["highest"] == HIGHEST
    table, wide = names["table"], names["wide"]
    assert isinstance(table, pa.Table)
    assert isinstance(wide, pl.DataFrame)
    assert table.num_rows == wide.height == FRAMES
    log = names["log"]
    assert isinstance(log, canlog.Log)
    assert log.path == Path(drive.name)
