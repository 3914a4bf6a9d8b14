"""The file that says who may do what: checked once, when the server starts."""

import re
import tomllib
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from fleet_backend.errors import ConfigError, ExtraMissingError
from fleet_backend.page.access import Access, Login, Proxy, Role
from fleet_link import AddressError, read_secret

_HEADER: Final = re.compile(r"[A-Za-z][A-Za-z0-9-]{0,63}")
_LEAST_SECRET: Final = 24
_TABLES: Final = {"host_names": list, "roles": dict}
_WAYS: Final = ("proxy", "oidc")
_OIDC: Final = ("issuer", "client_id", "client_secret_file", "url")
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
    ways = [name for name in _WAYS if isinstance(table.get(name), dict)]
    if len(ways) != 1:
        raise ConfigError(f"needs one of {' and '.join(_WAYS)}")
    _refuse_others(table, (*_TABLES, *_WAYS))
    names = tuple(one.casefold() for one in _texts("host_names", table["host_names"]))
    return Access(
        host_names=names,
        proxy=_proxy(table["proxy"], folder) if ways == ["proxy"] else None,
        login=_login(table["oidc"], folder, names) if ways == ["oidc"] else None,
        roles=_roles(table["roles"]),
    )


def _login(table: Mapping[str, Any], folder: Path, host_names: tuple[str, ...]) -> Login:
    _refuse_others(table, (*_OIDC, "name_claim"))
    words = [table.get(name) for name in (*_OIDC, "name_claim")]
    if not all(isinstance(word, str) and word for word in words[:-1]) or not isinstance(words[-1], str | None):
        raise ConfigError(f"oidc needs {', '.join(_OIDC)}")
    issuer, client_id, file, url = map(str, words[:-1])
    try:
        oidc = import_module("fleet_backend.page.oidc")
    except ModuleNotFoundError as exc:
        raise ExtraMissingError(str(exc.name), extra="oidc") from exc
    parts = urlsplit(url)
    if not oidc.is_safe(url) or not oidc.is_safe(issuer) or parts.path.strip("/") or parts.query:
        raise ConfigError("oidc: issuer and url must be https://host, or http:// for this machine alone")
    if (parts.hostname or "").casefold() not in host_names:
        raise ConfigError("oidc: the host of url must be one of host_names")
    client = oidc.Client(
        issuer=issuer,
        client_id=client_id,
        secret=_secret(folder / file),
        return_address=f"{parts.scheme}://{parts.netloc}/login/return",
        name_claim=str(words[-1] or "email"),
    )
    return Login(provider=oidc.OpenIdProvider(client), is_secure=parts.scheme == "https")


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
