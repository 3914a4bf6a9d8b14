"""Who may read and change what behind a proxy that logs people in: every route by role, no change from elsewhere."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from sqlalchemy import select
from starlette.types import Message

from fleet_backend.database import open_database, transaction
from fleet_backend.office_tables import ALARM, AUDIT
from fleet_backend.page.access import UserRole, read_access
from fleet_backend.page.routes import PAGES, routes
from fleet_backend.page.site import LOOPBACK, application, host_of
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import (
    ACCESS,
    MARKUP,
    SECRET,
    asked,
    fill_database,
    filled,
    headers_of,
    served,
    sources_of,
)
from tests.support.patience import HANG_S

ALARM_WORDS = {"vehicle": "worn", "clutch": "2", "rule": "verdict", "number": "1"}
WORDS = {"/vehicles/{vehicle}/shift": {"stream": "stream-1", "seq": "59"}}
NOBODY, STRANGER, VIEWER, WORKSHOP = "", "mallory", "eve", "ann"
ROUTES = {  # what each may do: nobody logged in, somebody without a role, viewer, workshop
    **dict.fromkeys((*PAGES, "/static/page.css"), (401, 403, 200, 200)),
    **dict.fromkeys(("/alarm/acknowledge", "/vehicles/car1/fluid"), (401, 403, 403, 403)),  # for want of the token
}
PEOPLE = (NOBODY, STRANGER, VIEWER, WORKSHOP)


@pytest.fixture(name="database", scope="module")
def _database(sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return filled(sqlite_template, tmp_path_factory.mktemp("access"))


@pytest.fixture(name="site", scope="module")
def _site(database: str) -> Iterator[httpx.Client]:
    with served(database, ACCESS) as address, httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as client:
        yield client


def status(site: httpx.Client, method: str, path: str, headers: dict[str, str], **words: str) -> int:
    with site.stream(method, path, params=words, headers=headers) as answer:
        return answer.status_code


def test_every_route_is_for_its_roles_alone(site: httpx.Client) -> None:
    found: dict[str, tuple[int, ...]] = {}
    people = [headers_of(name) if name else {} for name in PEOPLE]
    for route in PAGES:
        path, words = route.replace("{vehicle}", "car1"), WORDS.get(route, {})
        page = "/" if route == "/vehicles" else path
        (found[route],) = {
            tuple(status(site, "GET", address, each, **words) for each in people)
            for address in (page, f"/api/v1{path}")
        }
    found["/static/page.css"] = tuple(status(site, "GET", "/static/page.css", each) for each in people)
    for path in ("/alarm/acknowledge", "/vehicles/car1/fluid"):
        form = {"content-type": "application/x-www-form-urlencoded"}
        found[path] = tuple(status(site, "POST", path, {**each, **form}) for each in people)
        assert status(site, "GET", path, people[-1]) == 405
    assert found == ROUTES


async def test_a_form_that_breaks_off_is_no_error_of_the_server(sqlite_url: str) -> None:
    sources = replace(sources_of(open_database(sqlite_url)), access=ACCESS)
    head = {"host": "127.0.0.1", "content-length": "99", "content-type": "application/x-www-form-urlencoded"}
    headers = [(name.lower().encode(), text.encode()) for name, text in (head | headers_of(WORKSHOP)).items()]
    scope = {"type": "http", "method": "POST", "path": "/vehicles/car1/fluid", "query_string": b"", "headers": headers}
    incoming: list[Message] = [
        {"type": "http.request", "body": b"product=DC", "more_body": True},
        {"type": "http.disconnect"},
    ]
    sent: list[Message] = []

    async def receive() -> Message:
        return incoming.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    await application(sources, routes())(scope, receive, send)
    assert sent[0]["status"] == 400
    sources.engine.dispose()


@pytest.mark.parametrize(
    "headers",
    [
        {"X-Forwarded-User": "bob"},
        {"X-Forwarded-User": "bob", "X-Fleet-Proxy": "wrong"},
        {"X-Forwarded-User": "bob", "X-Fleet-Proxy": f"{SECRET} "[:-2]},
        {"X-Fleet-Proxy": SECRET},
        {"X-Forwarded-User": "a" * 201, "X-Fleet-Proxy": SECRET},
    ],
)
def test_who_comes_past_the_proxy_is_nobody(site: httpx.Client, headers: dict[str, str]) -> None:
    assert site.get("/", headers=headers).status_code == 401


def test_a_page_that_is_kept_is_shown_to_whom_it_was_drawn_for(site: httpx.Client) -> None:
    for _ in range(2):
        for path in ("/", "/maintenance"):
            pages = {name: site.get(path, headers=headers_of(name)).text for name in ("ann", "bob", "eve")}
            for name, page in pages.items():
                assert [other for other in pages if f"<p>{other} (" in page] == [name], path


def test_a_list_is_drawn_once_for_each_reading_of_the_fleet(sqlite_url: str) -> None:
    engine = open_database(sqlite_url)
    fill_database(engine)
    sources = sources_of(engine)
    first, again = asked(sources, "/", "/")
    assert (first.text, len(sources.keeper.snapshot.drawn)) == (again.text, 1)
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(1, vehicle="new"))]))
    sources.keeper.refresh()
    assert sources.keeper.snapshot.drawn == {}
    (later,) = asked(sources, "/")
    assert ("/vehicles/new" in first.text, "/vehicles/new" in later.text) == (False, True)
    engine.dispose()


def test_who_is_named_twice_is_nobody(site: httpx.Client) -> None:
    """A client's own header comes before the one that a careless proxy adds."""
    for name in ("X-Forwarded-User", "X-Fleet-Proxy"):
        headers = [(name, headers_of("bob")[name]), *headers_of("eve").items()]
        assert site.get("/", headers=headers).status_code == 401, name


