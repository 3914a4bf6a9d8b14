"""Tables at any width: no word is broken, no row loses whom it is about, and a pipe gets a line per record."""

import re

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from fleet_backend.report import Sheet, lines_of

WORD = st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="─"), min_size=1, max_size=30)
TEXT = st.lists(WORD, min_size=1, max_size=6).map(" ".join)
COLUMNS = ("vehicle", "state", "what was said", "by")
SHEETS = st.builds(
    lambda rows, told: Sheet(
        title="all of them",
        columns=COLUMNS,
        rows=rows,
        dispensable=("by", "state"),
        remarks=[(row[0], text) for row, text in zip(rows, told, strict=False)] if len(told) >= len(rows) else None,
    ),
    st.lists(st.tuples(WORD, TEXT, TEXT, TEXT), max_size=5),
    st.lists(TEXT, max_size=5),
)


def words_of(text: str) -> set[str]:
    return set(text.split())


@given(sheet=SHEETS, width=st.integers(1, 200))
def test_no_word_is_broken_and_no_vehicle_lost(sheet: Sheet, width: int) -> None:
    lines = [line.plain for line in lines_of(sheet, width)]
    cells = {text for row in sheet.rows for text in row}
    remarks = {f"{whom}: {text}" for whom, text in sheet.remarks or ()}
    known = {word for text in {*cells, *remarks, sheet.title, *sheet.columns, "reason"} for word in words_of(text)}
    known |= {word for _, text in sheet.remarks or () for word in words_of(text)}
    known |= words_of("Hidden at this width: by, by. state. A wider terminal, a pipe or --json shows all.")
    shown = {word for line in lines if line.strip("─") for word in words_of(line)}
    assert shown <= known
    assert {row[0] for row in sheet.rows} <= shown
    too_long = [line for line in lines if cell_len(line) > width]
    assert all(len(line.split()) == 1 or re.fullmatch(r"\S.{0,12}?  +\S+", line) for line in too_long)


@given(sheet=SHEETS)
def test_a_pipe_gets_a_line_per_record_with_columns_two_spaces_apart(sheet: Sheet) -> None:
    _title, head, *lines = [line.plain for line in lines_of(sheet, None)]
    remarks = [text for _, text in sheet.remarks or ()]
    expected = [[*row, *remarks[index : index + 1]] for index, row in enumerate(sheet.rows)]
    assert [re.split(" {2,}", line) for line in lines] == expected
    assert re.split(" {2,}", head) == [*COLUMNS, *(["reason"] if sheet.remarks is not None else [])]
