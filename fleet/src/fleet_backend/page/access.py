"""Who may read and who may change: everybody reads, or, behind a proxy that logs people in, each by role."""

import hashlib
import hmac
import re
import secrets
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

from fleet_backend.errors import ConfigError, ForbiddenError, LoginError
from fleet_link import AddressError, read_secret

ANYBODY = "*"  # in a list of names: whoever the proxy has logged in
_LONGEST_NAME: Final = 200


class Role(IntEnum):
    """What somebody may do; each may what those before it may."""

    VIEWER = 1  # reads
    WORKSHOP = 2  # acknowledges alarms


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewer:
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
    proxy: Proxy | None = None  # without one nobody logs in, and everybody reads
    roles: Mapping[str, Role] = field(default_factory=dict)
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


def is_name(name: str) -> bool:
    """Return whether this can be the name of somebody."""
    return 0 < len(name) <= _LONGEST_NAME and name.isprintable()


def check_role(viewer: Viewer, role: Role) -> None:
    """Raise ForbiddenError unless somebody has at least a role."""
    if viewer.role < role:
        raise ForbiddenError(f"this takes the role {role.name.lower()}")


def check_token(viewer: Viewer, token: str) -> None:
    """Raise ForbiddenError unless a change was asked for on one of our own pages."""
    if not viewer.token or not hmac.compare_digest(viewer.token.encode(), token.encode()):
        raise ForbiddenError("this form is no longer valid; open it again")


_HEADER: Final = re.compile(r"[A-Za-z][A-Za-z0-9-]{0,63}")
_LEAST_SECRET: Final = 24
_TABLES: Final = {"host_names": list, "proxy": dict, "roles": dict}
_PROXY: Final = ("user_header", "secret_header", "secret_file")


def read_access(path: Path) -> Access:
    """Return who may do what; raises ConfigError, naming the first thing that is wrong."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as exc:
        raise ConfigError(f"{path}: cannot be read: {exc}") from exc
    try:
        return _access(table, path.parent)
    except ConfigError as exc:
        raise ConfigError(f"{path}: {exc}") from exc


def _access(table: Mapping[str, Any], folder: Path) -> Access:
    for name, kind in _TABLES.items():
        if not isinstance(table.get(name), kind) or not table[name]:
            raise ConfigError(f"needs {name}, which is not empty")
    _refuse_others(table, tuple(_TABLES))
    return Access(
        host_names=tuple(name.casefold() for name in _texts("host_names", table["host_names"])),
        proxy=_proxy(table["proxy"], folder),
        roles=_roles(table["roles"]),
    )


def _proxy(table: Mapping[str, Any], folder: Path) -> Proxy:
    _refuse_others(table, _PROXY)
    words = [table.get(name) for name in _PROXY]
    if not all(isinstance(word, str) and word for word in words):
        raise ConfigError(f"proxy needs {', '.join(_PROXY)}")
    user, secret_header, file = map(str, words)
    if (
        not _HEADER.fullmatch(user)
        or not _HEADER.fullmatch(secret_header)
        or user.casefold() == secret_header.casefold()
    ):
        raise ConfigError("proxy: user_header and secret_header must be names of two headers")
    return Proxy(user_header=user, secret_header=secret_header, secret=_secret(folder / file))


def _secret(path: Path) -> str:
    try:
        secret = read_secret(path)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    if len(secret.encode()) < _LEAST_SECRET:
        raise ConfigError(f"{path.name}: a secret must have {_LEAST_SECRET} bytes or more")
    return secret


def _roles(table: Mapping[str, Any]) -> dict[str, Role]:
    """Return the role of each name; of several the highest counts."""
    _refuse_others(table, tuple(role.name.lower() for role in Role))
    return {
        name.casefold(): role
        for role in sorted(Role)
        for name in _texts(f"roles.{role.name.lower()}", table.get(role.name.lower(), []))
    }


def _texts(name: str, values: object) -> list[str]:
    if not isinstance(values, list) or not all(isinstance(one, str) and one and one.isprintable() for one in values):
        raise ConfigError(f"{name} must be a list of texts")
    return values


def _refuse_others(table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for name in table:
        if name not in known:
            raise ConfigError(f"{name!r} is unknown; known are {', '.join(known)}")
