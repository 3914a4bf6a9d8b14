"""Errors of the fleet backend; each subclass says what the caller does next."""

from typing import ClassVar


class FleetBackendError(Exception):
    """Root of all errors raised by this package; its text is one clear line for the user."""


class BackendConfigError(FleetBackendError):
    """The command line or a file it names cannot be used: correct it and start again."""


class BackendExtraError(BackendConfigError):
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


class PageError(FleetBackendError):
    """Root of what a reader is told instead of an answer."""

    status: ClassVar[int]
    title: ClassVar[str]

    def __init_subclass__(cls, *, status: int, title: str) -> None:
        cls.status, cls.title = status, title


class AskError(PageError, status=400, title="This request is not valid"):
    """The question cannot be understood: correct its address."""


class NotFoundError(PageError, status=404, title="There is no such page"):
    """There is no such thing: look at another one."""


class BusyError(PageError, status=503, title="Too many answers are on their way"):
    """Others are slow to read: ask again soon."""


class LoginError(PageError, status=401, title="You are not logged in"):
    """Nobody knows who asks: log in."""


class ForbiddenError(PageError, status=403, title="You are not allowed to do this"):
    """Whoever asks may not do this."""
