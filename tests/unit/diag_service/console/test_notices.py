"""Standard error: one line per message, with the program's name; libraries only when asked for."""

import logging
from collections.abc import Iterator

import pytest

from canlog.errors import NOTICE
from diag_service.console import set_up_notices


@pytest.fixture(autouse=True)
def _restored_logging() -> Iterator[None]:
    loggers = (logging.getLogger(), logging.getLogger("diag_service"))
    before = [(logger, logger.handlers, logger.level, logger.propagate) for logger in loggers]
    yield
    for logger, handlers, level, propagate in before:
        logger.handlers, logger.propagate = handlers, propagate
        logger.setLevel(level)


@pytest.mark.parametrize(
    ("verbosity", "lines"),
    [
        (0, ["diag-service: warning: late", "diag-service: 7 frames"]),
        (1, ["diag-service: warning: late", "diag-service: 7 frames", "diag-service: detail"]),
        (
            2,
            ["diag-service: warning: late", "diag-service: 7 frames", "diag-service: detail", "diag-service: error: x"],
        ),
    ],
)
def test_what_is_shown(verbosity: int, lines: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    set_up_notices(verbosity)
    own = logging.getLogger("diag_service.service.live")
    own.warning("late")
    own.log(NOTICE, "%d frames", 7)
    own.info("detail")
    logging.getLogger("mqtt").error("x")
    assert capsys.readouterr().err.splitlines() == lines
