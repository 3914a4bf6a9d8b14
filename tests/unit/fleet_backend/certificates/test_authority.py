"""Certificates are what a peer expects, renewed whole, and their keys are nobody else's."""

import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from fleet_backend.certificates.authority import Authority, Lifetime
from fleet_backend.certificates.cli import main
from fleet_backend.errors import CertificateError

NOW = datetime(2026, 1, 1, tzinfo=UTC)
A_YEAR = Lifetime.of_days(365, NOW)


@pytest.fixture(name="authority")
def _authority(tmp_path: Path) -> Authority:
    return Authority.make(tmp_path / "certificates", A_YEAR)


def certificate(authority: Authority, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((authority.folder / f"{name}.crt").read_bytes())


def test_a_client_is_known_by_its_common_name(authority: Authority) -> None:
    authority.issue_client("car1", Lifetime.of_days(90, NOW))
    found = certificate(authority, "car1")
    found.verify_directly_issued_by(certificate(authority, "ca"))
    assert found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == "car1"
    usage = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    assert found.not_valid_after_utc == NOW + timedelta(days=90)


def test_a_server_is_known_by_its_hosts(authority: Authority) -> None:
    authority.issue_server("broker", ["broker.example", "127.0.0.1"], A_YEAR)
    names = certificate(authority, "broker").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["broker.example"]
    assert [str(address) for address in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1"]


def test_keys_are_for_their_owner_and_fit_their_certificates(authority: Authority) -> None:
    authority.issue_client("car1", A_YEAR)
    for name in ("ca", "car1"):
        key = authority.folder / f"{name}.key"
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(authority.folder / f"{name}.crt", key)
    assert stat.S_IMODE(authority.folder.stat().st_mode) == 0o700


def test_a_certificate_is_renewed_with_a_key_of_its_own(authority: Authority) -> None:
    authority.issue_client("car1", A_YEAR)
    before = certificate(authority, "car1"), (authority.folder / "car1.key").read_bytes()
    Authority.open(authority.folder).issue_client("car1", A_YEAR)
    after = certificate(authority, "car1"), (authority.folder / "car1.key").read_bytes()
    assert before[0].serial_number != after[0].serial_number
    assert before[1] != after[1]
    assert sorted(path.name for path in authority.folder.iterdir()) == ["ca.crt", "ca.key", "car1.crt", "car1.key"]


def test_an_authority_is_not_made_twice(authority: Authority) -> None:
    with pytest.raises(CertificateError, match="has an authority already"):
        Authority.make(authority.folder, A_YEAR)


@pytest.mark.parametrize("name", ["ca", "", "../car1", ".car1"])
def test_what_is_no_name(authority: Authority, name: str) -> None:
    with pytest.raises(CertificateError, match="cannot be the name"):
        authority.issue_client(name, A_YEAR)


def test_the_commands_make_and_renew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "made")
    assert main(["client", "car1", "--folder", folder]) == 2
    assert "has no authority" in capsys.readouterr().err
    assert main(["init", "--folder", folder]) == 0
    assert main(["server", "broker", "--folder", folder]) == 2
    assert "needs a host name" in capsys.readouterr().err
    assert main(["server", "broker", "--host", "localhost", "--folder", folder]) == 0
    assert main(["client", "car1", "--folder", folder, "--days", "7"]) == 0
    assert main(["client", "car1", "--folder", folder, "--days", "7"]) == 0
