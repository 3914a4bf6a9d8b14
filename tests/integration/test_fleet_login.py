"""Logins of our own by OpenID Connect, against a provider: who gets a session, and what does not get anybody one."""

import re
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from fleet_backend.database import open_database
from fleet_backend.errors import ConfigError
from fleet_backend.page.access import ATTEMPT_S, SESSION_S, Access, Attempt, Login, Role, Sessions, read_access
from fleet_backend.page.errors import LoginError, ProviderAwayError
from fleet_backend.page.login import local_path
from fleet_backend.page.oidc import Client, OpenIdProvider
from fleet_backend.page.server import closing_socket
from fleet_backend.page.site import ACTIONS, VIEWS
from tests.integration.test_fleet_access import ALARM_WORDS, ROUTES, WORDS
from tests.support.browsing import chromium, complaints_of, new_page
from tests.support.fleet_page import fill_database, raise_alarms, served
from tests.support.oidc import CLIENT_ID, CLIENT_SECRET, Provider, provided
from tests.support.patience import HANG_S

ROLES = {"ann": Role.WORKSHOP, "bob": Role.WORKSHOP, "eve": Role.VIEWER, "root": Role.ADMIN}
FORM = {"sec-fetch-site": "same-origin"}


@pytest.fixture(name="provider", scope="module")
def _provider() -> Iterator[Provider]:
    with provided() as provider:
        yield provider


