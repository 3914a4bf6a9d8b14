"""What ``decode`` writes is what cantools decodes: every cell of the Parquet files, for every database we have."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.decoding import comparison
from benchmarks.decoding.comparison import Tally, compare_database
from dbc.contract import DBC_PATH
from diag_service.mapping.profile import PROFILE_FOLDER
from tests.support.cantools_oracle import Readings, readings

DATA = Path(__file__).parents[1] / "data"
DATABASES = [
    DBC_PATH,
    *sorted(
        path for folder in (DATA, PROFILE_FOLDER) for path in folder.iterdir() if path.suffix in {".dbc", ".arxml"}
    ),
]
ODD = """VERSION ""
BU_: A
BO_ 256 Twin: 8 A
 SG_ Page M : 0|4@1+ (1,0) [0|15] "" A
 SG_ First m0 : 8|16@1- (0.5,0) [-10|10] "" A
 SG_ Second m1 : 8|16@1+ (1,-3) [0|0] "" A
 SG_ Lamp : 4|1@1+ (1,0) [0|1] "" A
 SG_ Real : 32|32@1- (1,0) [0|0] "" A
BO_ 257 Twin: 3 A
 SG_ Lamp : 7|9@0- (0.1,0) [0|3] "" A
BO_ 258 Pieces: 20 A
 SG_ Far : 80|16@1+ (1,0) [0|0] "" A
 SG_ Near : 0|8@1+ (1,0) [0|0] "" A
BO_ 259 Huge: 100 A
 SG_ Here : 0|8@1+ (1,0) [0|0] "" A
BO_ 260 Bad: 2 A
 SG_ Outside : 12|8@1+ (1,0) [0|0] "" A
 SG_ Flat : 0|8@1+ (0,5) [0|0] "" A
BO_ 2566844926 Group: 8 A
 SG_ Wide : 0|64@1+ (1,0) [0|0] "" A
BO_ 261 Empty: 8 A
VAL_ 256 Page 0 "Fault" 1 "No Fault" 15 "SNA" ;
VAL_ 256 Lamp 0 "Error present" 1 "kein_Fehler" ;
VAL_ 257 Lamp -1 "initializing" 3 "initializing" ;
VAL_ 256 First -1 "invalid" ;
VAL_ 256 Real 0 "off" ;
SIG_VALTYPE_ 256 Real : 1;
"""


@pytest.mark.parametrize("path", DATABASES, ids=lambda path: path.name)
def test_every_cell_is_that_of_cantools(path: Path) -> None:
    tally = compare_database(path, count=30, seed=3)
    assert tally.wrong == 0, tally.examples
    assert tally.values > 30
    assert not any(tally.null.values())


def odd(tmp_path: Path) -> Tally:
    """Return what is found in a database with everything that is odd."""
    (tmp_path / "odd.dbc").write_text(ODD, encoding="ascii")
    return compare_database(tmp_path / "odd.dbc", count=200, seed=4)


def test_what_is_missing_has_a_reason(tmp_path: Path) -> None:
    tally = odd(tmp_path)
    assert tally.wrong == 0, tally.examples
    assert {reason for reason, count in tally.null.items() if count} == {"refused", "transported"}
    assert sorted(tally.refusals) == [
        "Bad.Flat: scale 0 and offset 5 are not usable",
        "Bad.Outside lies outside its message",
    ]
    assert min(tally.values, tally.texts) > 200


@pytest.mark.parametrize("fault", ["number", "text", "presence"])
def test_the_comparison_finds_a_single_wrong_cell(tmp_path: Path, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(*arguments: object) -> dict[str, Readings]:
        found = readings(*arguments)  # type: ignore[arg-type]  # handed on as they are
        if (page := found.get("Page")) is not None:
            row = int(np.flatnonzero(page.is_there)[0])
            if fault == "number":
                page.number[row] += 16
            elif fault == "text":
                page.text[row] = "something else"
            else:
                page.is_there[row] = False
        return found

    monkeypatch.setattr(comparison, "readings", wrong)
    assert odd(tmp_path).wrong > 0
