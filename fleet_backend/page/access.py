"""Who may read and who may change: without a login everybody reads; with one, or behind a proxy with one, by role."""

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, Protocol

from fleet_backend.page.errors import ForbiddenError, LoginError
from fleet_backend.page.sessions import Attempt, Sessions

ANYBODY = "*"  # in a list of names: whoever the proxy has logged in
SESSION_COOKIE: Final = "fleet"
ATTEMPT_COOKIE: Final = "fleet-login"
_LONGEST_NAME: Final = 200


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
    has_session: bool = False  # of ours, which can be ended


NOBODY = Viewer(name=None, role=Role.VIEWER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proxy:
    """A proxy in front of the page that logs people in and says in headers who they are."""

    user_header: str
    secret_header: str
    secret: str = field(repr=False)  # that only the proxy knows: what comes past it has no say


class Provider(Protocol):
    """Logs people in."""

    def address(self, attempt: Attempt) -> str:
        """Return where a browser logs in."""

    def name(self, code: str, attempt: Attempt) -> str:
        """Return who logged in; raises LoginError."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Login:
    """A login of our own, by a provider that knows people."""

    provider: Provider
    sessions: Sessions = field(default_factory=Sessions)
    is_secure: bool  # whether browsers come by https

    @property
    def session_cookie(self) -> str:
        """The name of the cookie that holds the key of a session."""
        return self.cookie_name(SESSION_COOKIE)

    def cookie_name(self, name: str) -> str:
        """Return the name of a cookie; by https one that no other host of the domain can set."""
        return f"__Host-{name}" if self.is_secure else name


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may do what."""

    host_names: tuple[str, ...] = ()
    proxy: Proxy | None = None  # neither this nor the next: nobody logs in, and everybody reads
    login: Login | None = None
    roles: Mapping[str, Role] = field(default_factory=dict)
    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)  # of tokens; dies with the process

    @property
    def knows_people(self) -> bool:
        """Whether anybody logs in."""
        return self.proxy is not None or self.login is not None

    def viewer_of(self, headers: Mapping[str, str]) -> Viewer:
        """Return who asks.

        Raises
        ------
        LoginError
            If nobody has logged in, or it was not the proxy who said so.
        ForbiddenError
            If whoever it is has no role here.
        """
        if self.login is not None:
            return self._in_session(self.login, headers)
        if self.proxy is None:
            return NOBODY
        said = headers.get(self.proxy.secret_header, "").encode()
        if not hmac.compare_digest(said, self.proxy.secret.encode()):
            raise LoginError("this request did not come through the login proxy")
        name = headers.get(self.proxy.user_header, "")
        if not is_name(name):
            raise LoginError("the proxy did not name the user")
        return Viewer(name=name, role=self.role_of(name), token=self.token_of(name))

    def role_of(self, name: str) -> Role:
        """Return what somebody may do; raises ForbiddenError if nothing."""
        role = self.roles.get(name.casefold(), self.roles.get(ANYBODY))
        if role is None or not is_name(name):
            raise ForbiddenError(f"{name[:_LONGEST_NAME]} has no role here")
        return role

    def token_of(self, name: str) -> str:
        """Return what goes with every change that somebody asks for."""
        return hmac.new(self.key, name.encode(), hashlib.sha256).hexdigest()

    def _in_session(self, login: Login, headers: Mapping[str, str]) -> Viewer:
        key = cookie_in(headers, login.session_cookie)
        name = login.sessions.name_of(key)
        if name is None:
            raise LoginError("you are not logged in, or your login has expired")
        return Viewer(name=name, role=self.role_of(name), token=self.token_of(f"session {key}"), has_session=True)


def is_name(name: str) -> bool:
    """Return whether this can be the name of somebody."""
    return 0 < len(name) <= _LONGEST_NAME and name.isprintable()


def cookie_in(headers: Mapping[str, str], name: str) -> str:
    """Return the value of a cookie, empty if there is none, or two of one name: then somebody else set one of them."""
    pairs = (part.strip().partition("=") for part in headers.get("cookie", "").split(";"))
    values = [value for key, _, value in pairs if key == name]
    return values[0] if len(values) == 1 else ""


def check_role(viewer: Viewer, role: Role) -> None:
    """Raise ForbiddenError unless somebody has at least a role."""
    if viewer.role < role:
        raise ForbiddenError(f"this takes the role {role.name.lower()}")


def check_token(viewer: Viewer, token: str) -> None:
    """Raise ForbiddenError unless a change was asked for on one of our own pages."""
    if not viewer.token or not hmac.compare_digest(viewer.token.encode(), token.encode()):
        raise ForbiddenError("this form is no longer valid; open it again")