def token_of(site: httpx.Client, name: str) -> str:
    page = site.get("/vehicles/worn", headers=headers_of(name)).text
    found = re.search(r'name="token" value="([0-9a-f]{64})"', page)
    assert found is not None
    return found[1]


def test_a_change_comes_from_a_form_of_our_own_and_is_audited(site: httpx.Client, database: str) -> None:
    ann, action = headers_of("ann"), "/alarm/acknowledge"
    token = token_of(site, "ann")
    words = {**ALARM_WORDS, "token": token, "note": MARKUP}
    assert 'name="token"' not in site.get("/alarms", headers=headers_of("eve")).text
    forged = (
        (headers_of("bob"), words),  # the token of another
        (ann, {**words, "token": token[::-1]}),
        (ann, {name: word for name, word in words.items() if name != "token"}),
        ({**ann, "sec-fetch-site": "cross-site"}, words),
        ({**ann, "origin": "https://evil.example"}, words),
        ({**ann, "origin": "null"}, words),
        (headers_of("eve"), words),
    )
    assert [site.post(action, headers=headers, data=sent).status_code for headers, sent in forged] == [403] * len(
        forged
    )
    wrong = (
        {**words, "number": "7"},
        {**words, "note": "x" * 501},
        {**words, "colour": "red"},
        {**words, "note": "y" * 20_000},
    )
    assert [site.post(action, headers=ann, data=sent).status_code for sent in wrong] == [400] * 4
    assert site.post(action, headers=ann, json=words).status_code == 400
    done = site.post(action, headers={**ann, "origin": "http://127.0.0.1"}, data=words)
    assert (done.status_code, done.headers["location"]) == (303, "/alarms")
    assert site.post(action, headers=ann, data=words).status_code == 400  # it was acknowledged before
    engine = open_database(database)
    with transaction(engine) as connection:
        (alarm,) = connection.execute(select(ALARM).where(ALARM.c.acknowledged_at.is_not(None))).all()
        (entry,) = connection.execute(select(AUDIT).where(~AUDIT.c.action.contains("fluid fill"))).all()
    engine.dispose()
    assert (alarm.acknowledged_by, alarm.note, entry.who, entry.role) == ("ann", MARKUP, "ann", "workshop")
    for path in (done.headers["location"], "/alarms?state=all"):
        text = site.get(path, headers=headers_of("bob")).text
        assert "ann" in text
        assert "<img" not in text


def test_a_fill_is_noted_on_the_page_once_and_taken_back(site: httpx.Client, database: str) -> None:
    ann, page, action = headers_of("ann"), "/vehicles/worn", "/vehicles/worn/fluid"
    words = {
        "token": token_of(site, "ann"),
        "product": "DCTF-II",
        "at": "2026-02-01T10:00",
        "odometer_km": "",
        "note": "",
    }
    assert action not in site.get(page, headers=headers_of("eve")).text
    forged = ({**words, "token": ""}, {**words, "token": words["token"][::-1]})
    assert [site.post(action, headers=ann, data=sent).status_code for sent in forged] == [403, 403]
    assert site.post(action, headers={**ann, "sec-fetch-site": "cross-site"}, data=words).status_code == 403
    assert site.post(action, headers=headers_of("eve"), data=words).status_code == 403
    done = site.post(action, headers=ann, data=words)
    assert (done.status_code, done.headers["location"]) == (303, page)
    assert "new fluid: DCTF-II" in site.get(page, headers=ann).text
    told = site.get("/api/v1/vehicles/worn", headers=ann).json()
    assert (told["action"], [one["product"] for one in told["fills"]]) == ("new_fluid", ["DCTF-II"])
    again = site.post(action, headers=ann, data=words)
    assert (again.status_code, "is noted already" in again.text) == (400, True)
    wrong = ({"product": ""}, {"at": "yesterday"}, {"at": "2999-01-01"}, {"odometer_km": "-1"}, {"odometer_km": "4e6"})
    assert {site.post(action, headers=ann, data={**words, **one}).status_code for one in wrong} == {400}
    undo = {"token": words["token"], "undo": "yes"}
    assert [site.post(action, headers=ann, data=undo).status_code for _ in range(2)] == [303, 400]
    assert site.get("/api/v1/vehicles/worn", headers=ann).json()["action"] == "change_now"
    engine = open_database(database)
    with transaction(engine) as connection:
        entries = connection.execute(
            select(AUDIT).where(AUDIT.c.action.contains("fluid fill")).order_by(AUDIT.c.at)
        ).all()
    engine.dispose()
    assert [(one.who, one.role, one.action) for one in entries] == [
        ("ann", "workshop", "note fluid fill"),
        ("ann", "workshop", "withdraw fluid fill"),
    ]


