"""What a run is to do, checked once: the command line's words become values, or a ConfigError."""

from datetime import UTC, datetime
from typing import Final

from fleet_backend.broker import BrokerAddress, TlsFiles
from fleet_backend.choices import Pace
from fleet_backend.errors import ConfigError
from fleet_contract import BrokerUrlError, parse_broker_url

_MAX_BATCH: Final = 30_000  # twice as many are in flight; MQTT counts to 65,535


def parse_broker(url: str, tls: TlsFiles) -> BrokerAddress:
    """Return the broker that ``mqtt[s]://[user[:password]@]host[:port]`` names.

    Raises
    ------
    ConfigError
        If the text is no such address; the message does not repeat it, since it may hold a password.
    """
    try:
        parts = parse_broker_url(url)
    except BrokerUrlError as exc:
        raise ConfigError(str(exc)) from exc
    if parts.is_encrypted:
        tls.context()  # a wrong file is said now, not at the first connection
    elif tls != TlsFiles():
        raise ConfigError("certificates need a broker at mqtts://")
    return BrokerAddress(
        host=parts.host,
        port=parts.port,
        username=parts.username,
        password=parts.password,
        tls=tls if parts.is_encrypted else None,
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
