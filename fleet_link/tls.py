"""TLS to a broker: files that are read anew for every connection: a certificate is renewed without a restart."""

import ssl
from dataclasses import dataclass
from pathlib import Path

from canlog.files import check_plain_file
from fleet_link.errors import AddressError
from fleet_link.secret_files import check_secret_mode


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsFiles:
    """Where the certificates are; without ``authority`` the system's own count."""

    authority: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        """Check that certificate and key come together."""
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
    """A socket that is not left open when the peer turns out to be another; paho-mqtt forgets about it."""

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
