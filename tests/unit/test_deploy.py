"""The shipped systemd unit starts the service as it is: every option exists, and what the unit promises is done."""

from pathlib import Path

import pytest

from diag_service import cli
from diag_service.commands.options import PROGRAM
from diag_service.service.snapshot import STALE_S

UNIT = Path(__file__).parents[2] / "docs" / "deploy" / "clutchdiag.service"


def settings() -> dict[str, str]:
    """Return the unit's settings; of one given twice the last."""
    lines = (line.partition("=") for line in UNIT.read_text(encoding="utf-8").splitlines() if line[:1].isalpha())
    return {key: value for key, _, value in lines}


def test_every_option_is_one_of_the_service(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "--help"]) == 0
    known = capsys.readouterr().out
    program, command, *words = settings()["ExecStart"].split()
    assert (Path(program).name, command) == (PROGRAM, "run")
    options = [word for word in words if word.startswith("-")]
    assert options
    assert [option for option in options if f"{option} " not in known and f"{option}\n" not in known] == []


def test_the_watchdog_waits_longer_than_a_service_may_be_silent() -> None:
    assert settings()["Type"] == "notify"
    assert float(settings()["WatchdogSec"]) > STALE_S
