"""Errors of the shared physics; each subclass says what the caller does next."""


class ClutchModelError(Exception):
    """Root of all errors raised by this package."""


class CalibrationError(ClutchModelError):
    """A calibration is unreadable or outside its physical range: stop and correct the file."""


class DomainError(ClutchModelError):
    """A law was called outside its domain: fix the calling code."""
