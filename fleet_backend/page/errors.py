"""What the page answers where it cannot answer; each is one line for the reader and one status for programs."""

from typing import ClassVar

from fleet_backend.errors import FleetBackendError


class PageError(FleetBackendError):
    """Root of what a reader is told instead of an answer."""

    status: ClassVar[int] = 500
    title: ClassVar[str] = "This did not work"


class AskError(PageError):
    """The question cannot be understood: correct its address."""

    status = 400
    title = "This request is not valid"


class NotFoundError(PageError):
    """There is no such thing: look at another one."""

    status = 404
    title = "There is no such page"


class BusyError(PageError):
    """There are too many readers at once: come back later."""

    status = 503
    title = "Too many readers"


class ProviderAwayError(PageError):
    """Logging in is not possible now: come back later."""

    status = 503
    title = "Logging in is not possible now"


class LoginError(PageError):
    """Nobody knows who asks: log in."""

    status = 401
    title = "You are not logged in"


class ForbiddenError(PageError):
    """Whoever asks may not do this."""

    status = 403
    title = "You are not allowed to do this"
