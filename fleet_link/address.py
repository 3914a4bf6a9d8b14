"""Where a broker is and who we are to it."""

from dataclasses import dataclass, field
from pathlib import Path

from fleet_contract import BrokerUrlError, exposure, parse_broker_url
from fleet_link.errors import AddressError
from fleet_link.tls import TlsFiles, read_secret


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAddress:
    """Where a broker is and who we are to it; its text shows no password."""

    host: str
    port: int = 1883
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: TlsFiles | None = None  # None: not encrypted
    is_nats: bool = False  # else MQTT

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def exposure(self) -> str | None:
        """What to warn of before anything is sent there; None if nobody on the way can read it."""
        return exposure(self.host, is_encrypted=self.tls is not None, has_password=self.password is not None)


def parse_broker(
    url: str, tls: TlsFiles | None = None, password_file: Path | None = None, *, may_be_nats: bool = False
) -> BrokerAddress:
    """Return the broker that ``mqtt[s]://[user[:password]@]host[:port]`` names.

    Parameters
    ----------
    tls :
        Certificates, for ``mqtts``; without them the system's authorities count and we show no certificate.
    password_file :
        Holds the password in place of the URL; readable for its owner only.
    may_be_nats :
        Whether ``nats://`` and ``nats+tls://`` are brokers, too.

    Raises
    ------
    AddressError
        If the text is no such address; the message does not repeat it, since it may hold a password.
    """
    try:
        parts = parse_broker_url(url, may_be_nats=may_be_nats)
    except BrokerUrlError as exc:
        raise AddressError(str(exc)) from exc
    if tls not in {None, TlsFiles()} and not parts.is_encrypted:
        raise AddressError("certificates need a broker at mqtts://" + (" or nats+tls://" if may_be_nats else ""))
    return BrokerAddress(
        host=parts.host,
        port=parts.port,
        username=parts.username,
        password=parts.password if password_file is None else read_secret(password_file),
        tls=(tls or TlsFiles()) if parts.is_encrypted else None,
        is_nats=parts.is_nats,
    )
