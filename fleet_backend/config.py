"""What a run is to do, checked once: the command line's words become values, or a ConfigError."""

from datetime import UTC, datetime
from typing import Final
from urllib.parse import unquote, urlsplit

from fleet_backend.broker import BrokerAddress, TlsFiles
from fleet_backend.errors import ConfigError
from fleet_backend.ingest import Pace

_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_MAX_BATCH: Final = 30_000  # twice as many are in flight; MQTT counts to 65,535


def parse_broker(url: str, tls: TlsFiles) -> BrokerAddress:
    """Return the broker that ``mqtt[s]://[user[:password]@]host[:port]`` names.

    Raises
    ------
    ConfigError
        If the text is no such address; the message does not repeat it, since it may hold a password.
    """
    form = "the broker must be mqtt[s]://[user[:password]@]host[:port]"
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as exc:
        raise ConfigError(f"{form}: {exc}") from exc
    if parts.scheme not in _PORTS or not parts.hostname or parts.path.strip("/") or parts.query or parts.fragment:
        raise ConfigError(form)
    if port == 0:
        raise ConfigError(f"{form}: port 0 is no port")
    is_secure = parts.scheme == "mqtts"
    if not is_secure and tls != TlsFiles():
        raise ConfigError("certificates need a broker at mqtts://")
    if is_secure:
        tls.context()  # a wrong file is said now, not at the first connection
    return BrokerAddress(
        host=parts.hostname,
        port=port or _PORTS[parts.scheme],
        username=None if parts.username is None else unquote(parts.username),
        password=None if parts.password is None else unquote(parts.password),
        tls=tls if is_secure else None,
    )


def parse_pace(batch_size: int, patience_ms: float) -> Pace:
    """Return how messages are gathered; raises ConfigError for numbers that make no sense."""
    if not 1 <= batch_size <= _MAX_BATCH:
        raise ConfigError(f"a batch must be 1 to {_MAX_BATCH} messages, got {batch_size}")
    if not 0.0 <= patience_ms <= 10_000.0:
        raise ConfigError(f"the patience must be 0 to 10000 ms, got {patience_ms:g}")
    return Pace(batch_size=batch_size, patience_s=patience_ms / 1000.0)


def parse_moment(text: str) -> datetime:
    """Return an ISO 8601 moment; without a zone it is UTC.

    Raises
    ------
    ConfigError
        If the text is none.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as exc:
        raise ConfigError(f"{text!r} is no date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
