"""What a watch is told on its command line, checked once: where alarms go, and when there are any."""

import base64
import binascii
import re
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Final
from urllib.parse import SplitResult, urlsplit

from fleet_backend.errors import ConfigError
from fleet_link import AddressError, read_secret

_LEAST_SECRET: Final = 24  # bytes, as Standard Webhooks asks for
_ADDRESS: Final = re.compile(r"[^@\s<>,;]{1,64}@[A-Za-z0-9.-]{1,255}")
_MOST_KM: Final = 300_000.0  # as far as a prognosis looks


def parse_webhook(url: str) -> str:
    """Return where alarms are posted; raises ConfigError, without the address: it may hold a secret."""
    parts = _split(url)
    if parts is None or parts.scheme not in {"http", "https"} or not parts.hostname or not url.isprintable():
        raise ConfigError("--webhook must be https://host/path")
    if parts.scheme == "http" and parts.hostname not in {"127.0.0.1", "localhost", "::1"}:
        raise ConfigError("--webhook: http is for this machine only; use https")
    return url


def parse_secret(path: Path | None) -> bytes:
    """Return the secret in a file: ``whsec_`` and base64, or any text; raises ConfigError."""
    if path is None:
        raise ConfigError("a webhook needs --secret FILE, so that its receiver can verify the sender")
    try:
        text = read_secret(path)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    try:
        is_coded = text.startswith("whsec_")
        secret = base64.b64decode(text.removeprefix("whsec_"), validate=True) if is_coded else text.encode()
    except (binascii.Error, ValueError) as exc:
        raise ConfigError(f"{path}: whsec_ must be followed by base64") from exc
    if len(secret) < _LEAST_SECRET:
        raise ConfigError(f"{path}: a secret must have {_LEAST_SECRET} bytes or more")
    return secret


def parse_mail(url: str, sender: str | None, recipients: Sequence[str]) -> tuple[SplitResult, str, tuple[str, ...]]:
    """Return the server for e-mail, who sends and who receives; raises ConfigError, without the address."""
    parts = _split(url)
    if parts is None or parts.scheme not in {"smtp", "smtps"} or not parts.hostname:
        raise ConfigError("--mail must be smtp[s]://[user[:password]@]host[:port]")
    if sender is None or not recipients:
        raise ConfigError("e-mail needs --from and --to")
    for address in (sender, *recipients):
        if not _ADDRESS.fullmatch(address):
            raise ConfigError(f"{address!r} is not an e-mail address")
    return parts, sender, tuple(recipients)


def parse_silence(days: float) -> timedelta:
    """Return how long a vehicle may be silent; raises ConfigError."""
    if not 2.0 <= days <= 3650.0:
        raise ConfigError(f"--silence-days must be 2 to 3650, got {days:g}")
    return timedelta(days=days)


def parse_service_km(distance_km: float) -> float:
    """Return the distance to the next service [m]; raises ConfigError."""
    if not 1.0 <= distance_km <= _MOST_KM:
        raise ConfigError(f"--service-km must be 1 to {_MOST_KM:g}, got {distance_km:g}")
    return 1000.0 * distance_km


def _split(url: str) -> SplitResult | None:
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return None
    return parts
