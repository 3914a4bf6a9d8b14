"""Addresses of brokers, what of them is secret, and who on the way could read what goes there."""

import pytest

from fleet_link import AddressError, BrokerAddress, TlsFiles, parse_broker

SYSTEMS = TlsFiles()  # without files the authorities of the system count


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("mqtt://broker", BrokerAddress(host="broker")),
        ("mqtt://broker:1884/", BrokerAddress(host="broker", port=1884)),
        ("mqtt://u:p%40ss@10.0.0.1:1", BrokerAddress(host="10.0.0.1", port=1, username="u", password="p@ss")),  # noqa: S106 - made up
        ("mqtt://u@[::1]", BrokerAddress(host="::1", username="u")),
        ("nats://broker", BrokerAddress(host="broker", port=4222, is_nats=True)),
        ("nats+tls://broker", BrokerAddress(host="broker", port=4222, tls=SYSTEMS, is_nats=True)),
    ],
)
def test_what_an_address_says(url: str, address: BrokerAddress) -> None:
    assert parse_broker(url, may_be_nats=True) == address
    assert "p@ss" not in f"{address} {address!r}"


@pytest.mark.parametrize(
    "url",
    [
        "",
        "broker",
        "http://car:hunter2@broker",
        "nats://broker",  # where it may not be
        "mqtt://",
        "mqtt://broker:0",
        "mqtt://car:hunter2@broker:x",
        "mqtt://car:hunter/2@broker",
        "mqtt://[::1",
        f"mqtt://car:hunter2@{'b' * 64}.example",
    ],
)
def test_what_is_none_is_refused_without_repeating_it(url: str) -> None:
    with pytest.raises(AddressError, match="the broker must be mqtt") as caught:
        parse_broker(url)
    assert "hunter" not in str(caught.value)


@pytest.mark.parametrize(
    "host",
    ["localhost", "LOCALHOST.", "car.localhost", "127.8.9.10", "::1", "0:0:0:0:0:0:0:1", "::ffff:127.0.0.1"],
)
def test_this_machine_is_known_by_name_and_address(host: str) -> None:
    assert BrokerAddress(host=host).exposure is None


@pytest.mark.parametrize(
    "host", ["broker", "localhost.example.org", "10.0.0.1", "192.0.2.1", "fe80::1%eth0", "127.0.0.1.nip.io"]
)
def test_another_machine_is_warned_of_unless_it_is_encrypted(host: str) -> None:
    assert BrokerAddress(host=host, tls=SYSTEMS).exposure is None
    plain = BrokerAddress(host=host, username="car", password="x").exposure  # noqa: S106 - made up
    assert plain is not None
    assert "password" in plain
    assert (BrokerAddress(host=host).exposure or "").startswith(f"results go to {host} unencrypted")
