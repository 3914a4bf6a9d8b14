"""What the page answers where it cannot answer; each is one line for the reader and one status for programs."""

from typing import ClassVar

from fleet_backend.errors import FleetBackendError


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


class BusyError(PageError, status=503, title="Too many readers"):
    """There are too many readers at once: come back later."""


class LoginError(PageError, status=401, title="You are not logged in"):
    """Nobody knows who asks: log in."""


class ForbiddenError(PageError, status=403, title="You are not allowed to do this"):
    """Whoever asks may not do this."""
