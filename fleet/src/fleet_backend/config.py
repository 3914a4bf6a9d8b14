"""What a run is to do, checked once: the command line's words become values, or a ConfigError."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from ipaddress import ip_address
from pathlib import Path
from typing import Final

import fleet_link
from fleet_backend.choices import Quotas
from fleet_backend.errors import BackendConfigError, BackendExtraError
from fleet_contract.orders import EARLIEST
from fleet_link import AddressError, BrokerAddress, TlsFiles

_MAX_PORT: Final = 65_535


def parse_broker(
    url: str,
    *,
    ca: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
    may_be_nats: bool = False,
) -> BrokerAddress:
    """Return the broker that ``mqtt[s]://[user[:password]@]host[:port]`` names, with certificates for ``mqtts``.

    Where it ``may_be_nats`` also ``nats://`` and ``nats+tls://``.

    Raises
    ------
    ExtraMissingError
        If the library for NATS is not installed.
    ConfigError
        If the text is no such address; the message does not repeat it, since it may hold a password. If a certificate
        cannot be used: that is said now, not at the first connection.
    """
    try:
        address = fleet_link.parse_broker(
            url,
            TlsFiles(authority=ca, certificate=certificate, key=certificate if key is None else key),
            may_be_nats=may_be_nats,
        )
        if address.tls is not None:
            address.tls.context(is_key_private=False)
    except AddressError as exc:
        raise BackendConfigError(str(exc)) from exc
    if address.is_nats and find_spec("nats") is None:
        raise BackendExtraError("nats", extra="nats")
    return address


def parse_quotas(text: str) -> Quotas:
    """Return the quotas in ``RESULTS,MESSAGES,MB``; raises ConfigError if they are none."""
    match = re.fullmatch(r"([0-9]{1,12}),([0-9]{1,12}),([0-9]{1,9})", text)
    if match is None:
        raise BackendConfigError(f"quotas must be RESULTS,MESSAGES,MB, such as 100000,1000,500, got {text!r}")
    results, quarantined, megabytes = map(int, match.groups())
    return Quotas(results=results, quarantined=quarantined, size_bytes=megabytes * 1_000_000)


def parse_group(text: str) -> str:
    """Return the name of the group of workers; raises ConfigError if it cannot be a level of a subscription."""
    if re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", text) is None:
        raise BackendConfigError("a group must be 1 to 64 of A-Z, a-z, 0-9, _ . -")
    return text


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerAddress:
    """Where a server listens; port 0 is any free one."""

    host: str
    port: int


def parse_listen(text: str, *, has_login: bool = False, option: str = "--listen") -> ServerAddress:
    """Return the place in ``HOST:PORT`` or ``[HOST]:PORT``, without a login one of this machine's loopback.

    Raises ConfigError if the text is none, or others could reach it: nobody has to log in.
    """
    match = re.fullmatch(r"\[?([0-9A-Za-z.:-]+?)\]?:([0-9]{1,5})", text)
    if match is None or int(match[2]) > _MAX_PORT:
        raise BackendConfigError(f"{option} must be HOST:PORT, such as 127.0.0.1:8090, got {text!r}")
    host = "127.0.0.1" if match[1] == "localhost" else match[1]
    try:
        is_loopback = ip_address(host).is_loopback
    except ValueError as exc:
        raise BackendConfigError(f"{option} must be an address in numbers or localhost, got {host!r}") from exc
    if not is_loopback and not has_login:
        hint = "give --access" if option == "--listen" else "let a proxy with one ask a loopback address"
        raise BackendConfigError(f"{option} {text}: others could read the fleet there without a login; {hint}")
    return ServerAddress(host=host, port=int(match[2]))


def parse_moment(text: str) -> datetime:
    """Return an ISO 8601 moment; without a zone it is UTC.

    Raises ConfigError if the text is none, or too long ago.
    """
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise BackendConfigError(f"{text!r} is not a date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc
    if moment < EARLIEST:
        raise BackendConfigError(f"{text} is too long ago")
    return moment
