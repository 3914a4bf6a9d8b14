"""Errors of a connection to a broker; each subclass says what the caller does next."""


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
