"""Tables for terminals: what is wrapped, what is left out, and when records become blocks."""

from fleet_backend.layout import Sheet, lines_of, plain

ROW = ("WVWZZZ1JZ3W386752", "2", "change fluid", "+2.10 ±0.60", "1234")
SHEET = Sheet(
    title="Fleet",
    columns=("vehicle", "clutch", "condition", "slope", "km"),
    rows=[ROW],
    dispensable=("km",),
    remarks=[("WVWZZZ1JZ3W386752, clutch 2", "slope negative")],
    styles={"change fluid": "bold red"},
)


def shown(width: int | None) -> list[str]:
    return [line.plain for line in lines_of(SHEET, width)]


def test_where_there_is_room_nothing_is_wrapped() -> None:
    assert shown(80) == [
        "Fleet",
        "vehicle            clutch  condition     slope        km",
        "─" * 58,
        "WVWZZZ1JZ3W386752  2       change fluid  +2.10 ±0.60  1234",
        "WVWZZZ1JZ3W386752, clutch 2: slope negative",
    ]


def test_in_the_end_a_record_is_a_block() -> None:
    assert shown(30)[1:] == [
        "",
        "vehicle    WVWZZZ1JZ3W386752",
        "clutch     2",
        "condition  change fluid",
        "slope      +2.10 ±0.60",
        "km         1234",
        "reason     slope negative",
    ]


def test_what_a_terminal_would_act_on_is_shown_instead() -> None:
    assert plain("a\x1b[31m\tb\n c\udc80\u200b") == "a\\x1b[31m b c\\udc80\\u200b"
