"""An error is one line and a status, whatever its text is."""

import pytest

from clutchdiag_io.program import complain

STATUSES = (((FileNotFoundError, KeyError), 2), (OSError, 3))


@pytest.mark.parametrize(
    ("exc", "status", "line"),
    [
        (FileNotFoundError("no log"), 2, "no log"),
        (PermissionError("not\n  for\tyou"), 3, "not for you"),
        (OSError("log\udce9.log"), 3, "log\\xe9.log"),
        (RuntimeError("wires\ncrossed"), 1, "unexpected RuntimeError: wires crossed (ask)"),
    ],
)
def test_an_error_is_one_line_and_a_status(
    exc: Exception, status: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert complain("oracle", exc, STATUSES, hint=" (ask)") == status
    assert capsys.readouterr() == ("", f"oracle: error: {line}\n")
