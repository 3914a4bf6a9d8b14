"""Settings: the command line over the environment over the file over the defaults; unknown keys and secrets."""

import argparse
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from diag_service.cli import main
from diag_service.errors import ConfigError
from diag_service.settings.config import parse_broker
from diag_service.settings.defaults import DEFAULTS, PREFIX
from diag_service.settings.files import Settings, load_settings
from diag_service.settings.options import describe, fill_in
from fleet_contract import SERVICE_VARIABLES
from tests.service import environment

VALUES: dict[str, str | int | float | bool] = {
    "vehicle": "car1",
    "dbc": "car.dbc",
    "profile": "car.toml",
    "calibration": "type.toml",
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
    "lenient": True,
    "duration": 12.5,
    "metrics": "9100",
}


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*DEFAULTS, "config"):
        monkeypatch.delenv(PREFIX + name.upper(), raising=False)


def toml(values: dict[str, str | int | float | bool]) -> str:
    words = {name: str(value).lower() if isinstance(value, bool) else repr(value) for name, value in values.items()}
    return "".join(f"{name} = {word}\n" for name, word in words.items())


def filled(file: Path | None = None, **given: object) -> argparse.Namespace:
    options = argparse.Namespace(config=file, **given)
    fill_in(options)
    return options


def test_every_option_can_be_set_and_left_out() -> None:
    assert set(VALUES) == set(DEFAULTS) == set(Settings.model_fields)
    assert vars(filled()) == {"config": None, **DEFAULTS}


@pytest.mark.parametrize("name", VALUES)
def test_an_option_of_the_file(name: str, tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(toml({name: VALUES[name]}), encoding="utf-8")
    options = filled(file)
    assert {key: str(value) for key, value in vars(options).items() if key != "config" and value != DEFAULTS[key]} == {
        name: str(VALUES[name])
    }


@pytest.mark.parametrize("name", VALUES)
def test_an_option_that_the_file_leaves_out(name: str, tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(toml({key: value for key, value in VALUES.items() if key != name}), encoding="utf-8")
    assert getattr(filled(file), name) == DEFAULTS[name]


@pytest.mark.parametrize("name", VALUES)
def test_an_option_of_the_environment(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PREFIX + name.upper(), str(VALUES[name]))
    assert str(getattr(filled(), name)) == str(VALUES[name])


def test_who_stands_over_whom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "car.toml"
    file.write_text('vehicle = "file"\nchannel = "file"\ninterface = "file"\n', encoding="utf-8")
    monkeypatch.setenv("CLUTCHDIAG_CONFIG", str(file))
    monkeypatch.setenv("CLUTCHDIAG_CHANNEL", "environment")
    monkeypatch.setenv("CLUTCHDIAG_INTERFACE", "environment")
    options = filled(interface="line")
    assert (options.vehicle, options.channel, options.interface) == ("file", "environment", "line")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vehicel = 'car1'", "vehicel: Extra inputs are not permitted"),
        ("store_budget = 'large'", "store_budget"),
        ("acknowledge = 'nobody'", "acknowledge"),
        ("vehicle = ", "is no TOML"),
        ("[bus]\nchannel = 'vcan0'", "bus: Extra inputs are not permitted"),
    ],
)
def test_a_file_that_is_wrong_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        load_settings(file)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_settings(tmp_path / "none.toml")


def test_what_is_wrong_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUTCHDIAG_STORE_BUDGET", "hunter2")
    with pytest.raises(ConfigError) as caught:
        load_settings(None)
    assert "hunter2" not in str(caught.value)


def test_a_password_in_a_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text('broker = "mqtt://car1:hunter2@host"\n', encoding="utf-8")
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600") as caught:
        load_settings(file)
    assert "hunter2" not in str(caught.value)
    file.chmod(0o600)
    assert load_settings(file) == {"broker": "mqtt://car1:hunter2@host"}


def test_the_settings_are_shown_as_a_file_with_the_password_masked() -> None:
    options = argparse.Namespace(**{**VALUES, "broker": "mqtts://car1:hunter2@host", "metrics": None})
    text = describe(options)
    assert "hunter2" not in text
    assert tomllib.loads(text) == {key: value for key, value in VALUES.items() if key != "metrics"} | {
        "broker": "mqtts://car1:***@host"
    }
    assert "# metrics is not set\n" in text


def test_config_check_prints_what_a_run_would_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLUTCHDIAG_BROKER", "mqtt://car1:hunter2@host")
    assert main(["config", "check", "--vehicle", "car1"]) == 0
    captured = capsys.readouterr()
    assert "hunter2" not in captured.out + captured.err
    assert tomllib.loads(captured.out)["vehicle"] == "car1"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--vehicle", "a/b"), "no vehicle id"),
        (("--acknowledge", "backend"), "without a broker"),
        (("--cert", "a"), "needs its key"),
        (("--cert", "a", "--key", "b"), "need a broker"),
        (("--broker", "mqtt://host", "--ca", "a"), "mqtts://"),
        (("--broker", "mqtt://host", "--password-file", "/none"), "cannot read /none"),
        (("--store-budget", "0"), "disk budget"),
        (("--config", "/none"), "cannot read /none"),
    ],
)
def test_config_check_finds_what_is_wrong(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "check", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_password_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("hunter2\n", encoding="utf-8")
    file.chmod(0o600)
    address = parse_broker("mqtts://car1@host", None, file)
    assert (address.password, address.port) == ("hunter2", 8883)
    assert "hunter2" not in repr(address)


def test_a_start_without_settings_does_not_wait_for_pydantic() -> None:
    code = (
        "import argparse, sys; from diag_service import cli; from diag_service.service import application;"
        "from diag_service.settings import options;"
        " options.fill_in(argparse.Namespace(config=None)); sys.exit('pydantic' in sys.modules)"
    )
    started = subprocess.run([sys.executable, "-c", code], check=False, env=environment())
    assert started.returncode == 0


def test_a_variable_that_nothing_reads_is_an_error_that_names_the_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUTCHDIAG_VEHICEL", "hunter2")
    with pytest.raises(ConfigError, match=r"CLUTCHDIAG_VEHICEL.*CLUTCHDIAG_VEHICLE") as caught:
        filled()
    assert "hunter2" not in str(caught.value)
    monkeypatch.setenv("CLUTCHDIAG_VEHICEL", "")  # as good as not set
    assert filled().vehicle == DEFAULTS["vehicle"]


def test_the_backend_s_variables_are_no_mistake_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLUTCHDIAG_DATABASE", "postgresql://fleet@db/fleet")
    assert filled().vehicle == DEFAULTS["vehicle"]


def test_the_contract_knows_every_variable() -> None:
    assert {PREFIX + name.upper() for name in (*DEFAULTS, "config")} == SERVICE_VARIABLES
