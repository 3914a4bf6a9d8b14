"""Words of the command line become values, or one clear refusal."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from fleet_backend.config import parse_broker, parse_listen, parse_moment, parse_pace
from fleet_backend.database import default_database, open_database
from fleet_backend.errors import ConfigError
from tests.support.certificates import certify


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


def test_a_certificate_and_its_key_may_lie_in_one_file_that_a_container_mounts_for_all(tmp_path: Path) -> None:
    certify(tmp_path, "fleet")
    both = tmp_path / "both.pem"
    both.write_bytes((tmp_path / "fleet.crt").read_bytes() + (tmp_path / "fleet.key").read_bytes())
    both.chmod(0o444)
    address = parse_broker("mqtts://x", ca=tmp_path / "ca.crt", certificate=both)
    assert address.tls is not None
    assert address.tls.certificate == both


def test_a_pace_has_bounds() -> None:
    assert parse_pace(10, 250.0).patience_s == 0.25
    assert parse_pace(10, 250.0).takes_bundles
    assert not parse_pace(10, 250.0, takes_bundles=False).takes_bundles
    for batch, patience_ms in ((0, 1.0), (30_001, 1.0), (1, -1.0), (1, 1e9), (1, float("nan"))):
        with pytest.raises(ConfigError):
            parse_pace(batch, patience_ms)


def test_a_moment_without_a_zone_is_utc() -> None:
    assert parse_moment("2026-01-31") == datetime(2026, 1, 31, tzinfo=UTC)
    assert parse_moment("2026-01-31T12:00+02:00") == datetime(2026, 1, 31, 10, tzinfo=UTC)
    with pytest.raises(ConfigError, match="not a date"):
        parse_moment("yesterday")
    for text, why in (
        ("1026-01-31", "too long ago"),
        ("0001-01-01", "too long ago"),
        ("0001-01-01T00:00+05:00", "not a date"),
    ):
        with pytest.raises(ConfigError, match=why):
            parse_moment(text)


@pytest.mark.parametrize("address", ["", "nonsense", "mysql://host/name", "oracle://x"])
def test_only_two_databases_are_known(address: str) -> None:
    with pytest.raises(ConfigError, match="the database must be"):
        open_database(address)


def test_the_default_database_is_in_the_state_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_database() == f"sqlite:///{tmp_path}/clutchdiag/fleet.sqlite"
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    assert default_database().endswith("/.local/state/clutchdiag/fleet.sqlite")


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
