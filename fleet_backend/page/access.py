"""Who may read and who may change: without a login everybody reads; behind a proxy that logs people in, by role."""

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from fleet_backend.page.errors import ForbiddenError, LoginError

ANYBODY = "*"  # in a list of names: whoever the proxy has logged in
_LONGEST_NAME = 200


class Role(IntEnum):
    """What somebody may do; each may what those before it may."""

    VIEWER = 1  # reads
    WORKSHOP = 2  # acknowledges alarms
    ADMIN = 3  # reads who changed what


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewer:
    """Who asks."""

    name: str | None
    role: Role
    token: str = field(default="", repr=False)  # goes with every change, so that no other site can ask for one


NOBODY = Viewer(name=None, role=Role.VIEWER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proxy:
    """A proxy in front of the page that logs people in and says in headers who they are."""

    user_header: str
    secret_header: str
    secret: str = field(repr=False)  # that only the proxy knows: what comes past it has no say


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may do what."""

    host_names: tuple[str, ...] = ()
    proxy: Proxy | None = None  # None: nobody logs in, and everybody reads
    roles: Mapping[str, Role] = field(default_factory=dict)
    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)  # of tokens; dies with the process

    def viewer_of(self, headers: Mapping[str, str]) -> Viewer:
        """Return who asks.

        Raises
        ------
        LoginError
            If the proxy did not say who it is, or it was not the proxy who said so.
        ForbiddenError
            If whoever it is has no role here.
        """
        if self.proxy is None:
            return NOBODY
        said = headers.get(self.proxy.secret_header, "").encode()
        if not hmac.compare_digest(said, self.proxy.secret.encode()):
            raise LoginError("this did not come through the proxy that logs people in")
        name = headers.get(self.proxy.user_header, "")
        if not 0 < len(name) <= _LONGEST_NAME or not name.isprintable():
            raise LoginError("the proxy did not say who this is")
        role = self.roles.get(name.casefold(), self.roles.get(ANYBODY))
        if role is None:
            raise ForbiddenError(f"{name} has no role here")
        return Viewer(name=name, role=role, token=self.token_of(name))

    def token_of(self, name: str) -> str:
        """Return what goes with every change that somebody asks for."""
        return hmac.new(self.key, name.encode(), hashlib.sha256).hexdigest()


def check_role(viewer: Viewer, role: Role) -> None:
    """Raise ForbiddenError unless somebody has at least a role."""
    if viewer.role < role:
        raise ForbiddenError(f"this takes the role {role.name.lower()}")


def check_token(viewer: Viewer, token: str) -> None:
    """Raise ForbiddenError unless a change was asked for on one of our own pages."""
    if not viewer.token or not hmac.compare_digest(viewer.token.encode(), token.encode()):
        raise ForbiddenError("this form is of another page or of an earlier run of the server; open it again")
