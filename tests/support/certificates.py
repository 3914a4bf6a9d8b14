"""Certificates and entries at a broker, made by the commands that docs/operations.md shows."""

import shlex
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from fleet_link import TlsFiles
from tests.support.documents import block_lines

PAGE = "docs/operations.md"
_LINES = [shown.line for shown in block_lines(PAGE)]


def play(folder: Path, shown: str, name: str = "") -> None:
    """Run the command that shows a word, with a name in the place of CAR1."""
    (line,) = (line for line in _LINES if shown in line)
    command = shlex.split(line.replace("CAR1", name))
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)


def certify(folder: Path, *names: str) -> Path:
    """Make or renew certificates, and an authority where there is none; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "ca.key").exists():
        play(folder, "/CN=fleet authority")
    for name in names:
        play(folder, f"/CN={name}" if name in {"broker", "node1"} else "/CN=CAR1", name)
    return folder


def expire(folder: Path, name: str) -> None:
    """Date a certificate back by two days: the openssl of Debian 12 makes none that is over."""
    path, end = folder / f"{name}.crt", datetime.now(UTC) - timedelta(days=1)
    key = load_pem_private_key((folder / "ca.key").read_bytes(), None)
    assert isinstance(key, EllipticCurvePrivateKey)
    old = x509.load_pem_x509_certificate(path.read_bytes())
    builder = x509.CertificateBuilder(
        issuer_name=old.issuer,
        subject_name=old.subject,
        public_key=old.public_key(),
        serial_number=old.serial_number,
        not_valid_before=end - timedelta(days=1),
        not_valid_after=end,
        extensions=list(old.extensions),
    )
    path.write_bytes(builder.sign(key, SHA256()).public_bytes(Encoding.PEM))


def tls_files(folder: Path, name: str | None) -> TlsFiles:
    """Return where one's files are; without a name those of somebody without a certificate."""
    if name is None:
        return TlsFiles(authority=folder / "ca.crt")
    return TlsFiles(authority=folder / "ca.crt", certificate=folder / f"{name}.crt", key=folder / f"{name}.key")


def tls_words(folder: Path, name: str) -> tuple[str, ...]:
    """Return the options that name one's files."""
    files = tls_files(folder, name)
    return ("--ca", str(files.authority), "--cert", str(files.certificate), "--key", str(files.key))
