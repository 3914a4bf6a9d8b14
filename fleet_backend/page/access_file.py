"""The file that says who may do what: checked once, when the server starts."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from fleet_backend.errors import ConfigError
from fleet_backend.page.access import Access, Proxy, Role
from fleet_link import AddressError, read_secret

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
    names = _texts("host_names", table["host_names"])
    return Access(
        host_names=tuple(one.casefold() for one in names),
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
    try:
        secret = read_secret(folder / file)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    if len(secret.encode()) < _LEAST_SECRET:
        raise ConfigError(f"{file}: a secret must have {_LEAST_SECRET} bytes or more")
    return Proxy(user_header=user, secret_header=secret_header, secret=secret)


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
