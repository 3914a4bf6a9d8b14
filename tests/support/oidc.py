"""A provider of logins for tests: OpenID Connect's code flow with PKCE; it logs in whom it is told."""

import base64
import hashlib
import json
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

from joserfc import jwt
from joserfc.jwk import RSAKey

CLIENT_ID, CLIENT_SECRET = "fleet", "0123456789abcdef0123456789abcdef"
_KEY = RSAKey.generate_key(2048, {"kid": "1"}, private=True)
_OTHER_KEY = RSAKey.generate_key(2048, {"kid": "1"}, private=True)


class Provider(ThreadingHTTPServer):
    """Logs in ``person``; ``lies`` are claims that its tokens have instead of the right ones."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.issuer = f"http://127.0.0.1:{self.server_port}"
        self.person = "ann"
        self.lies: dict[str, Any] = {}
        self.is_forging = False  # signs by a key that it does not publish
        self.asked: list[str] = []
        self.codes: dict[str, dict[str, str]] = {}

    def code_for(self, words: dict[str, str]) -> str:
        """Return a code for a browser that came with these words."""
        code = secrets.token_urlsafe(16)
        self.codes[code] = words
        return code

    def token_for(self, form: dict[str, str], authorization: str) -> dict[str, Any] | None:
        """Return what a code is good for, once; None if it was not given, or not to who asks."""
        words = self.codes.pop(form.get("code", ""), None)
        told = base64.b64encode(f"{CLIENT_ID}:{CLIENT_SECRET}".encode()).decode()
        if words is None or authorization != f"Basic {told}":
            return None
        digest = hashlib.sha256(form.get("code_verifier", "").encode()).digest()
        is_same = words["redirect_uri"] == form.get("redirect_uri")
        if base64.urlsafe_b64encode(digest).decode().rstrip("=") != words["code_challenge"] or not is_same:
            return None
        now = int(time.time())
        claims = {
            "iss": self.issuer,
            "sub": "1",
            "aud": CLIENT_ID,
            "exp": now + 300,
            "iat": now,
            "nonce": words["nonce"],
        }
        claims |= {"email": self.person, "email_verified": True, **self.lies}
        key = _OTHER_KEY if self.is_forging else _KEY
        return {
            "access_token": "a",
            "token_type": "Bearer",
            "id_token": jwt.encode({"alg": "RS256", "kid": "1"}, claims, key),
        }


class _Handler(BaseHTTPRequestHandler):
    server: Provider

    def do_GET(self) -> None:
        parts, provider = urlsplit(self.path), self.server
        provider.asked.append(parts.path)
        if parts.path == "/.well-known/openid-configuration":
            ends = {"authorization_endpoint": "/authorize", "token_endpoint": "/token", "jwks_uri": "/jwks"}
            self._tell({"issuer": provider.issuer, **{name: provider.issuer + path for name, path in ends.items()}})
        elif parts.path == "/jwks":
            self._tell({"keys": [_KEY.as_dict(private=False)]})
        else:
            words = {name: values[0] for name, values in parse_qs(parts.query).items()}
            answer = urlencode({"code": provider.code_for(words), "state": words["state"]})
            self.send_response(302)
            self.send_header("location", f"{words['redirect_uri']}?{answer}")
            self.send_header("content-length", "0")
            self.end_headers()

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"])).decode()
        form = {name: values[0] for name, values in parse_qs(body).items()}
        found = self.server.token_for(form, self.headers.get("authorization", ""))
        self._tell(found or {"error": "invalid_grant"}, 200 if found else 400)

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def _tell(self, record: dict[str, Any], status: int = 200) -> None:
        content = json.dumps(record).encode()
        self.send_response(status)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


@contextmanager
def provided() -> Iterator[Provider]:
    """Run a provider for as long as the block lasts."""
    with Provider() as provider:
        thread = threading.Thread(target=provider.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield provider
        finally:
            provider.shutdown()
            thread.join()
