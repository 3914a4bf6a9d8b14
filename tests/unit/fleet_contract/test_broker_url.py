"""How a broker is named."""

import pytest

from fleet_contract import BrokerUrl, BrokerUrlError, exposure, parse_broker_url
from fleet_contract.settings import is_this_machine


@pytest.mark.parametrize(
    ("text", "host", "port", "is_encrypted"),
    [
        ("mqtt://broker", "broker", 1883, False),
        ("mqtts://broker", "broker", 8883, True),
        ("mqtt://broker:1884/", "broker", 1884, False),
        ("mqtts://[::1]:1", "::1", 1, True),
    ],
)
def test_what_an_address_says(text: str, host: str, port: int, is_encrypted: bool) -> None:
    named = BrokerUrl(host=host, port=port, username=None, password=None, is_encrypted=is_encrypted)
    assert parse_broker_url(text) == named


@pytest.mark.parametrize(("text", "is_encrypted"), [("nats://broker", False), ("nats+tls://broker", True)])
def test_nats_is_named_where_it_may_be(text: str, is_encrypted: bool) -> None:
    named = parse_broker_url(text, may_be_nats=True)
    assert (named.port, named.is_encrypted, named.is_nats) == (4222, is_encrypted, True)
    with pytest.raises(BrokerUrlError, match="must be mqtt"):
        parse_broker_url(text)


def test_a_password_is_read_and_not_shown() -> None:
    named = parse_broker_url("mqtt://car:p%40ss@broker")
    assert (named.username, named.password) == ("car", "p@ss")
    assert "p@ss" not in repr(named)


@pytest.mark.parametrize(
    "text",
    [
        "mqtt://car:hunter/2@broker",
        "mqtt://car:hunter2@broker:x",
        "http://car:hunter2@x",
        "mqtt://car:hunter2@broker..example",
        f"mqtt://car:hunter2@{'b' * 64}.example",
    ],
)
def test_what_is_none_is_refused_without_repeating_it(text: str) -> None:
    with pytest.raises(BrokerUrlError, match="the broker must be mqtt") as caught:
        parse_broker_url(text)
    assert "hunter" not in str(caught.value)


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST.",
        "car.localhost",
        "127.0.0.1",
        "127.8.9.10",
        "::1",
        "0:0:0:0:0:0:0:1",
        "::ffff:127.0.0.1",
    ],
)
def test_this_machine_is_known_by_name_and_address(host: str) -> None:
    assert is_this_machine(host)
    assert exposure(host, is_encrypted=False, has_password=True) is None


@pytest.mark.parametrize(
    "host",
    ["broker", "localhost.example.org", "10.0.0.1", "192.0.2.1", "fe80::1%eth0", "127.0.0.1.nip.io"],
)
def test_another_machine_is_warned_of_unless_it_is_encrypted(host: str) -> None:
    assert exposure(host, is_encrypted=True, has_password=True) is None
    text = exposure(host, is_encrypted=False, has_password=False)
    assert text is not None
    assert "mqtts://" in text
    assert "password" not in text
    assert "password" in (exposure(host, is_encrypted=False, has_password=True) or "")
