"""Words of the command line become values, or one clear refusal."""

from pathlib import Path

import pytest

from fleet_backend.config import parse_broker, parse_listen
from fleet_backend.errors import ConfigError


def test_certificates_need_tls_and_must_exist() -> None:
    missing = Path("no-such-file")
    with pytest.raises(ConfigError, match="mqtts"):
        parse_broker("mqtt://x", ca=missing)
    with pytest.raises(ConfigError, match="no-such-file"):
        parse_broker("mqtts://x", ca=missing)
    with pytest.raises(ConfigError, match="no-such-file"):
        parse_broker("mqtts://x", certificate=missing)
    with pytest.raises(ConfigError, match="needs its key"):
        parse_broker("mqtts://x", key=missing)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:8090", "127.0.0.1", 8090),
        ("localhost:0", "127.0.0.1", 0),
        ("[::1]:80", "::1", 80),
        ("127.9.9.9:1", "127.9.9.9", 1),
    ],
)
def test_a_page_listens_on_the_loopback(text: str, host: str, port: int) -> None:
    assert (parse_listen(text).host, parse_listen(text).port) == (host, port)


@pytest.mark.parametrize(
    "text",
    ["0.0.0.0:8090", "[::]:80", "192.168.1.2:80", "fleet.example:80", "127.0.0.1", ":80", "1:1:1", "127.0.0.1:65536"],
)
def test_a_page_without_login_listens_nowhere_else(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^--listen "):
        parse_listen(text)
