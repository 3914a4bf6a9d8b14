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
