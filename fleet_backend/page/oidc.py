"""Logging in by OpenID Connect: the code flow with PKCE; tokens are checked by Authlib and its JOSE library."""

import json
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from http.client import HTTPException
from typing import Any, Final
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import ProxyHandler, Request, build_opener

from authlib.common.errors import AuthlibBaseError
from authlib.oauth2.auth import ClientAuth
from authlib.oauth2.rfc6749.parameters import prepare_grant_uri, prepare_token_request
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from authlib.oidc.core import CodeIDToken
from authlib.oidc.discovery import get_well_known_url
from joserfc import jwt
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

from fleet_backend.alarms.carriers import NoRedirects
from fleet_backend.page.errors import LoginError, ProviderAwayError

LONGEST_WAIT_S: Final = 10.0
AWAY_S: Final = 5.0  # a provider that did not answer is left alone, so that those who wait for it are not many
KNOWN_FOR_S: Final = 3600.0  # what the provider says of itself
LEEWAY_S: Final = 60  # between its clock and ours
_MOST_BYTES: Final = 262_144
_ALGORITHMS: Final = ("RS256", "PS256", "ES256", "EdDSA")  # of public keys only
_LOCAL: Final = frozenset({"127.0.0.1", "localhost", "::1"})
_ENDPOINTS: Final = ("authorization_endpoint", "token_endpoint", "jwks_uri")


@dataclass(frozen=True, slots=True, kw_only=True)
class Client:
    """What the provider knows us by."""

    issuer: str
    client_id: str
    secret: str = field(repr=False)
    return_address: str
    name_claim: str
    has_verified_emails: bool = False  # the provider verifies addresses, though its tokens do not say so


class OpenIdProvider:
    """One provider; what it says of itself is asked when somebody logs in, and kept for an hour."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._lock = threading.Lock()
        self._known: tuple[float, Mapping[str, Any]] | None = None
        self._away_until_s = 0.0

    def address(self, *, state: str, nonce: str, verifier: str) -> str:
        """Return where a browser logs in; raises ProviderAwayError if the provider does not answer."""
        found = prepare_grant_uri(
            self._description()["authorization_endpoint"],
            self._client.client_id,
            "code",
            redirect_uri=self._client.return_address,
            scope="openid email profile",
            state=state,
            nonce=nonce,
            code_challenge=create_s256_code_challenge(verifier),
            code_challenge_method="S256",
        )
        return str(found)

    def name(self, code: str, *, nonce: str, verifier: str) -> str:
        """Return who logged in.

        Raises
        ------
        LoginError
            If the provider does not take the code, or its token is not one for us, of now and of this attempt.
        ProviderAwayError
            If it does not answer.
        """
        description = self._description()
        told = self._post(str(description["token_endpoint"]), code, verifier)
        try:
            found = _read(Request(str(description["jwks_uri"])))  # noqa: S310 - https, or of this machine
            keys = KeySet.import_key_set({"keys": list(found["keys"])})
            token = jwt.decode(str(told["id_token"]), keys, algorithms=list(_ALGORITHMS))
            claims = self._checked(token, nonce, str(told.get("access_token", "")))
        except (JoseError, AuthlibBaseError, KeyError, ValueError, TypeError) as exc:
            raise LoginError("the identity that the login provider sent is not valid") from exc
        return self._name_in(claims)

    def _checked(self, token: jwt.Token, nonce: str, access_token: str) -> Mapping[str, Any]:
        client = self._client
        claims = CodeIDToken(
            token.claims,
            token.header,
            {"iss": {"essential": True, "value": client.issuer}, "aud": {"essential": True, "value": client.client_id}},
            {"nonce": nonce, "client_id": client.client_id, "access_token": access_token},
        )
        claims.validate(now=int(time.time()), leeway=LEEWAY_S)
        return dict(claims)

    def _name_in(self, claims: Mapping[str, Any]) -> str:
        name = claims.get(self._client.name_claim)
        if not isinstance(name, str) or not name:
            raise LoginError(f"the provider did not say the {self._client.name_claim} of the user")
        is_verified = claims.get("email_verified", self._client.has_verified_emails) is True
        if self._client.name_claim == "email" and not is_verified:
            raise LoginError("the provider has not verified this e-mail address")
        return name

    def _description(self) -> Mapping[str, Any]:
        with self._lock:
            if self._known is not None and time.monotonic() < self._known[0] + KNOWN_FOR_S:
                return self._known[1]
            if time.monotonic() < self._away_until_s:
                raise ProviderAwayError("the login provider does not answer")
            issuer, self._away_until_s = self._client.issuer, time.monotonic() + LONGEST_WAIT_S + AWAY_S
            found = _read(Request(get_well_known_url(issuer, external=True)))  # noqa: S310 - https, or of this machine
            if found.get("issuer") != issuer or not all(is_safe(str(found.get(name))) for name in _ENDPOINTS):
                raise ProviderAwayError("the login provider does not describe itself as it should")
            self._known, self._away_until_s = (time.monotonic(), found), 0.0
            return found

    def _post(self, address: str, code: str, verifier: str) -> Mapping[str, Any]:
        """Return what the provider gives for a code; raises LoginError if it gives nothing."""
        client = self._client
        body = prepare_token_request(
            "authorization_code", redirect_uri=client.return_address, code=code, code_verifier=verifier
        )
        headers = {"content-type": "application/x-www-form-urlencoded", "accept": "application/json"}
        _, headers, body = ClientAuth(client.client_id, client.secret).prepare("POST", address, headers, body)
        return _read(Request(address, body.encode(), headers))  # noqa: S310 - https, or of this machine


def is_safe(address: str) -> bool:
    """Return whether secrets may go to an address: by https, or to this machine."""
    try:
        parts = urlsplit(address)
    except ValueError:
        return False
    return bool(parts.hostname) and (parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in _LOCAL))


def _read(request: Request) -> dict[str, Any]:
    """Return the JSON object that a provider answers; LoginError if it refuses a form, else ProviderAwayError."""
    try:
        opener = build_opener(NoRedirects, ProxyHandler({}))
        with opener.open(request, timeout=LONGEST_WAIT_S) as answer:
            found = json.loads(answer.read(_MOST_BYTES))
    except URLError as exc:
        if request.data is not None and 400 <= getattr(exc, "code", 0) < 500:
            raise LoginError("the login provider does not accept this login; begin it again") from exc
        raise ProviderAwayError("the login provider does not answer") from exc
    except (OSError, ValueError, HTTPException) as exc:
        raise ProviderAwayError("the login provider does not answer") from exc
    if not isinstance(found, dict):
        raise ProviderAwayError("the login provider does not answer")
    return found
