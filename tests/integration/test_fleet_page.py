"""The fleet's page as readers see it: a real browser, the same numbers everywhere, no markup from outside."""

import json
import re
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from jsonschema import Draft202012Validator
from playwright.sync_api import Browser, Page

from clutch_results.records import Condition
from fleet_backend.database import open_database
from fleet_backend.intake import batch_of, receive
from fleet_backend.page import server
from fleet_backend.page.routes import LEFT
from fleet_backend.page.routes import PAGES as ROUTES
from fleet_backend.page.site import SAFE_HEADERS as HEADERS
from fleet_backend.schema import SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from tests.support.browsing import chromium, complaints_of, new_page, refused_in
from tests.support.fleet import NOW, fleet_result, message_of, row_of
from tests.support.fleet_page import ACCESS, MARKUP, filled, headers_of, served
from tests.support.histories import fill_store, history
from tests.support.in_process import ended
from tests.support.patience import HANG_S

SHIFT = "/vehicles/car1/shift?stream=stream-1&seq=59"
LISTS = ("/", "/alarms?state=all", "/maintenance")
EMPTY = {
    "/": "No vehicle has been heard from yet.",
    "/alarms": "No alarms.",
    "/maintenance": "No vehicle has been heard from yet.",
}
PAGES = (*LISTS, "/vehicles/car1", "/vehicles/worn", SHIFT, "/vehicles/nobody")
TABLES_ONLY = {*LISTS, "/vehicles/nobody"}
EXAMPLES = {  # of each address for programs
    "/vehicles": "/vehicles",
    "/vehicles/{vehicle}": "/vehicles/car1",
    "/vehicles/{vehicle}/shift": SHIFT,
    "/alarms": "/alarms?state=all",
    "/maintenance": "/maintenance",
}
FRICTION = ("mu_c", "std_mu_c", "mu_s", "std_mu_s")


