"""TLS between tester and entity (ISO 13400-2:2019): which certificate an entity shows, and where."""

import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canlog.files import check_plain_file
from ecu_emulator.errors import ConfigError

LARGEST_PORT: Final = 65535


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsNode:
    """Where an entity speaks TLS, and the files (PEM) by which testers know it."""

    certificate: Path
    key: Path | None  # None: it is in the file of the certificate
    port: int

    def context(self) -> ssl.SSLContext:
        """Return what connections are made with: TLS 1.2 or newer, as the standard has it.

        Raises
        ------
        ConfigError
            If a file cannot be read, or is no certificate or the wrong key.
        """
        files = ", ".join(str(path) for path in (self.certificate, self.key) if path is not None)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            for path in (self.certificate, self.key):
                if path is not None:
                    check_plain_file(path)
            context.load_cert_chain(self.certificate, self.key, password="")  # or a terminal would be asked
        except ssl.SSLError as exc:
            raise ConfigError(f"certificate or key cannot be used: {exc.reason or exc} ({files})") from exc
        except OSError as exc:
            raise ConfigError(f"certificate or key cannot be read: {exc.strerror or exc} ({files})") from exc
        return context


def tls_node(certificate: Path | None, key: Path | None, port: int) -> TlsNode | None:
    """Return how TLS is spoken, as the command line says; None if it is not.

    Raises
    ------
    ConfigError
        If there is a key without a certificate, or the port is none.
    """
    if certificate is None:
        if key is not None:
            raise ConfigError("--doip-key needs --doip-certificate")
        return None
    if not 1 <= port <= LARGEST_PORT:
        raise ConfigError(f"--doip-tls-port must be 1..{LARGEST_PORT}, got {port}")
    return TlsNode(certificate=certificate, key=key, port=port)
