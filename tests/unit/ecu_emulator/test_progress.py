import io

from rich.console import Console

from ecu_emulator.progress import ProgressLine

HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"


def console(*, is_terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=is_terminal, width=200, highlight=False)


def written(to: Console) -> str:
    assert isinstance(to.file, io.StringIO)
    return to.file.getvalue()


def test_a_log_gets_a_line_every_ten_seconds() -> None:
    to = console(is_terminal=False)
    with ProgressLine(to, "preparing") as progress:
        for at_s in range(35):
            progress.update(f"[{at_s} s]", float(at_s))
    assert written(to).splitlines() == ["[10 s]", "[20 s]", "[30 s]"]


def test_a_terminal_shows_the_latest_text_and_is_tidied_up() -> None:
    to = console(is_terminal=True)
    with ProgressLine(to, "preparing") as progress:
        progress.update("driving", 1.0)
    shown = written(to)
    assert "driving" in shown
    assert shown.index(HIDE_CURSOR) < shown.index(SHOW_CURSOR)
