"""Who may read and who may change: without a login everybody reads; with one, or behind a proxy with one, by role."""

import hashlib
import hmac
import json
import re
import secrets
import threading
import time
import tomllib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from fleet_backend.errors import ConfigError, ExtraMissingError
from fleet_backend.page.errors import ForbiddenError, LoginError
from fleet_link import AddressError, read_secret

SESSION_S: Final = 12 * 3600.0
ATTEMPT_S: Final = 600.0
MOST_SESSIONS: Final = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """A login that has begun; the browser that began it keeps this, signed by us, and no other can end it."""

    state: str
    nonce: str = field(repr=False)
    verifier: str = field(repr=False)  # of the code that the provider will give (PKCE)
    where: str  # is to be seen afterwards
    until_s: float  # since the epoch

    @classmethod
    def begin(cls, where: str, now_s: float) -> "Attempt":
        state, nonce, verifier = (secrets.token_urlsafe(48) for _ in range(3))
        return cls(state=state, nonce=nonce, verifier=verifier, where=where, until_s=now_s + ATTEMPT_S)

    def sealed(self, key: bytes) -> str:
        """Return it as the value of a cookie."""
        content = json.dumps(asdict(self)).encode().hex()  # no character that a cookie would have to quote
        return f"{content}.{_seal(key, content)}"

    @classmethod
    def unsealed(cls, word: str, key: bytes, now_s: float) -> "Attempt | None":
        """Return what a cookie holds; None if we did not make it, or not just now."""
        content, _, seal = word.rpartition(".")
        if not hmac.compare_digest(seal.encode(), _seal(key, content).encode()):
            return None
        attempt = cls(**json.loads(bytes.fromhex(content)))
        return attempt if now_s < attempt.until_s else None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Session:
    name: str
    until_s: float


class Sessions:
    """The sessions of this run of the server, by keys that nobody can guess; a key is never taken from a browser."""

    def __init__(self, clock: Callable[[], float] = time.time, most: int = MOST_SESSIONS) -> None:
        self.clock = clock  # seconds since the epoch
        self._most = most
        self._open: OrderedDict[str, _Session] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, name: str) -> str:
        """Return the key of a new session; of too many the oldest ends."""
        key = secrets.token_urlsafe(48)
        with self._lock:
            self._open[key] = _Session(name=name, until_s=self.clock() + SESSION_S)
            while len(self._open) > self._most:
                self._open.popitem(last=False)
        return key

    def name_of(self, key: str) -> str | None:
        """Return whose session this is, None if there is none any more."""
        found = self._open.get(key)
        if found is None:
            return None
        if self.clock() < found.until_s:
            return found.name
        self.end(key)
        return None

    def end(self, key: str) -> None:
        with self._lock:
            self._open.pop(key, None)


def _seal(key: bytes, content: str) -> str:
    return hmac.new(key, b"login " + content.encode(), hashlib.sha256).hexdigest()


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

    def address(self, *, state: str, nonce: str, verifier: str) -> str:
        """Return where a browser logs in, to begin an attempt."""

    def name(self, code: str, *, nonce: str, verifier: str) -> str:
        """Return who ended that attempt with a code; raises LoginError."""


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
    def exposure(self) -> str | None:
        """What an owner may not have meant; None: nothing."""
        if self.login is None or ANYBODY not in self.roles:
            return None
        role = self.roles[ANYBODY].name.lower()
        return f'{role} = ["{ANYBODY}"]: everybody with an account at the login provider is {role}'

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
            key = cookie_in(headers, self.login.session_cookie)
            person = self.login.sessions.name_of(key)
            if person is None:
                raise LoginError("you are not logged in, or your login has expired")
            token = self.token_of(f"session {key}")
            return Viewer(name=person, role=self.role_of(person), token=token, has_session=True)
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
    _refuse_others(table, (*_OIDC, "name_claim", "has_verified_emails"))
    has_verified_emails = table.get("has_verified_emails", False)
    if not isinstance(has_verified_emails, bool):
        raise ConfigError("oidc: has_verified_emails must be true or false")
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
        has_verified_emails=has_verified_emails,
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
