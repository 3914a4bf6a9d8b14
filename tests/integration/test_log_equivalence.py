"""The same drive in every format that is written: the same shifts, estimates and verdicts, to the bit."""

from pathlib import Path

import pytest

from diag_service.records import Status
from diag_service.sources import read_log
from ecu_emulator.record import open_log
from tests.chain import Outcome, diagnosed
from tests.damage import SUFFIXES, short_drive


def outcome(path: Path) -> Outcome:
    with open_log(path) as log:
        log.write(short_drive())
    return diagnosed(read_log(path))


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return outcome(tmp_path_factory.mktemp("candump") / "drive.log")


def test_the_drive_is_worth_comparing(expected: Outcome) -> None:
    assert [diagnosis.estimate.status for diagnosis in expected.diagnoses] == [Status.VALID] * 3


# All times are whole microseconds, and every one of these formats keeps those.
@pytest.mark.parametrize("log_format", [name for name in SUFFIXES if name != "candump"])
def test_every_format_gives_the_same_results(log_format: str, expected: Outcome, tmp_path: Path) -> None:
    found = outcome(tmp_path / f"drive{SUFFIXES[log_format]}")
    assert found.fingerprint == expected.fingerprint
    assert found.counts == expected.counts
