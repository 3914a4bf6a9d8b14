"""Every file that ``decode`` writes of random databases is read by two libraries and says what cantools says."""

from pathlib import Path

import pytest

from tests.support.decode_outputs import compare, random_case

CASES_EACH = 4


@pytest.mark.parametrize("first", range(1, 17, CASES_EACH))
def test_every_output_is_read_by_two_libraries_and_equal_to_cantools(tmp_path: Path, first: int) -> None:
    for number in range(first, first + CASES_EACH):
        folder = tmp_path / str(number)
        folder.mkdir()
        findings = compare(random_case(number), folder)
        assert findings.wrong == [], f"case {number}"
        assert findings.cells
