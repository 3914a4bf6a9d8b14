"""Dialects: what stands between cells, what quotes them, what is a remark, and in which encoding lines are."""

import pytest

from canlog.logs.signal_tables.dialect import dialect_of, is_comment, lines_in

LINES: dict[str, tuple[list[str], str, str, list[str]]] = {
    "commas": (["Time,A"] + ["1,2"] * 4, "commas in 5 of 5 lines", "1,2", ["1", "2"]),
    "semicolons beside decimal commas": (["Zeit;A"] + ["1,5;2,5"] * 4, "semicolons in 5 of 5", "1,5;2", ["1,5", "2"]),
    "tabs": (["Time\tA, B"] + ["1\t2"] * 4, "tabs in 5 of 5", "1\t2", ["1", "2"]),
    "bars": (["Time|A"] + ["1|2"] * 4, "bars in 5 of 5", "1|2", ["1", "2"]),
    "a preamble": (["Recorder 1, 2"] + ["1;2"] * 4, "semicolons in 4 of 5", "1;2", ["1", "2"]),
    "quotes": (['"Time","A, B"'] + ["1,2"] * 4, "commas in 5 of 5", '"1","2, 3"', ["1", "2, 3"]),
    "single quotes": (["'Time','A'"] + ["'1','2'"] * 4, "commas in 5 of 5", "'1','2, 3'", ["1", "2, 3"]),
    "lines quoted as a whole": (['"Time,A"'] + ['"1,2"'] * 4, "commas in 5 of 5", '"1,2"', ["1", "2"]),
    "blanks": (["Time A"] + ["1 2.5"] * 4, "blanks in 5 of 5", "1  2.5", ["1", "2.5"]),
    "columns of blanks": (["Time   Oil temp"] + ["1    2.5"] * 4, "columns of blanks in 5", "1    a b", ["1", "a b"]),
    "prose": (["This is a text", "of words, alone"] * 3, "commas in 3 of 6", "a, b", ["a", " b"]),
}


@pytest.mark.parametrize("name", LINES)
def test_what_separates_cells_is_told_by_most_lines(name: str) -> None:
    lines, why, line, cells = LINES[name]
    dialect = dialect_of(lines)
    assert dialect.why.startswith(why)
    assert dialect.cells(line) == cells


@pytest.mark.parametrize(
    ("cell", "is_remark"),
    [
        ("# mark", True),
        (" // pause", True),
        ("%", True),
        ("#N/A", False),
        ("#DIV/0!", False),
        ("-1", False),
        ("", False),
    ],
)
def test_a_fault_of_a_spreadsheet_is_no_remark(cell: str, *, is_remark: bool) -> None:
    assert is_comment([cell, "2"]) is is_remark


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_lines_are_in_utf_8_or_the_code_page_of_windows(encoding: str) -> None:
    assert lines_in("Öl [°C]\r\n80\r\n".encode(encoding)) == ["Öl [°C]", "80"]
