"""Words of the command line become values or one clear line."""

from dataclasses import replace
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.errors import ConfigError
from diag_service.settings.config import (
    BusConfig,
    check_vehicle,
    default_store,
    parse_broker,
    vehicle_of,
)
from fleet_link import BrokerAddress

BUS = BusConfig(interface=None, channel=None, bitrate=None, is_fd=False, duration_s=None)


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


def test_a_calibration_may_name_a_vehicle_that_is_no_id() -> None:
    with pytest.raises(ConfigError, match="the calibration's vehicle: 'car 7' is no vehicle id"):
        vehicle_of(None, replace(nominal_calibration(), vehicle="car 7"))


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("mqtt://broker", BrokerAddress(host="broker")),
        ("mqtt://broker:1884/", BrokerAddress(host="broker", port=1884)),
        ("mqtt://u:p%40ss@10.0.0.1:1", BrokerAddress(host="10.0.0.1", port=1, username="u", password="p@ss")),  # noqa: S106 - made up
        ("mqtt://u@[::1]", BrokerAddress(host="::1", username="u")),
    ],
)
def test_broker_addresses(url: str, address: BrokerAddress) -> None:
    assert parse_broker(url) == address


@pytest.mark.parametrize(
    "url",
    [
        "broker",
        "http://broker",
        "mqtt://",
        "mqtt://broker:0",
        "mqtt://broker:70000",
        "mqtt://broker:x",
        "mqtt://broker/topic",
        "mqtt://[::1",
    ],
)
def test_what_is_no_broker_address(url: str) -> None:
    with pytest.raises(ConfigError, match="the broker must be mqtt"):
        parse_broker(url)


def test_a_password_is_not_shown() -> None:
    address = parse_broker("mqtt://user:secret@broker")
    assert "secret" not in f"{address} {address!r}"
    with pytest.raises(ConfigError) as caught:
        parse_broker("mqtt://user:secret@broker/path")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("change", [{"bitrate": 0}, {"duration_s": 0.0}, {"duration_s": float("nan")}])
def test_bus_numbers_out_of_range(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="> 0"):
        replace(BUS, **change)  # type: ignore[arg-type]


def test_the_default_store_is_in_the_state_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_store("car1") == Path("/state/clutchdiag/car1.sqlite")
    monkeypatch.setenv("XDG_STATE_HOME", "relative/is/ignored")
    monkeypatch.setenv("HOME", "/home/driver")
    assert default_store("car1") == Path("/home/driver/.local/state/clutchdiag/car1.sqlite")
