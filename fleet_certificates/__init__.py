"""Certificates for a fleet under test: an authority, a broker's certificate, and one per vehicle, made and renewed."""

from fleet_certificates.authority import Authority, Lifetime
from fleet_certificates.errors import CertificateError

__all__ = ["Authority", "CertificateError", "Lifetime"]
