"""Words of the command line become values or one clear line."""

from dataclasses import replace
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.errors import ConfigError
from diag_service.settings.config import (
    check_vehicle,
    default_store,
    vehicle_of,
)


@pytest.mark.parametrize("vehicle", ["car1", "A-1.b_2", "x" * 64, "_", "0"])
def test_vehicle_ids(vehicle: str) -> None:
    assert check_vehicle(vehicle) == vehicle


@pytest.mark.parametrize(
    "vehicle", ["", "a/b", "+", "#", "a+", "a#", "..", ".hidden", "-v", "a b", "é", "x" * 65, "a\n"]
)
def test_vehicle_ids_that_would_be_topics_or_paths(vehicle: str) -> None:
    with pytest.raises(ConfigError, match="vehicle id"):
        check_vehicle(vehicle)


@pytest.mark.parametrize(
    ("named", "calibrated", "expected"),
    [(None, None, "vehicle"), (None, "car7", "car7"), ("car8", None, "car8"), ("car8", "car7", "car8")],
)
def test_a_vehicle_is_named_by_hand_or_else_by_its_calibration(
    named: str | None, calibrated: str | None, expected: str
) -> None:
    assert vehicle_of(named, replace(nominal_calibration(), vehicle=calibrated)) == expected


def test_the_default_store_is_in_the_state_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_store("car1") == Path("/state/clutchdiag/car1.sqlite")
    monkeypatch.setenv("XDG_STATE_HOME", "relative/is/ignored")
    monkeypatch.setenv("HOME", "/home/driver")
    assert default_store("car1") == Path("/home/driver/.local/state/clutchdiag/car1.sqlite")
