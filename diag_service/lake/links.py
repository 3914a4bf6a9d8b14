"""Connections of a cluster: TLS both ways or none at all."""

import socket
import ssl
from dataclasses import dataclass
from typing import Any, Final, Self
from urllib.parse import urlsplit

from canlog.extras import load_extra
from diag_service.errors import ConfigError, StoreError
from fleet_link import AddressError, TlsFiles

SCHEME: Final = "tls"
DEFAULT_PORT: Final = 8786
LOOPBACK: Final = "127.0.0.1"
CONNECT_TIMEOUT_S: Final = 10.0


def load_distributed() -> Any:  # noqa: ANN401 - an untyped library
    """Return Dask's ``distributed``; raises ExtraMissingError if it is not installed."""
    return load_extra("distributed", "a cluster needs Dask", "cluster")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterAddress:
    """Where a scheduler is, and who we are to it.

    Whoever reaches a scheduler can have any program run by its workers, so nobody does without a certificate of the
    authority, not even on the same machine.
    """

    host: str
    port: int
    tls: TlsFiles

    @classmethod
    def parse(cls, text: str, tls: TlsFiles) -> Self:
        """Return what ``tls://HOST:PORT`` names; raises ConfigError if it is anything else, or a file is missing."""
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
        except ValueError as exc:
            raise ConfigError(f"{text} is not an address of a scheduler: {exc}") from exc
        if parts.scheme != SCHEME:
            raise ConfigError(
                f"{text}: a scheduler is reached by {SCHEME}:// only, because its workers run what they are sent"
            )
        if not host or parts.username or parts.path.strip("/") or parts.query:
            raise ConfigError(f"{text} is not an address of a scheduler, which is {SCHEME}://HOST:PORT")
        check_identity(tls)
        return cls(host=host, port=port or DEFAULT_PORT, tls=tls)

    @property
    def url(self) -> str:
        """The address as Dask writes it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{SCHEME}://{host}:{self.port}"

    def check(self) -> None:
        """Connect and hang up again.

        Raises StoreError if nobody is there, ConfigError if the one who is there is not who the authority vouches for,
        or does not take us.
        """
        try:
            context = self.tls.context()
            with (
                socket.create_connection((self.host, self.port), CONNECT_TIMEOUT_S) as plain,
                context.wrap_socket(plain, server_hostname=self.host) as secure,
            ):
                secure.recv(1)  # with TLS 1.3 a refused certificate is heard of only here
        except AddressError as exc:
            raise ConfigError(str(exc)) from exc
        except ssl.SSLError as exc:
            raise ConfigError(f"{self.url} is not trusted, or does not trust us: {exc.reason or exc}") from exc
        except OSError as exc:
            raise StoreError(f"no scheduler at {self.url}: {exc.strerror or exc}") from exc


def check_identity(tls: TlsFiles) -> None:
    """Raise ConfigError unless there are an authority, a certificate and its key, and all of them can be used."""
    if tls.authority is None or tls.certificate is None or tls.key is None:
        raise ConfigError("a cluster needs --ca, --cert and --key: fleet-certificates makes them")
    try:
        tls.context()
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc


def security(tls: TlsFiles) -> Any:  # noqa: ANN401 - an untyped library
    """Return the same for Dask, for whatever part it plays: only TLS, both sides with a certificate."""
    certificate, key = str(tls.certificate), str(tls.key)
    return load_distributed().Security(
        require_encryption=True,
        tls_ca_file=str(tls.authority),
        **{f"tls_{part}_cert": certificate for part in ("client", "scheduler", "worker")},
        **{f"tls_{part}_key": key for part in ("client", "scheduler", "worker")},
    )
