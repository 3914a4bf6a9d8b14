"""Settings from files, environment and command line."""

import tomllib
from dataclasses import replace
from pathlib import Path

import click
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.cli import check, main
from diag_service.commands.live import describe
from diag_service.commands.options import SETTINGS, read_settings
from diag_service.errors import ConfigError
from diag_service.settings.config import check_vehicle, default_store, vehicle_of
from fleet_contract.settings import PREFIX

VALUES: dict[str, str | int | float | bool] = {
    "vehicle": "car1",
    "dbc": "car.dbc",
    "profile": "car.toml",
    "calibration": "type.toml",
    "vehicle_file": "vehicle.toml",
    "store": "car.sqlite",
    "store_budget": 64,
    "broker": "mqtt://car1@host",
    "ca": "ca.crt",
    "cert": "car1.crt",
    "key": "car1.key",
    "password_file": "password",
    "acknowledge": "backend",
    "interface": "socketcan",
    "channel": "vcan0",
    "bitrate": 500000,
    "fd": True,
    "only_mapped": True,
    "duration": 12.5,
    "once": True,
    "metrics": "9100",
    "poll": 30.0,
    "adapter": "elm327:/dev/rfcomm0",
    "active": True,
    "ecu": "7E0",
    "reply": "7E8",
    "description": "gearbox.toml",
}
UNSET = dict.fromkeys(VALUES) | {
    **dict.fromkeys(("fd", "only_mapped", "once", "active"), False),
    "acknowledge": "broker",
}


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*VALUES, "config"):
        monkeypatch.delenv(PREFIX + name.upper(), raising=False)


def toml(values: dict[str, str | int | float | bool]) -> str:
    words = {name: str(value).lower() if isinstance(value, bool) else repr(value) for name, value in values.items()}
    return "".join(f"{name} = {word}\n" for name, word in words.items())


def settings(file: Path | None = None, *words: str) -> dict[str, object]:
    """Return the settings of a run."""
    context = check.make_context("check", [*words, *([] if file is None else ["--config", str(file)])])
    return {name: context.params[name] for name in VALUES}


def changed(values: dict[str, object]) -> dict[str, str]:
    """Return the settings that are not as they are where nobody sets them."""
    return {name: str(value) for name, value in values.items() if value != UNSET[name]}


def test_every_option_can_be_set_and_left_out() -> None:
    assert set(VALUES) == set(SETTINGS)
    assert settings() == UNSET


def test_every_option_may_be_in_the_file(tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(toml(VALUES), encoding="utf-8")
    assert changed(settings(file)) == {name: str(value) for name, value in VALUES.items()}


def test_who_stands_over_whom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "car.toml"
    file.write_text('vehicle = "file"\nchannel = "file"\ninterface = "file"\n', encoding="utf-8")
    monkeypatch.setenv("CLUTCHDIAG_CONFIG", str(file))
    monkeypatch.setenv("CLUTCHDIAG_CHANNEL", "environment")
    monkeypatch.setenv("CLUTCHDIAG_INTERFACE", "environment")
    assert changed(settings(None, "--interface", "line")) == {
        "vehicle": "file",
        "channel": "environment",
        "interface": "line",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vehicel = 'car1'", "vehicel: Extra inputs are not permitted"),
        ("acknowledge = 'nobody'", "'--acknowledge': 'nobody' is not one of 'broker', 'backend'"),
        ("bitrate = 5.5", "'--bitrate': '5.5' is not a valid integer"),
        ("duration = 'long'", "'--duration': 'long' is not a valid float"),
        ("fd = 'perhaps'", "'--fd': 'perhaps' is not a valid boolean"),
        ("vehicle = ", "is not TOML"),
    ],
)
def test_a_file_that_is_wrong_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(click.ClickException) as caught:
        settings(file)
    assert message in caught.value.format_message()


def test_what_is_wrong_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "car.toml"
    file.write_text("store_budget = 'hunter2'", encoding="utf-8")
    assert main(["config", "check", "--config", str(file)]) == 2
    monkeypatch.setenv("CLUTCHDIAG_STORE_BUDGET", "hunter2")
    assert main(["config", "check"]) == 2
    told = capsys.readouterr().err
    assert "store_budget: what the settings file says is not a valid integer" in told
    assert "store_budget: what the environment says is not a valid integer" in told
    assert "hunter2" not in told


def test_a_password_in_a_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text('broker = "mqtt://car1:hunter2@host"\n', encoding="utf-8")
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600") as caught:
        read_settings(file)
    assert "hunter2" not in str(caught.value)
    file.chmod(0o600)
    assert read_settings(file) == {"broker": "mqtt://car1:hunter2@host"}


def test_the_settings_are_shown_as_a_file_with_the_password_masked() -> None:
    text = describe({**VALUES, "broker": "mqtts://car1:hunter2@host", "metrics": None})
    assert "hunter2" not in text
    assert tomllib.loads(text) == {key: value for key, value in VALUES.items() if key != "metrics"} | {
        "broker": "mqtts://car1:***@host"
    }
    assert "# metrics is not set\n" in text


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
