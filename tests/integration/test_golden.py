"""A stored set of recordings, of all fluids, with faults, of foreign vehicles: everybody gets what they got before."""

from pathlib import Path

import pytest

from tests.golden import compare
from tests.golden.compare import Faces
from tests.golden.differences import differences
from tests.plugins.broker import Mosquitto


def check(before: Faces, now: Faces) -> None:
    is_exact = compare.is_exact()
    found = {kind: list(differences(text, now[kind], is_exact=is_exact)) for kind, text in before.items()}
    assert {kind: differing for kind, differing in found.items() if differing} == {}


@pytest.mark.parametrize("name", compare.NAMES)
def test_a_recording_shows_what_it_showed(name: str, tmp_path: Path, broker: Mosquitto) -> None:
    check(compare.stored_faces(name), compare.recording(name, tmp_path, broker))


def test_a_calibration_stays_what_it_was(tmp_path: Path) -> None:
    check(compare.stored_faces("calibration"), compare.calibration(tmp_path))


def test_the_fleet_sees_what_it_saw(tmp_path: Path) -> None:
    check(compare.stored_faces("pages"), compare.pages(tmp_path))


def test_what_differs_is_found() -> None:
    before, now = '{"a": [1.0, {"b": "x"}]}', '{"a": [1.0000001, {"b": "x"}]}'
    assert list(differences(before, now, is_exact=False)) == ["[0].a[0]: 1.0, now 1.0000001"]
    assert list(differences(before, now, is_exact=True)) == [f"line 1: {before!r}, now {now!r}"]
    assert list(differences("<p>good 1.25</p>", "<p>good 1.26</p>", is_exact=False)) == []
    assert list(differences("<p>good 1.25</p>", "<p>good 1.28</p>", is_exact=False)) == ["'1.25', now '1.28'"]
    assert list(differences("<p>good 1.25</p>", "<p>poor 1.25</p>", is_exact=False)) != []
