"""The routes of a login of our own: begin, come back from the provider, log out."""

from dataclasses import dataclass
from typing import Final
from urllib.parse import urlencode, urlsplit

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from fleet_backend.page.access import ATTEMPT_COOKIE, ATTEMPT_S, SESSION_S, Access, Attempt, Login, cookie_in
from fleet_backend.page.errors import LoginError
from fleet_backend.page.html import problem_page

LOGIN_PATH: Final = "/login"
RETURN_PATH: Final = "/login/return"
_LOGGED_OUT_PATH: Final = "/logged-out"
_LONGEST: Final = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class LoginRoutes:
    access: Access
    login: Login

    def all(self) -> list[Route]:
        return [
            Route(LOGIN_PATH, self._begin, name="login"),
            Route(RETURN_PATH, self._return, name="login return"),
            Route(_LOGGED_OUT_PATH, self._logged_out, name="logged out"),
        ]

    def _begin(self, request: Request) -> Response:
        attempt = Attempt.begin(local_path(request.query_params.get("next", "/")), self.login.sessions.clock())
        address = self.login.provider.address(state=attempt.state, nonce=attempt.nonce, verifier=attempt.verifier)
        answer = RedirectResponse(address, status_code=303)
        self._set(answer, self.login.cookie_name(ATTEMPT_COOKIE), attempt.sealed(self.access.key), ATTEMPT_S)
        return answer

    def _return(self, request: Request) -> Response:
        """Begin a session, under a key that no browser has seen before."""
        name = self.login.cookie_name(ATTEMPT_COOKIE)
        attempt = Attempt.unsealed(cookie_in(request.headers, name), self.access.key, self.login.sessions.clock())
        words = request.query_params
        if attempt is None or words.get("state") != attempt.state:
            raise LoginError("this login began in another browser or has expired; begin it again")
        if not words.get("code") or len(words["code"]) > _LONGEST:
            raise LoginError("the login provider refused the login")
        person = self.login.provider.name(words["code"], nonce=attempt.nonce, verifier=attempt.verifier)
        self.access.role_of(person)  # who has none gets no session
        self.login.sessions.end(cookie_in(request.headers, self.login.session_cookie))
        answer = RedirectResponse(attempt.where, status_code=303)
        self._set(answer, self.login.session_cookie, self.login.sessions.begin(person), SESSION_S)
        self._set(answer, name, "", 0.0)
        return answer

    def _logged_out(self, _: Request) -> Response:
        text = problem_page("Logged out", "You are logged out in this browser.")
        answer = Response(text, media_type="text/html")
        self._set(answer, self.login.session_cookie, "", 0.0)
        return answer

    def _set(self, answer: Response, name: str, value: str, age_s: float) -> None:
        answer.set_cookie(
            name, value, max_age=round(age_s), path="/", secure=self.login.is_secure, httponly=True, samesite="lax"
        )


def logged_out(access: Access, request: Request) -> str:
    """End the session of a request; return the address of what is to be seen then."""
    if access.login is not None:
        access.login.sessions.end(cookie_in(request.headers, access.login.session_cookie))
    return _LOGGED_OUT_PATH


def login_address(request: Request) -> str:
    """Return where somebody logs in who wanted to see something."""
    where = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    return f"{LOGIN_PATH}?{urlencode({'next': where})}"


def local_path(where: str) -> str:
    """Return an address of this server, whatever somebody wrote into a link."""
    parts = urlsplit(where)
    is_ours = where.startswith("/") and not where.startswith("//") and not parts.scheme and not parts.netloc
    is_plain = where.isprintable() and "\\" not in where and len(where) <= _LONGEST
    return where if is_ours and is_plain else "/"
