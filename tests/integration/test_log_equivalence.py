"""The same drive in every format that is written: the same shifts, estimates and verdicts, to the bit."""

from pathlib import Path

import pytest

from canlog.logs import read_log
from diag_service.diagnosis.records import Status
from tests.support.chain import Outcome, diagnosed
from tests.tools.damage.recordings import SUFFIXES, WRITERS, short_drive


def outcome(log_format: str, folder: Path) -> Outcome:
    path = folder / f"drive{SUFFIXES[log_format]}"
    WRITERS[log_format](path, short_drive())
    return diagnosed(read_log(path))


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return outcome("candump", tmp_path_factory.mktemp("candump"))


def test_the_drive_is_worth_comparing(expected: Outcome) -> None:
    assert [diagnosis.estimate.status for diagnosis in expected.diagnoses] == [Status.VALID] * 3


# All times are whole milliseconds, and every one of these formats keeps those.
@pytest.mark.parametrize("log_format", [name for name in SUFFIXES if name != "candump"])
def test_every_format_gives_the_same_results(log_format: str, expected: Outcome, tmp_path: Path) -> None:
    found = outcome(log_format, tmp_path)
    assert found.fingerprint == expected.fingerprint
    assert found.counts == expected.counts
