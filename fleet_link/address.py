"""The address of a broker, credentials and TLS files, which are read anew for each connection."""

import ssl
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from clutchdiag_io.files import check_plain_file

MAX_SECRET_BYTES: Final = 64 * 1024
_OTHERS: Final = 0o077  # permission bits of group and world
_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_NATS_PORTS: Final = {"nats": 4222, "nats+tls": 4222}
_ENCRYPTED: Final = frozenset({"mqtts", "nats+tls"})
_FORM: Final = "the broker must be mqtt[s]://[user[:password]@]host[:port]"


class LinkError(Exception):
    """Root of all errors raised by this package; its text is one clear line for the user."""


class AddressError(LinkError):
    """The broker's address, a certificate or a secret cannot be used: correct it."""


class LinkDownError(LinkError):
    """The broker is absent, silent, refuses us or has hung up: connect again later."""


class VersionRefusedError(LinkDownError):
    """The broker does not speak this version of MQTT: try another."""


class MessageRefusedError(LinkDownError):
    """The broker says no to a message."""


def check_secret_mode(path: Path) -> None:
    """Raise AddressError if a file that holds a secret is missing or open to others than its owner."""
    try:
        mode = path.stat().st_mode
    except OSError as exc:
        raise AddressError(f"cannot read {path}: {exc.strerror}") from exc
    if mode & _OTHERS:
        raise AddressError(f"{path} holds a secret and may be read by others: chmod 600 {path}")


def read_secret(path: Path) -> str:
    """Return the secret in a file, without the end of its line; raises AddressError."""
    check_secret_mode(path)
    try:
        check_plain_file(path, MAX_SECRET_BYTES)
        return path.read_text(encoding="utf-8").rstrip("\r\n")
    except OSError as exc:
        raise AddressError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except UnicodeDecodeError as exc:
        raise AddressError(f"cannot read {path}: it is not UTF-8 text") from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsFiles:
    """Where the certificates are; without ``authority`` the system's own count."""

    authority: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        if (self.certificate is None) is not (self.key is None):
            raise AddressError("a certificate needs its key, and a key its certificate")

    def context(self, *, is_key_private: bool = True) -> ssl.SSLContext:
        """Return a context for one connection: TLS 1.2 or newer, the broker's name checked.

        Parameters
        ----------
        is_key_private :
            Whether a key that others may read is refused.

        Raises
        ------
        AddressError
            If a file is missing, unreadable, no certificate, or a key that others may read.
        """
        try:
            if self.authority is not None:
                check_plain_file(self.authority)
            context = ssl.create_default_context(cafile=self.authority)
            context.minimum_version = ssl.TLSVersion.TLSv1_2
            context.sslsocket_class = _ClosingSocket
            if self.certificate is not None and self.key is not None:
                if is_key_private:
                    check_secret_mode(self.key)
                check_plain_file(self.key)
                check_plain_file(self.certificate)
                context.load_cert_chain(self.certificate, self.key)
        except ssl.SSLError as exc:
            raise AddressError(f"certificate or key cannot be used: {exc.reason or exc} ({self._names})") from exc
        except OSError as exc:
            raise AddressError(f"certificate or key cannot be read: {exc.strerror} ({self._names})") from exc
        return context

    def fingerprint(self) -> tuple[tuple[int, int, int] | None, ...]:
        """Return what changes when a file is replaced."""
        return tuple(_stamp(path) for path in self._paths)

    @property
    def _paths(self) -> list[Path]:
        return [path for path in (self.authority, self.certificate, self.key) if path is not None]

    @property
    def _names(self) -> str:
        return ", ".join(map(str, self._paths))


class _ClosingSocket(ssl.SSLSocket):
    """A socket that closes itself after a failed handshake; paho-mqtt leaves it open."""

    def do_handshake(self, block: bool = False) -> None:  # noqa: FBT001, FBT002 - signature of ssl
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAddress:
    """Address of a broker and our credentials; its text shows no password."""

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
        if self.tls is not None or _is_this_machine(self.host):
            return None
        what = "results" if self.password is None else "results and the broker's password"
        return f"{what} go to {self.host} unencrypted: anyone on the way can read them; mqtts:// encrypts"


def _is_this_machine(host: str) -> bool:
    """Return whether a host is this machine's loopback interface, by its name or address alone."""
    try:
        address = ip_address(host.partition("%")[0])
    except ValueError:
        name = host.casefold().rstrip(".")
        return name == "localhost" or name.endswith(".localhost")
    mapped = getattr(address, "ipv4_mapped", None)
    return address.is_loopback or (mapped is not None and mapped.is_loopback)


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
        parts = urlsplit(url)
        port = parts.port
    except ValueError:  # its text quotes what it takes for the port, which may be half a password
        raise AddressError(f"{_FORM}, with %-escapes in the password and a port up to 65535") from None
    ports = _PORTS | _NATS_PORTS if may_be_nats else _PORTS
    if parts.scheme not in ports or not parts.hostname or parts.path.strip("/") or parts.query or parts.fragment:
        raise AddressError(_FORM)
    if port == 0:
        raise AddressError(f"{_FORM}: 0 is not a port")
    try:
        parts.hostname.encode("idna")
    except UnicodeError:
        raise AddressError(f"{_FORM}: a part of the host's name is empty or too long") from None
    is_encrypted, password = parts.scheme in _ENCRYPTED, parts.password
    if tls not in {None, TlsFiles()} and not is_encrypted:
        raise AddressError("certificates need a broker at mqtts://" + (" or nats+tls://" if may_be_nats else ""))
    if password_file is not None:
        password = read_secret(password_file)
    elif password is not None:
        password = unquote(password)
    return BrokerAddress(
        host=parts.hostname,
        port=port or ports[parts.scheme],
        username=None if parts.username is None else unquote(parts.username),
        password=password,
        tls=(tls or TlsFiles()) if is_encrypted else None,
        is_nats=parts.scheme in _NATS_PORTS,
    )
