"""Addresses of brokers, and what of them is secret."""

from pathlib import Path

import pytest

from fleet_link import AddressError, BrokerAddress, parse_broker


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
    with pytest.raises(AddressError, match="the broker must be mqtt"):
        parse_broker(url)


def test_a_password_is_not_shown() -> None:
    address = parse_broker("mqtt://user:secret@broker")
    assert "secret" not in f"{address} {address!r}"
    with pytest.raises(AddressError) as caught:
        parse_broker("mqtt://user:secret@broker/path")
    assert "secret" not in str(caught.value)


def test_a_password_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("hunter2\n", encoding="utf-8")
    file.chmod(0o600)
    address = parse_broker("mqtts://car1@host", None, file)
    assert (address.password, address.port) == ("hunter2", 8883)
    assert "hunter2" not in repr(address)
