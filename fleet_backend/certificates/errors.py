"""What stops the making of certificates."""


class CertificateError(Exception):
    """A certificate cannot be made; the text says why."""