@pytest.fixture(name="database", scope="module")
def _database(sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return filled(sqlite_template, tmp_path_factory.mktemp("page"))


@pytest.fixture(name="address", scope="module")
def _address(database: str) -> Iterator[str]:
    """Return the address of a server that all tests share."""
    with served(database) as address:
        yield address


@pytest.fixture(name="workshop", scope="module")
def _workshop(database: str) -> Iterator[str]:
    """Return the address of the same page behind a proxy that logs people in."""
    with served(database, ACCESS) as address:
        yield address


@pytest.fixture(name="reader", scope="module")
def _reader(address: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as client:
        yield client


def told(reader: httpx.Client, path: str) -> dict[str, Any]:
    answer = reader.get(path)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def values_in(page: str) -> set[float]:
    """Return the numbers of a page, all digits."""
    return {float(word) for word in re.findall(r'<data value="([^"]*)">', page)}


def stds_of(name: str) -> float:
    """Return how many of a number people read: of a standard deviation two, behind ±."""
    return 2.0 if name.startswith("std_") else 1.0


def pressed_until(page: Page, key: str, text: str) -> None:
    """Press a key until something with a text has the focus."""
    for _ in range(60):
        page.keyboard.press(key)
        if page.evaluate("document.activeElement.textContent") == text:
            return
    raise AssertionError(f"{text} cannot be reached by {key}")


def acknowledge_by_keyboard(browser: Browser, workshop: str) -> list[str]:
    """Go from the fleet to its alarms and acknowledge one without a mouse; return what axe finds on the way."""
    page = new_page(browser, headers=headers_of("ann"))
    page.goto(workshop)
    pressed_until(page, "Tab", "Alarms")
    page.keyboard.press("Enter")
    page.wait_for_url("**/alarms")
    waiting_count = page.get_by_role("button", name="Acknowledge").count()
    pressed_until(page, "Tab", "")  # the note, empty so far
    page.keyboard.type("fluid is on order")
    pressed_until(page, "Tab", "Acknowledge")
    page.keyboard.press("Enter")
    page.get_by_text("fluid is on order").wait_for()
    assert page.get_by_role("button", name="Acknowledge").count() == waiting_count - 1
    other = new_page(browser, has_axe=True, headers=headers_of("bob"))
    return complaints_of(other, f"{workshop}/alarms", "light", has_picture=False)


def complaints_of_print(browser: Browser, address: str) -> dict[str, list[str]]:
    """Return what is wrong with a vehicle on paper: pictures and tables are there, what leads elsewhere is not."""
    page = new_page(browser, 794, has_axe=True)  # A4 at 96 pixels per inch
    page.emulate_media(media="print")
    found = complaints_of(page, f"{address}/vehicles/car1", "light")
    seen = {name: page.locator(name).first.is_visible() for name in ("svg.plot", "table", "header.site", ".formats")}
    wanted = {"svg.plot": True, "table": True, "header.site": False, ".formats": False}
    return {"on paper": [*found, *(name for name, is_seen in seen.items() if is_seen != wanted[name])]}


def test_an_empty_fleet_says_so_on_every_page(sqlite_template: Path, tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    with served(f"sqlite:///{path}", ACCESS) as address, chromium() as browser:
        page = new_page(browser, 360, has_axe=True, headers=headers_of("bob"))
        for where, words in EMPTY.items():
            assert complaints_of(page, address + where, "dark", has_picture=False) == [], where
            assert page.get_by_text(words).count() == 1, where


def test_a_real_browser_shows_every_page_to_everybody(address: str, database: str, workshop: str) -> None:
    """One start: pages light and wide, one dark and on a telephone; one by keyboard, printed and renewed.

    The first list and the last one are shown to axe by test_pages_on_phones.py.
    """
    complaints = {}
    with chromium() as browser:
        for scheme, width, paths in (
            ("light", 1280, (*LISTS[1:-1], SHIFT, "/vehicles/nobody")),
            ("dark", 360, ("/vehicles/car1",)),
        ):
            page = new_page(browser, width, has_axe=True)
            for path in paths:
                found = complaints_of(page, address + path, scheme, has_picture=path not in TABLES_ONLY)
                complaints[f"{path}, {scheme}, {width} px"] = [one for one in found if "404" not in one]
            page.close()
        page = new_page(browser)
        refused: list[str] = []
        page.on("console", lambda message: refused.append(message.text))
        page.goto(address)
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
        page.keyboard.press("Enter")
        pressed_until(page, "Tab", "Filters")
        page.keyboard.press("Enter")
        for name in ("Vehicle", "Verdict", "Fluid", "Type", "Order"):
            page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.labels[0].textContent") == name
        pressed_until(page, "Tab", "worn")
        page.keyboard.press("Enter")
        page.wait_for_url("**/vehicles/worn")
        assert page.locator("h1").text_content() == "Vehicle worn"
        assert page.pdf().startswith(b"%PDF")
        page.get_by_text("Renews itself.").wait_for()
        writer = open_database(database)
        Writer(writer).store(Batch(shifts=[row_of(fleet_result(5, vehicle="worn", condition=Condition.CHANGE_FLUID))]))
        writer.dispose()
        page.get_by_text("the newest 5 of 5 events").wait_for(state="attached")
        assert refused == []  # by the policy for contents
        complaints |= {f"{path}, refused": refused_in(browser, address + path) for path in (*LISTS[1:], SHIFT)}
        complaints["alarms with their forms"] = acknowledge_by_keyboard(browser, workshop)
        complaints |= complaints_of_print(browser, address)
    assert complaints == {key: [] for key in complaints}


def test_the_same_numbers_are_in_message_database_interface_file_page_and_report(
    reader: httpx.Client, sqlite_url: str, tmp_path: Path
) -> None:
    results = history(60)
    messages = [message_of(one) for one in results]
    engine = open_database(sqlite_url)
    Writer(engine).store(batch_of([receive(message, NOW) for message in messages]))
    with engine.connect() as connection:
        rows = {row["seq"]: row for row in connection.execute(SHIFT_RESULT.select()).mappings()}
    engine.dispose()
    said = json.loads(messages[58].payload)["data"]
    row, one = rows[59], told(reader, f"/api/v1{SHIFT}")
    page = reader.get(SHIFT).text
    fill_store(tmp_path / "car1.sqlite", results)
    assert ended("report", tmp_path / "car1.sqlite", "--full", "-o", tmp_path / "car1.html").status == 0
    report = values_in((tmp_path / "car1.html").read_text(encoding="utf-8"))
    (record,) = ended("show", tmp_path / "car1.sqlite", "59", "--json").records
    for name in FRICTION:
        own, running = said["friction"][name], said["verdict"]["friction"][name]
        assert row[name] == one["friction"][name] == record["friction"][name] == own
        assert row[f"running_{name}"] == one["running"][name] == record["verdict"]["friction"][name] == running
        shown = {stds_of(name) * own, stds_of(name) * running}
        assert shown <= values_in(page)
        assert stds_of(name) * running in report
    now = told(reader, "/api/v1/vehicles/car1")["clutches"][0]["now"]
    assert now["mu_c"] in report
    assert {now["mu_c"], stds_of("std_mu_c") * now["std_mu_c"]} <= values_in(reader.get("/vehicles/car1").text)
    (listed,) = told(reader, "/api/v1/vehicles?q=car1")["vehicles"]
    assert listed["level_ratio"] in values_in(reader.get("/?q=car1").text)


def test_no_markup_comes_from_outside(reader: httpx.Client) -> None:
    for path in PAGES:
        text = reader.get(path).text
        assert "<img" not in text
        assert "<b>" not in text
    assert MARKUP in unescape(reader.get("/vehicles/car1").text)


@pytest.mark.parametrize(
    ("path", "status", "detail"),
    [
        ("/vehicles/nobody", 404, "no message was ever received of a vehicle nobody"),
        ("/vehicles/car1/shift?stream=stream-1&seq=999", 404, "car1 has no event 999 in this stream"),
        ("/vehicles/car1/shift?stream=stream-1", 400, "Object missing required field `seq`"),
        ("/vehicles/..%2f..%2fetc", 404, ""),
        ("/?q=%00", 400, "'q': holds characters that are not text"),
        ("/?colour=red", 400, "Object contains unknown field `colour`"),
        ("/?limit=1&limit=2", 400, "a word of this address is given twice"),
        ("/static/..%2fsite.py", 404, ""),
        ("/static/page.html", 404, ""),
        ("/nowhere", 404, ""),
    ],
)
def test_what_cannot_be_answered_is_said_to_people_and_programs(
    reader: httpx.Client, path: str, status: int, detail: str
) -> None:
    page = reader.get(path)
    assert (page.status_code, page.headers["content-type"]) == (status, "text/html; charset=utf-8")
    assert detail in unescape(page.text)
    asked = path.replace("/?", "/vehicles?")
    problem = reader.get(f"/api/v1{asked}")
    assert (problem.status_code, problem.headers["content-type"]) == (status, "application/problem+json")
    assert detail in problem.json()["detail"]


def test_every_answer_says_what_a_browser_may_do(reader: httpx.Client) -> None:
    for path in (*PAGES, "/static/page.css", "/api/v1/vehicles", "/?limit=x"):
        headers = reader.get(path).headers
        assert {name: headers.get(name) for name, _ in HEADERS} == dict(HEADERS), path
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["cache-control"] == ("max-age=3600" if "static" in path else "no-store")
        assert "server" not in headers
    assert reader.post("/").status_code == 405
    for host in ("evil.example", "127.0.0.1.evil.example", "evil.example:80", ""):
        assert reader.get("/", headers={"host": host}).status_code in {400, 421}, host
    assert reader.get("/", headers={"host": "localhost:8090"}).status_code == 200


def test_programs_get_what_the_published_schema_says(reader: httpx.Client) -> None:
    description = told(reader, "/api/v1/openapi.json")
    assert description["paths"].keys() == {f"/api/v1{path}" for path in ROUTES}
    for path, example in EXAMPLES.items():
        answers = description["paths"][f"/api/v1{path}"]["get"]["responses"]
        schema = answers["200"]["content"]["application/json"]["schema"] | {"components": description["components"]}
        answer = told(reader, f"/api/v1{example}")
        Draft202012Validator(schema).validate(answer)
        name = schema["$ref"].rpartition("/")[2]
        assert answer.keys() == description["components"]["schemas"][name]["properties"].keys(), path
    schema = answers["404"]["content"]["application/problem+json"]["schema"] | {"components": description["components"]}
    Draft202012Validator(schema).validate(reader.get("/api/v1/vehicles/nobody").json())


def _is_allowed(word: str, schema: dict[str, Any]) -> bool:
    """Return whether a word in an address is one that a schema allows: as text, or as the number or null it writes.

    In the regular expressions of a schema ``$`` is the end of a text, not that of its last line (ECMA 262).
    """
    values: list[object] = [word]
    if word == word.strip() and not word.startswith('"'):
        with suppress(ValueError):
            values.append(json.loads(word))
    text = json.dumps(schema).replace('$"', r'\\Z"')
    validator = Draft202012Validator(json.loads(text), format_checker=Draft202012Validator.FORMAT_CHECKER)
    return any(validator.is_valid(value) for value in values)


ODD_WORDS = (
    *(
        "",
        " ",
        "0",
        "1",
        "-1",
        "5",
        "5.0",
        "5.5",
        "1e1",
        "+5",
        " 5",
        "007",
        "0x1",
        "5_0",
        "50000",
        "50001",
        "2147483648",
    ),
    *(
        "2147483649",
        "300000",
        "300001",
        "9007199254740992",
        "9007199254740993",
        "true",
        "null",
        "NaN",
        "[]",
        "{}",
        '"a"',
    ),
    *(
        "2026-01-01",
        "2026-1-1",
        "20260101",
        "2026-02-30",
        "2026-01-01T00:00:00",
        " 2026-01-01",
        "0001-01-01",
        "9999-12-31",
    ),
    *(
        "10000-01-01",
        "good",
        "GOOD",
        "watch",
        "open",
        "all",
        "due",
        "km",
        "-km",
        "--km",
        "silence",
        "car1",
        "stream-1",
        ".",
    ),
    *(
        "..",
        "a" * 64,
        "a" * 65,
        "ä" * 64,
        "ä" * 200,
        "ä" * 201,
        "a\n",
        "\n",
        "a\tb",
        "\0",
        "\x7f",
        "\x85",
        "\u2028",
        "\u202e",
    ),
    *("\xa0", "\U0001f600", "%", "%00", "'", '"><script>', "a" * 128, "a" * 129, "../../etc/passwd", "1.nominal-1"),
)


def test_every_odd_word_is_answered_as_the_published_schema_says(reader: httpx.Client) -> None:
    """An odd word in each parameter, with all others as they should be, is refused where no schema allows it."""
    description = told(reader, "/api/v1/openapi.json")
    wrong, count = list[str](), Counter[bool]()
    for path, example in EXAMPLES.items():
        query = dict(httpx.URL(example).params)
        for parameter in description["paths"][f"/api/v1{path}"]["get"]["parameters"]:
            schema = parameter["schema"] | {"components": description["components"]}
            for word in ODD_WORDS:
                address, words = httpx.URL(f"/api/v1{path.replace('{vehicle}', 'car1')}"), dict(query)
                if parameter["in"] == "path":
                    if word in {"", ".", ".."} or "/" in word:  # other addresses
                        continue
                    address = httpx.URL(f"/api/v1{path.replace('{vehicle}', quote(word))}")
                else:
                    words[parameter["name"]] = word
                status = reader.get(address, params=words).status_code
                is_allowed = _is_allowed(word, schema)
                count[is_allowed] += 1
                if status not in ({200, 404} if is_allowed else {400}):
                    wrong.append(f"{path} {parameter['name']}={word!r}: {status}, but allowed: {is_allowed}")
    assert wrong == []
    assert min(count.values()) > 200, count


def test_pages_that_left_say_where_to_go(reader: httpx.Client) -> None:
    for path, (page_now, program_now) in LEFT.items():
        assert reader.get(path).headers["location"] == page_now
        problem = reader.get(f"/api/v1{path}")
        assert (problem.status_code, program_now in problem.json()["title"]) == (410, True)


def test_a_page_links_to_the_same_for_programs(reader: httpx.Client) -> None:
    for path in PAGES[:-1]:
        (link,) = re.findall(r'<a href="(/api/[^"]*)">', reader.get(path).text)
        assert reader.get(unescape(link)).status_code == 200


def test_half_a_request_does_not_keep_a_connection(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "HEADERS_S", 0.2)
    with served(database) as address, socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2]))) as half:
        half.sendall(b"GET / HTTP/1.1\r\nHost: fleet\r\n")
        half.settimeout(HANG_S)
        with suppress(ConnectionResetError):
            assert half.recv(100) == b""
        with httpx.Client(trust_env=False) as client:  # whole ones, one after the other over one connection
            assert {client.get(address).status_code for _ in range(3)} == {200}
