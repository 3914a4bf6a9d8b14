"""A stored set of recordings, of all fluids, with faults, of foreign vehicles: what was said of them is said again."""

from pathlib import Path

import pytest

from tests.golden import analyses


def is_exact() -> bool:
    return analyses.ARITHMETIC.read_text(encoding="utf-8").strip() == analyses.arithmetic()


@pytest.mark.parametrize("name", analyses.NAMES)
def test_an_analysis_stays_what_it_was(name: str) -> None:
    before = (analyses.ANALYSES / f"{name}.jsonl").read_text(encoding="utf-8")
    assert list(analyses.differences(before, analyses.analysis(name), is_exact=is_exact())) == []


def test_a_calibration_stays_what_it_was(tmp_path: Path) -> None:
    said, file = analyses.calibration(tmp_path)
    before = (analyses.ANALYSES / "calibrate.jsonl").read_text(encoding="utf-8")
    assert list(analyses.differences(before, said, is_exact=is_exact())) == []
    if is_exact():
        assert file == (analyses.ANALYSES / "routine-calibration.toml").read_text(encoding="utf-8")


def test_a_number_that_differs_is_found() -> None:
    before, now = '{"a": [1.0, {"b": "x"}]}', '{"a": [1.0000001, {"b": "x"}]}'
    assert list(analyses.differences(before, now, is_exact=False)) == ["[0].a[0]: 1.0, now 1.0000001"]
    assert list(analyses.differences(before, now, is_exact=True)) == ["line 1"]
