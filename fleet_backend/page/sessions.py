"""Who has logged in: sessions that only a login begins, and what a login needs to know when it comes back."""

import hashlib
import hmac
import json
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Final

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
        """Return a new one."""
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
