"""What is left out of a database is told on every face, and the command that judges a folder of them is right."""

from pathlib import Path

import pytest

import canlog
import diag_service
from tests.support.in_process import ended as run
from tests.tools import databases

GOOD = """VERSION ""
BU_: A
BO_ 256 Gear: 8 A
 SG_ Target : 0|4@1+ (1,0) [0|15] "" A
 SG_ Torque : 8|10@1+ (1,-100) [0|0] "Nm" A
"""
ODD = (
    GOOD
    + """ SG_ Page m : 24|2@1+ (1,0) [0|3] "" A
 SG_ Oil m0 : 32|8@1+ (1,-40) [0|0] "degC" A
 SG_ Code m1 : 32|8@1+ (1,0) [0|0] "" A
BO_ 419361278 Brake: 8 A
 SG_ Pressure : 7|16@0+ (0.1,0) [0|0] "bar" A
BO_ 512 Engine: 8 A
 SG_ Speed : 0|16@1+ (.25,0) [0|0] "rpm" A
 SG_ Pedal : 16|8@1+ (0.4,0) [0|100] "%" A
"""
)
NOTICES = [
    "line 6: signal Page: its mark m is read as M",
    "line 9: message Brake: identifier 419361278 lacks the mark of 29 bits",
    "line 12: invalid syntax at column 23",
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of a log and two databases."""
    (tmp_path / "good.dbc").write_text(GOOD)
    (tmp_path / "odd.dbc").write_text(ODD)
    lines = (f"({n * 0.01:.6f}) can0 {('100', '200', '18FEF1FE')[n % 3]}#03C8000100AA0000" for n in range(300))
    (tmp_path / "drive.log").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.mark.parametrize("command", ["inspect", "signals", "decode"])
def test_each_command_tells_what_is_left_out(folder: Path, command: str) -> None:
    words = ("-o", folder / "drive.csv") if command == "decode" else ()
    ended = run(command, folder / "drive.log", "--dbc", folder / "odd.dbc", *words)
    assert ended.status == 0, ended.err
    assert all(notice in ended.err for notice in NOTICES), ended.err


def test_python_has_it_among_the_notices(folder: Path) -> None:
    (folder / "car.toml").write_text('[signals]\ntarget_gear = { message = "Gear", signal = "Target" }\n')
    analysis = diag_service.analyze(folder / "drive.log", dbc=folder / "odd.dbc", profile=folder / "car.toml")
    assert all(any(notice in text for text in analysis.notices) for notice in NOTICES), analysis.notices


def test_what_can_be_read_is_read(folder: Path) -> None:
    tables = canlog.read(folder / "drive.log", folder / "odd.dbc").to_arrow()
    rows = {name: table.slice(0, 1).to_pylist()[0] for name, table in tables.items()}
    assert (rows["Gear"]["Target"], rows["Gear"]["Torque"], rows["Gear"]["Page"]) == (3, 100, 1)
    assert (rows["Gear"]["Oil"], rows["Gear"]["Code"]) == (None, 0)
    assert rows["Brake"]["Pressure"] == pytest.approx(96.8)
    assert "Speed" not in rows["Engine"]
    assert rows["Engine"]["Pedal"] == 0


def test_the_databases_of_a_folder_are_judged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert databases.main([str(folder)]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[:3] for row in rows if not row.startswith(" ")] == [
        ["good.dbc", "ok", "1"],
        ["odd.dbc", "ok", "3"],
        ["2", "of", "2"],
    ]
    told = [row.strip() for row in rows if row.startswith(" ")]
    assert [row[: len(notice)] for row, notice in zip(told, NOTICES, strict=True)] == NOTICES
    (folder / "notes.dbc").write_text("Notes on the gearbox\n")
    assert databases.main([str(folder)]) == 1
    assert "notes.dbc is not a DBC file" in capsys.readouterr().out