FILLS = 20


@pytest.mark.parametrize("kind", ["sqlite_url", "postgres_url"])
def test_of_equal_fills_at_once_one_is_noted_and_each_is_answered(kind: str, request: pytest.FixtureRequest) -> None:
    """Whoever comes second hears that it is noted already; nobody is told to try again."""
    url = request.getfixturevalue(kind)
    engine = open_database(url)
    fill_database(engine)
    engine.dispose()
    ann, action = headers_of("ann"), "/vehicles/worn/fluid"
    with served(url, ACCESS) as address, httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as client:
        words = {"token": token_of(client, "ann"), "product": "DCTF-II", "at": "2026-02-01T10:00"}
        with ThreadPoolExecutor(FILLS) as pool:
            answers = list(pool.map(lambda _: client.post(action, headers=ann, data=words), range(FILLS)))
        told = client.get("/api/v1/vehicles/worn", headers=ann).json()
    assert sorted(answer.status_code for answer in answers) == [303, *[400] * (FILLS - 1)]
    assert {"is noted already" in answer.text for answer in answers if answer.status_code == 400} == {True}
    assert [fill["product"] for fill in told["fills"]] == ["DCTF-II"]


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1:x@evil", "127.0.0.1@evil", "evil@127.0.0.1", "127.0.0.1:80:80", "127.0.0.1:99999999",
        "127.0.0.1:-1", "127.0.0.1:8 0", "127.0.0.1 evil", "127.0.0.1,evil", "127.0.0.1/evil", "127.0.0.1#",
        "127.0.0.1?", "127.0.0.1\\evil", "[::1]evil", "[::1]:x", "[::1", "::1", "[127.0.0.1]", "localhost.",
        "evil:127.0.0.1", ":80", "", "\t",
    ],
)  # fmt: skip
def test_a_host_that_is_not_exactly_ours_is_refused(host: str) -> None:
    assert host_of(host) not in LOOPBACK


@pytest.mark.parametrize("name", LOOPBACK)
def test_our_own_names_are_ours_with_and_without_a_port(name: str) -> None:
    assert {host_of(name), host_of(f"{name}:8080"), host_of(name.upper())} == {name}


def test_the_server_answers_to_no_other_host(site: httpx.Client) -> None:
    for host in ("127.0.0.1:x@evil", "127.0.0.1@evil", "evil", "[::1]evil"):
        assert site.get("/", headers={"host": host, **headers_of("ann")}).status_code == 421, host


@pytest.mark.parametrize("origin", ["http://[", "http://evil", "http://127.0.0.1@evil", "null", "127.0.0.1"])
def test_a_form_of_a_strange_origin_is_refused(site: httpx.Client, origin: str) -> None:
    words = {"token": token_of(site, "ann"), "product": "DCTF-II"}
    answer = site.post("/vehicles/worn/fluid", headers={"origin": origin, **headers_of("ann")}, data=words)
    assert answer.status_code == 403


GOOD = """
host_names = ["fleet.example.org"]
[proxy]
user_header = "X-Forwarded-User"
secret_header = "X-Fleet-Proxy"
secret_file = "proxy.secret"
[roles]
workshop = ["Ann@example.org"]
viewer = ["*", "ann@example.org"]
"""


def write(folder: Path, text: str, secret: str = SECRET) -> Path:
    (folder / "proxy.secret").write_text(secret, encoding="utf-8")
    (folder / "proxy.secret").chmod(0o600)
    (folder / "access.toml").write_text(text, encoding="utf-8")
    return folder / "access.toml"


def test_the_highest_role_of_somebody_counts(tmp_path: Path) -> None:
    access = read_access(write(tmp_path, GOOD))
    assert access.host_names == ("fleet.example.org",)
    headers = {"X-Fleet-Proxy": SECRET}
    assert access.viewer_of({**headers, "X-Forwarded-User": "ann@EXAMPLE.org"}).role is UserRole.WORKSHOP
    assert access.viewer_of({**headers, "X-Forwarded-User": "who@ever.org"}).role is UserRole.VIEWER
    assert SECRET not in repr(access)
