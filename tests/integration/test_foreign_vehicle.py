"""The same drive in the code of a vehicle that does not exist gives the same friction."""

from pathlib import Path

import pytest

from diag_service.mapping.profile import load_profile
from tests.plugins.drives import SHIFT_COUNT
from tests.support.in_process import ended as run
from tests.support.recode import load_strict, recode

DATA = Path(__file__).parents[1] / "data"
DBC, PROFILE = DATA / "foreign.dbc", DATA / "foreign.toml"


def test_the_foreign_database_is_sound_and_unlike_ours() -> None:
    signals = [signal for message in load_strict(DBC).messages for signal in message.signals]
    assert {signal.byte_order for signal in signals} == {"big_endian"}
    assert {signal.unit for signal in signals if signal.unit} == {"rad/s", "Nm", "kPa", "K", "km"}
    assert not {signal.unit for signal in signals} & {"rpm", "bar", "degC"}


def test_another_vehicle_gives_the_same_friction(drive_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "foreign.log"
    recode(drive_log, DBC, load_profile(PROFILE), log)
    ours = run("analyze", drive_log, "--json")
    theirs = run("analyze", log, "--dbc", DBC, "--profile", PROFILE, "--json")
    assert (theirs.status, theirs.err) == (0, "")
    assert len(theirs.shifts) == SHIFT_COUNT
    for one, other in zip(theirs.shifts, ours.shifts, strict=True):
        assert one["status"] == other["status"] == "valid"
        assert one["tier"] == 1
        for key in ("mu_c", "mu_s"):
            assert one["friction"][key] == pytest.approx(
                other["friction"][key], abs=0.1 * other["friction"][f"std_{key}"]
            )