@pytest.fixture(name="address", scope="module")
def _address(provider: Provider, sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = tmp_path_factory.mktemp("login") / "fleet.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    engine = open_database(f"sqlite:///{path}")
    fill_database(engine)
    raise_alarms(engine)
    engine.dispose()
    with closing_socket("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
    client = Client(
        issuer=provider.issuer,
        client_id=CLIENT_ID,
        secret=CLIENT_SECRET,
        return_address=f"http://127.0.0.1:{port}/login/return",
        name_claim="email",
    )
    login = Login(provider=OpenIdProvider(client), is_secure=False)
    access = Access(host_names=("127.0.0.1",), login=login, roles=ROLES)
    with served(f"sqlite:///{path}", access, port=port) as address:
        yield address


@pytest.fixture(name="browser")
def _browser(address: str, provider: Provider) -> Iterator[httpx.Client]:
    provider.person, provider.lies, provider.is_forging = "ann", {}, False
    with httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as client:
        yield client


def logged_in(browser: httpx.Client, where: str = "/") -> httpx.Response:
    return browser.get(f"/login?next={where}", follow_redirects=True)


def token_in(answer: httpx.Response) -> str:
    (token, *_) = re.findall(r'name="token" value="([0-9a-f]+)"', answer.text)
    return str(token)


def test_who_is_not_logged_in_is_sent_to_the_provider_and_back(browser: httpx.Client) -> None:
    sent = browser.get("/vehicles/car1?service_km=20000")
    assert (sent.status_code, sent.headers["location"]) == (303, "/login?next=%2Fvehicles%2Fcar1%3Fservice_km%3D20000")
    assert browser.get("/api/v1/clutches").status_code == 401
    assert browser.get("/events").status_code == 401
    found = browser.get("/vehicles/car1?service_km=20000", follow_redirects=True)
    assert (found.status_code, found.url.path, found.url.query) == (200, "/vehicles/car1", b"service_km=20000")
    assert "ann (workshop)" in found.text
    assert browser.get("/api/v1/clutches").status_code == 200
    (cookie,) = [one for one in found.history[-1].headers.get_list("set-cookie") if one.startswith("fleet=")]
    assert {"HttpOnly", "SameSite=lax", "Path=/"} <= set(cookie.split("; "))


def test_every_route_is_for_its_roles_alone(browser: httpx.Client, provider: Provider) -> None:
    """The table of routes by role is that of a proxy; nobody is sent to log in, or gets 401."""
    for place, person in enumerate(("", "eve", "ann", "root")):
        browser.cookies.clear()
        if person:
            provider.person = person
            assert logged_in(browser).status_code == 200
        for view in VIEWS:
            wanted = ROUTES[view.name][place + bool(person)]
            words = WORDS.get(view.name, {})
            page, data = (
                browser.get(path.replace("{vehicle}", "car1"), params=words) for path in (view.page_path, view.api_path)
            )
            assert (page.status_code, data.status_code) == ((wanted, wanted) if person else (303, 401)), view.name
        for path in (*(action.path for action in ACTIONS), "/logout"):
            assert browser.post(path, data={"token": "0"}).status_code == (403 if person else 401)


def test_a_session_is_begun_by_a_login_alone(browser: httpx.Client) -> None:
    """Whatever key somebody put into a browser, a login gives another one, and the old one is worth nothing."""
    browser.cookies.set("fleet", "planted", domain="127.0.0.1")
    assert browser.get("/").status_code == 303
    logged_in(browser)
    first = browser.cookies["fleet"]
    assert first != "planted"
    logged_in(browser)
    second = browser.cookies["fleet"]
    assert second != first
    for key, status in ((first, 303), ("planted", 303), (second, 200)):
        browser.cookies.clear()
        assert browser.get("/", headers={"cookie": f"fleet={key}"}).status_code == status
    assert browser.get("/", headers={"cookie": f"fleet=planted; fleet={second}"}).status_code == 303


def test_a_login_ends_in_the_browser_that_began_it_once(browser: httpx.Client) -> None:
    began = browser.get("/login")
    returned = browser.get(began.headers["location"]).headers["location"]
    victim = httpx.Client(base_url=browser.base_url, trust_env=False)
    assert victim.get(returned).status_code == 401  # a link that an attacker's login made
    victim.close()
    assert browser.get(returned.replace("state=", "state=x")).status_code == 401
    assert browser.get(returned).status_code == 303
    assert browser.get(returned).status_code == 401
    words = parse_qs(urlsplit(began.headers["location"]).query)
    assert words["code_challenge_method"] == ["S256"]
    assert words["response_type"] == ["code"]
    assert browser.get("/login/return?error=access_denied").status_code == 401


@pytest.mark.parametrize(
    "lies",
    [
        {"iss": "https://elsewhere.example"},
        {"aud": "another"},
        {"exp": 1_000_000_000},
        {"nonce": "another"},
        {"aud": ["another", CLIENT_ID], "azp": "another"},
        {"email_verified": False},
        {"email": None},
        {"email": 7},
    ],
)
def test_a_token_that_is_not_for_us_now_logs_nobody_in(
    browser: httpx.Client, provider: Provider, lies: dict[str, object]
) -> None:
    provider.lies = lies
    assert logged_in(browser).status_code == 401
    assert "fleet" not in browser.cookies


def test_a_token_that_another_signed_logs_nobody_in_and_who_has_no_role_gets_no_session(
    browser: httpx.Client, provider: Provider
) -> None:
    provider.is_forging = True
    assert logged_in(browser).status_code == 401
    provider.is_forging = False
    provider.person = "mallory"
    assert logged_in(browser).status_code == 403
    assert "fleet" not in browser.cookies


def test_a_change_takes_the_token_of_the_session(browser: httpx.Client, provider: Provider, address: str) -> None:
    page = logged_in(browser)
    other = httpx.Client(base_url=address, timeout=HANG_S, trust_env=False)
    provider.person = "bob"
    strange = token_in(logged_in(other))
    other.close()
    for token, headers in (
        (strange, FORM),
        ("", FORM),
        (token_in(page), {"sec-fetch-site": "cross-site"}),
        (token_in(page), {"origin": "https://evil.example"}),
    ):
        answer = browser.post("/alarm/acknowledge", data={**ALARM_WORDS, "token": token}, headers=headers)
        assert answer.status_code == 403
    assert (
        browser.post("/alarm/acknowledge", data={**ALARM_WORDS, "token": token_in(page)}, headers=FORM).status_code
        == 303
    )
    assert browser.post("/logout", data={"token": strange}).status_code == 403
    key = browser.cookies["fleet"]
    out = browser.post("/logout", data={"token": token_in(page)}, follow_redirects=True)
    assert (out.status_code, out.url.path) == (200, "/logged-out")
    assert browser.get("/", headers={"cookie": f"fleet={key}"}).status_code == 303


def test_a_provider_that_is_away_keeps_nobody_waiting() -> None:
    words = {"state": "one", "nonce": "two", "verifier": "three" * 20}
    with provided() as gone:
        provider, lying = (
            OpenIdProvider(replace(CLIENT, issuer=issuer)) for issuer in (gone.issuer, f"{gone.issuer}/")
        )
        with pytest.raises(ProviderAwayError, match="does not describe itself as it should"):
            lying.address(**words)
        asked = len(gone.asked)
        with pytest.raises(ProviderAwayError, match="does not answer"):
            lying.address(**words)
        assert len(gone.asked) == asked  # it is left alone for a while
    with pytest.raises(ProviderAwayError, match="does not answer"):
        provider.address(**words)

    def greet() -> None:
        with other.accept()[0] as one:
            one.recv(4096)
            one.sendall(b"220 no HTTP here\r\n")

    with socket.create_server(("127.0.0.1", 0)) as other, ThreadPoolExecutor() as threads:
        stranger = OpenIdProvider(replace(CLIENT, issuer=f"http://127.0.0.1:{other.getsockname()[1]}"))
        threads.submit(greet)
        with pytest.raises(ProviderAwayError, match="does not answer"):
            stranger.address(**words)


@pytest.mark.parametrize(
    ("where", "shown"),
    [
        ("/alarms?state=all", "/alarms?state=all"),
        ("https://evil.example/", "/"),
        ("//evil.example/", "/"),
        ("/\\evil.example", "/"),
        ("javascript:alert(1)", "/"),
        ("/a\r\nset-cookie: b", "/"),
        ("/" + "a" * 2000, "/"),
        ("", "/"),
    ],
)
def test_a_login_leads_to_this_server_alone(where: str, shown: str) -> None:
    assert local_path(where) == shown


def test_sessions_and_attempts_end() -> None:
    now_s = 0.0
    sessions = Sessions(clock=lambda: now_s, most=2)
    first, second = sessions.begin("ann"), sessions.begin("bob")
    assert sessions.name_of(first) == "ann"
    third = sessions.begin("eve")
    assert [sessions.name_of(key) for key in (first, second, third, "", "x")] == [None, "bob", "eve", None, None]
    attempt, key = Attempt.begin("/", now_s), b"k"
    sealed = attempt.sealed(key)
    assert Attempt.unsealed(sealed, key, now_s) == attempt
    assert Attempt.unsealed(sealed, b"another", now_s) is None
    for word in ("", ".", sealed[:-1], "x" + sealed, replace(attempt, where="/x").sealed(b"another")):
        assert Attempt.unsealed(word, key, now_s) is None
    assert Attempt.unsealed(sealed, key, ATTEMPT_S) is None
    now_s = SESSION_S
    assert sessions.name_of(second) is None


def test_by_https_cookies_belong_to_one_host_and_to_https() -> None:
    provider = OpenIdProvider(Client(issuer="", client_id="", secret="", return_address="", name_claim=""))
    login = Login(provider=provider, is_secure=True)
    assert login.session_cookie == "__Host-fleet"


def write(folder: Path, **others: str) -> Path:
    words = {
        "issuer": '"https://login.example.org"',
        "client_id": '"fleet"',
        "client_secret_file": '"oidc.secret"',
        "url": '"https://fleet.example.org"',
        **others,
    }
    secret = folder / "oidc.secret"
    secret.write_text(CLIENT_SECRET, encoding="utf-8")
    secret.chmod(0o600)
    lines = [
        'host_names = ["fleet.example.org"]',
        "[oidc]",
        *(f"{name} = {word}" for name, word in words.items() if word),
        "[roles]",
        'admin = ["ann@example.org"]',
    ]
    path = folder / "access.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


CLIENT = Client(issuer="", client_id="", secret="", return_address="", name_claim="email")


@pytest.mark.parametrize(
    ("is_trusted", "told", "is_in"),
    [(False, None, False), (True, None, True), (False, True, True), (True, False, False)],
)
def test_a_provider_that_does_not_say_whether_addresses_are_verified_must_be_trusted(
    *, is_trusted: bool, told: bool | None, is_in: bool
) -> None:
    provider = OpenIdProvider(replace(CLIENT, has_verified_emails=is_trusted))
    claims = {"email": "ann@example.org"} | ({} if told is None else {"email_verified": told})
    with nullcontext() if is_in else pytest.raises(LoginError, match="not verified"):
        assert provider._name_in(claims) == "ann@example.org"


def test_whoever_the_provider_knows_is_a_danger_that_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert read_access(path).exposure is None
    path.write_text(path.read_text("utf-8") + '\nviewer = ["*"]\n', encoding="utf-8")
    assert "everybody with an account at the login provider is viewer" in str(read_access(path).exposure)


def test_the_file_makes_a_login(tmp_path: Path) -> None:
    access = read_access(write(tmp_path))
    assert access.knows_people
    assert access.login is not None
    assert access.login.is_secure
    assert CLIENT_SECRET not in repr(access)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ({"issuer": ""}, "oidc needs issuer, client_id"),
        ({"issuer": '"http://login.example.org"'}, "must be https://host"),
        ({"url": '"http://fleet.example.org"'}, "must be https://host"),
        ({"url": '"https://fleet.example.org/fleet"'}, "must be https://host"),
        ({"url": '"https://other.example.org"'}, "one of host_names"),
        ({"colour": '"red"'}, "'colour' is unknown"),
        ({"client_secret_file": '"missing"'}, "missing"),
        ({"name_claim": "7"}, "oidc needs"),
        ({"has_verified_emails": '"yes"'}, "must be true or false"),
    ],
)
def test_a_file_that_makes_none_is_one_clear_line(tmp_path: Path, words: dict[str, str], complaint: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(complaint)):
        read_access(write(tmp_path, **words))


def test_in_a_browser_everybody_can_log_in_and_out(address: str, provider: Provider) -> None:
    provider.person, provider.lies, provider.is_forging = "root", {}, False
    with chromium() as browser:
        page = new_page(browser, has_axe=True)
        told = complaints_of(page, f"{address}/audit", "light", has_picture=False)
        assert [one for one in told if not one.startswith(provider.issuer)] == []
        assert page.url == f"{address}/audit"
        page.get_by_role("button", name="Log out").click()
        page.get_by_role("heading", name="Logged out").wait_for()
        page.goto(f"{address}/login?next=/alarms")
        page.get_by_role("heading", name="Alarms").first.wait_for()
        assert unescape(page.locator(".viewer p").inner_text()) == "root (admin)"
