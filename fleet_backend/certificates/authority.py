"""A certificate authority in a folder, for tests and trials: its own key lies beside what it signs.

For each name there is ``NAME.crt`` (with everything a peer needs) and ``NAME.key`` (readable for its owner only); the
authority itself is ``ca``. Files are replaced whole, so a reader sees the old or the new one.
"""

import ipaddress
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from fleet_backend.errors import CertificateError

AUTHORITY: Final = "ca"
_CLOCK_SKEW: Final = timedelta(minutes=5)  # a vehicle's clock may be behind


@dataclass(frozen=True, slots=True, kw_only=True)
class Lifetime:
    """When a certificate holds; aware moments."""

    begin: datetime
    end: datetime

    @classmethod
    def of_days(cls, days: float, now: datetime) -> Self:
        """Return a lifetime that begins now and ends after so many days."""
        return cls(begin=now - _CLOCK_SKEW, end=now + timedelta(days=days))


class Authority:
    def __init__(self, folder: Path, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self.folder = folder
        self._key = key
        self._certificate = certificate

    @classmethod
    def make(cls, folder: Path, lifetime: Lifetime) -> Self:
        """Make an authority in a folder that has none.

        Raises CertificateError if there is one already, or the folder cannot be written.
        """
        if (folder / f"{AUTHORITY}.key").exists():
            raise CertificateError(f"{folder} has an authority already; a new one would make its certificates invalid")
        key, name = ec.generate_private_key(ec.SECP256R1()), _name("clutchdiag test authority")
        builder = _builder(name, name, key.public_key(), lifetime)
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        certificate = builder.add_extension(_usage(is_authority=True), critical=True).sign(key, hashes.SHA256())
        _write_pair(folder, AUTHORITY, key, certificate)
        return cls(folder, key, certificate)

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Return the authority of a folder; raises CertificateError if there is none."""
        try:
            key = serialization.load_pem_private_key((folder / f"{AUTHORITY}.key").read_bytes(), None)
            certificate = x509.load_pem_x509_certificate((folder / f"{AUTHORITY}.crt").read_bytes())
        except (OSError, ValueError) as exc:
            raise CertificateError(f"{folder} has no authority: {exc}") from exc
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise CertificateError(f"the authority in {folder} has a key of another kind")
        return cls(folder, key, certificate)

    def issue_server(self, name: str, hosts: Sequence[str], lifetime: Lifetime) -> None:
        """Make or renew the certificate of a broker that is reached at ``hosts``: names or addresses."""
        self._issue(name, lifetime, [ExtendedKeyUsageOID.SERVER_AUTH], _host_names("server", hosts))

    def issue_node(self, name: str, hosts: Sequence[str], lifetime: Lifetime) -> None:
        """Make or renew the certificate of a part of a cluster, which is reached at ``hosts`` and reaches others."""
        purposes = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        self._issue(name, lifetime, purposes, _host_names("node", hosts))

    def issue_client(self, name: str, lifetime: Lifetime) -> None:
        """Make or renew the certificate of a vehicle or a backend, whose common name is its identity."""
        self._issue(name, lifetime, [ExtendedKeyUsageOID.CLIENT_AUTH], None)

    def _issue(
        self,
        name: str,
        lifetime: Lifetime,
        purposes: Sequence[x509.ObjectIdentifier],
        hosts: x509.SubjectAlternativeName | None,
    ) -> None:
        if name == AUTHORITY or "/" in name or not name.isprintable() or not name or name.startswith("."):
            raise CertificateError(f"{name!r} cannot be the name of a certificate")
        key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder(_name(name), self._certificate.subject, key.public_key(), lifetime)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(_usage(is_authority=False), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        if hosts is not None:
            builder = builder.add_extension(hosts, critical=False)
        _write_pair(self.folder, name, key, builder.sign(self._key, hashes.SHA256()))


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host_names(whose: str, hosts: Sequence[str]) -> x509.SubjectAlternativeName:
    if not hosts:
        raise CertificateError(f"the certificate of a {whose} needs a host name")
    return x509.SubjectAlternativeName([_general_name(host) for host in hosts])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, lifetime: Lifetime
) -> x509.CertificateBuilder:
    return x509.CertificateBuilder(
        issuer_name=issuer,
        subject_name=subject,
        public_key=key,
        serial_number=x509.random_serial_number(),
        not_valid_before=lifetime.begin,
        not_valid_after=lifetime.end,
    )


def _usage(*, is_authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        encipher_only=False,
        decipher_only=False,
    )


def _write_pair(folder: Path, name: str, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _replace(folder / f"{name}.key", secret, 0o600)
        _replace(folder / f"{name}.crt", certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    except OSError as exc:
        raise CertificateError(f"cannot write {exc.filename}: {exc.strerror}") from exc


def _replace(path: Path, content: bytes, mode: int) -> None:
    """Put content where a file is or will be, whole; with its mode from the first moment on."""
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    fresh.unlink(missing_ok=True)
    descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        os.write(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    fresh.replace(path)
