"""How far a reading is: on a terminal only, not before somebody may ask, and gone when something else is told."""

import io
from pathlib import Path

from canlog.logs import LogReader, read_log
from diag_service.console.terminal import ReadingLine, reading_text

LINES = "".join(f"({1767225600 + number}.000000) can0 100#00\n" for number in range(90_000))


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def watched(path: Path, stream: io.StringIO, now_s: list[float]) -> tuple[LogReader, ReadingLine]:
    path.write_text(LINES, encoding="ascii")
    line = ReadingLine(stream, now_s=lambda: now_s[0])
    return read_log(path, watch=line.watch), line


def test_a_terminal_sees_the_share_from_the_third_second_on(tmp_path: Path) -> None:
    terminal, now_s = Terminal(), [0.0]
    reader, line = watched(tmp_path / "drive.log", terminal, now_s)
    next(reader)
    assert terminal.getvalue() == ""
    now_s[0] = 2.0
    next(reader)
    assert f"reading {str(reader.name)[-10:]}" in terminal.getvalue() or "reading ..." in terminal.getvalue()
    assert "%, " in terminal.getvalue()
    line.report("a shift")
    assert terminal.getvalue().endswith("\r\x1b[K")
    told = len(terminal.getvalue())
    assert not list(reader)  # the end
    assert len(terminal.getvalue()) == told


def test_a_text_is_told_from_the_third_second_on_and_not_too_often() -> None:
    terminal, now_s = Terminal(), [0.0]
    line = ReadingLine(terminal, now_s=lambda: now_s[0])
    for now_s[0] in (0.0, 1.9, 2.0, 2.1, 2.3):
        line.tell(f"at {now_s[0]}")
    assert terminal.getvalue() == "\r\x1b[Kat 2.0\r\x1b[Kat 2.3"


def test_a_pipe_sees_nothing(tmp_path: Path) -> None:
    pipe = io.StringIO()
    reader, line = watched(tmp_path / "drive.log", pipe, [100.0])
    with line:
        line.show("calibrating")
        assert sum(len(batch) for batch in reader) == 90_000
    assert pipe.getvalue() == ""


def test_what_has_no_size_tells_its_frames(tmp_path: Path) -> None:
    reader, _ = watched(tmp_path / ("a" * 60 + ".log"), io.StringIO(), [0.0])
    next(reader)
    text = reading_text(reader)
    reader.close()
    assert text.startswith("reading ...")
    assert text.endswith(f" %, {reader.counts.frames} frames")
