"""Rights: without a proxy everybody reads; behind a proxy that logs people in, each has the rights of a role."""

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from fleet_backend.errors import BackendConfigError, ForbiddenError, LoginError
from fleet_link import AddressError, read_secret

ANYBODY = "*"  # in a list of names: whoever the proxy has logged in
_LONGEST_NAME: Final = 200


class UserRole(IntEnum):
    """Rights of a user; each role has those of the roles before it."""

    VIEWER = 1  # reads
    WORKSHOP = 2  # acknowledges alarms


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewer:
    name: str | None
    role: UserRole
    token: str = field(default="", repr=False)  # goes with every change, so that no other site can ask for one


NOBODY = Viewer(name=None, role=UserRole.VIEWER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proxy:
    """A proxy in front of the page that logs people in and says in headers who they are."""

    user_header: str
    secret_header: str
    secret: str = field(repr=False)  # of the proxy alone: requests without it are not logged in


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may do what."""

    host_names: tuple[str, ...] = ()
    proxy: Proxy | None = None  # without one nobody logs in, and everybody reads
    roles: Mapping[str, UserRole] = field(default_factory=dict)
    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)  # of tokens; dies with the process

    def viewer_of(self, headers: Mapping[str, str]) -> Viewer:
        """Return who asks.

        Raises
        ------
        LoginError
            If nobody has logged in, or it was not the proxy who said so.
        ForbiddenError
            If whoever it is has no role here.
        """
        if self.proxy is None:
            return NOBODY
        secret = headers.get(self.proxy.secret_header, "").encode()
        if not hmac.compare_digest(secret, self.proxy.secret.encode()):
            raise LoginError("this request did not come through the login proxy")
        name = headers.get(self.proxy.user_header, "")
        if not 0 < len(name) <= _LONGEST_NAME or not name.isprintable():
            raise LoginError("the proxy did not name the user")
        role = self.roles.get(name.casefold(), self.roles.get(ANYBODY))
        if role is None:
            raise ForbiddenError(f"{name} has no role here")
        return Viewer(name=name, role=role, token=self.token_of(name))

    def token_of(self, name: str) -> str:
        """Return what goes with every change that somebody asks for."""
        return hmac.new(self.key, name.encode(), hashlib.sha256).hexdigest()


_LEAST_SECRET: Final = 24
_Name = Annotated[str, Meta(min_length=1, max_length=_LONGEST_NAME)]
_Header = Annotated[str, Meta(pattern="^[A-Za-z][A-Za-z0-9-]{0,63}$")]


class _ProxyTable(msgspec.Struct, forbid_unknown_fields=True):
    user_header: _Header
    secret_header: _Header
    secret_file: _Name


class _RolesTable(msgspec.Struct, forbid_unknown_fields=True):
    viewer: list[_Name] = []
    workshop: list[_Name] = []


class _AccessFile(msgspec.Struct, forbid_unknown_fields=True):
    host_names: Annotated[list[_Name], Meta(min_length=1)]
    proxy: _ProxyTable
    roles: _RolesTable


def read_access(path: Path) -> Access:
    """Return who may do what; raises ConfigError, naming the first thing that is wrong."""
    try:
        content = msgspec.toml.decode(path.read_bytes(), type=_AccessFile)
    except OSError as exc:
        raise BackendConfigError(f"cannot read {path}: {exc.strerror}") from exc
    except ValueError as exc:
        raise BackendConfigError(f"{path}: {exc}") from exc
    proxy, roles = content.proxy, {UserRole.VIEWER: content.roles.viewer, UserRole.WORKSHOP: content.roles.workshop}
    if proxy.user_header.casefold() == proxy.secret_header.casefold():
        raise BackendConfigError(f"{path}: user_header and secret_header must be names of two headers")
    try:
        secret = read_secret(path.parent / proxy.secret_file)
    except AddressError as exc:
        raise BackendConfigError(f"{path}: {exc}") from exc
    if len(secret.encode()) < _LEAST_SECRET:
        raise BackendConfigError(f"{path}: {proxy.secret_file}: a secret must have {_LEAST_SECRET} bytes or more")
    return Access(
        host_names=tuple(name.casefold() for name in content.host_names),
        proxy=Proxy(user_header=proxy.user_header, secret_header=proxy.secret_header, secret=secret),
        roles={name.casefold(): role for role in sorted(roles) for name in roles[role]},  # of several the highest
    )
