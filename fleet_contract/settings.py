"""What people set for both sides: a broker, ``mqtt[s]://[user[:password]@]host[:port]``, and environment variables.

Both programs may share a shell: neither takes the other's variables for a mistake.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from ipaddress import ip_address
from typing import Final
from urllib.parse import unquote, urlsplit

from fleet_contract.errors import BrokerUrlError, VariableError

PREFIX: Final = "CLUTCHDIAG_"
SERVICE_VARIABLES: Final = frozenset(
    PREFIX + name
    for name in (
        *("ACKNOWLEDGE", "BITRATE", "BROKER", "CA", "CALIBRATION", "CERT", "CHANNEL", "CONFIG", "DBC"),
        *("DURATION", "FD", "INTERFACE", "KEY", "LENIENT", "METRICS", "ONLY_MAPPED", "PAGE", "PARSER_TIME"),
        *("PASSWORD_FILE", "PROFILE", "STORE", "STORE_BUDGET", "VEHICLE", "VEHICLE_FILE"),
        *("ACTIVE", "ADAPTER", "DESCRIPTION", "ECU", "POLL", "REPLY"),
    )
)
BACKEND_VARIABLES: Final = frozenset(PREFIX + name for name in ("BROKER", "DATABASE", "GROUP"))


def check_variables(environment: Mapping[str, str]) -> None:
    """Raise VariableError if a variable that is set has our prefix and is known to neither program."""
    known = SERVICE_VARIABLES | BACKEND_VARIABLES
    for name in sorted(environment):
        if not name.startswith(PREFIX) or name in known or not environment[name]:
            continue
        nearest = get_close_matches(name, sorted(known), n=1, cutoff=0.0)
        raise VariableError(f"the environment sets {name}, which nothing reads; the nearest known name is {nearest[0]}")


_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_NATS_PORTS: Final = {"nats": 4222, "nats+tls": 4222}
_ENCRYPTED: Final = frozenset({"mqtts", "nats+tls"})
_FORM: Final = "the broker must be mqtt[s]://[user[:password]@]host[:port]"


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerUrl:
    """What such a text says."""

    host: str
    port: int
    username: str | None
    password: str | None = field(repr=False)
    is_encrypted: bool
    is_nats: bool = False  # else MQTT


def is_this_machine(host: str) -> bool:
    """Return whether a host is this machine's loopback interface, by its name or address alone."""
    try:
        address = ip_address(host.partition("%")[0])
    except ValueError:
        name = host.casefold().rstrip(".")
        return name == "localhost" or name.endswith(".localhost")
    mapped = getattr(address, "ipv4_mapped", None)
    return address.is_loopback or (mapped is not None and mapped.is_loopback)


def exposure(host: str, *, is_encrypted: bool, has_password: bool) -> str | None:
    """Return what to warn of before anything is sent to a broker; None if nobody on the way can read it."""
    if is_encrypted or is_this_machine(host):
        return None
    what = "results and the broker's password" if has_password else "results"
    return f"{what} go to {host} unencrypted: anyone on the way can read them; mqtts:// encrypts"


def parse_broker_url(text: str, *, may_be_nats: bool = False) -> BrokerUrl:
    """Return what an address says; where it ``may_be_nats`` also ``nats://`` or ``nats+tls://``.

    Raises
    ------
    BrokerUrlError
        If the text is none; the message does not repeat it, since it may hold a password.
    """
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:  # its text quotes what it takes for the port, which may be half a password
        raise BrokerUrlError(f"{_FORM}, with %-escapes in the password and a port up to 65535") from None
    ports = _PORTS | _NATS_PORTS if may_be_nats else _PORTS
    if parts.scheme not in ports or not parts.hostname or parts.path.strip("/") or parts.query or parts.fragment:
        raise BrokerUrlError(_FORM)
    if port == 0:
        raise BrokerUrlError(f"{_FORM}: 0 is not a port")
    try:
        parts.hostname.encode("idna")
    except UnicodeError:
        raise BrokerUrlError(f"{_FORM}: a part of the host's name is empty or too long") from None
    return BrokerUrl(
        host=parts.hostname,
        port=port or ports[parts.scheme],
        username=None if parts.username is None else unquote(parts.username),
        password=None if parts.password is None else unquote(parts.password),
        is_encrypted=parts.scheme in _ENCRYPTED,
        is_nats=parts.scheme in _NATS_PORTS,
    )
