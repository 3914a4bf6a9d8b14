"""Errors of the fleet backend; each subclass says what the caller does next."""


class FleetBackendError(Exception):
    """Root of all errors raised by this package; its text is one clear line for the user."""


class ConfigError(FleetBackendError):
    """The command line or a file it names cannot be used: correct it and start again."""


class ExtraMissingError(ConfigError):
    """A library that only an extra brings is not installed: install it."""

    def __init__(self, module: str, extra: str) -> None:
        super().__init__(f"the module {module} is not installed: pip install './fleet[{extra}]' in the checkout")


class UnknownVehicleError(FleetBackendError):
    """Nothing was ever heard of a vehicle: correct its name."""


class BrokerError(FleetBackendError):
    """The broker is absent, silent or refuses us: connect again later."""


class CarrierError(FleetBackendError):
    """A message of an alarm could not be delivered now: try again later."""


class DatabaseError(FleetBackendError):
    """The database cannot be used as it is (wrong schema, no rights): a person has to look at it."""


class DatabaseAwayError(DatabaseError):
    """The database does not answer now: try again, nothing was stored."""


class RowRefusedError(DatabaseError):
    """The database does not take these values: keep the message aside, it fails again."""
