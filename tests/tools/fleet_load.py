"""What the fleet's page costs with 20,000 vehicles and 1,000,000 results in a PostgreSQL of its own.

Processor time and time by the clock of the start and of each page's first and second call; then readers, odd requests
and half bodies against ``fleet-backend serve``.

    python -m tests.tools.fleet_load --kept /tmp/fleet-load
"""

import argparse
import asyncio
import gc
import os
import random
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote, urlsplit

import httpx
import numpy as np
import psutil
from sqlalchemy import Engine, text

from demo.fleet.servers import PostgresServer
from fleet_backend import queries
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.months import keep_months
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.page.routes import routes
from fleet_backend.page.site import Sources, application
from fleet_backend.schema import SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import row_of
from tests.support.fleet_page import SECRET, headers_of
from tests.support.histories import history
from tests.tools.fleet_page_picture import START, aged

LOSSES = (0.0, 0.02, 0.05, 0.08, 0.11, 0.13, 0.16, 0.235)  # of mu_C, of vehicles in turn
RESULTS_PER_VEHICLE, BUSY_RESULTS, TOGETHER = 50, 4_000, 1_000
SETTINGS = ("fsync=off", "shared_buffers=512MB", "max_wal_size=4GB", "max_connections=40")
VEHICLE = "v00007"
LET_GO_S = 20.0  # after which no half body is held any more
PAGES = (
    *("/", "/?sort=-km", "/?q=v0012", "/?only=due", "/?condition=watch&limit=1000", "/vehicles.csv"),
    *("/maintenance", "/maintenance?limit=1000", "/alarms", f"/vehicles/{VEHICLE}", "/vehicles/busy"),
    *("/vehicles/busy/shift?stream=stream-1&seq=3999", "/api/v1/vehicles", "/api/v1/maintenance"),
    *("/api/v1/alarms", "/api/v1/vehicles/busy", "/api/v1/openapi.json", "/api/v1/vehicles?limit=50000"),
)
READ = ("/", "/", "/", "/maintenance", "/alarms", "/?condition=watch", "/vehicles/v{:05}", "/vehicles/v{:05}")
ODD_WORDS = (
    "",
    "-1",
    "99999999999999999999",
    "nan",
    "\0",
    "%00",
    "💥" * 50,
    "<script>",
    "' OR 1=1",
    "../" * 9,
    "A" * 9000,
)
ODD_PATHS = ("/", "/vehicles.csv", "/maintenance", "/alarms", "/vehicles/{}", "/vehicles/{}/shift")
ODD_NAMES = ("q", "offset", "limit", "sort", "only", "since", "until", "stream", "seq", "rule", "state", "service_km")
ACCESS = """host_names = ["127.0.0.1"]
proxy = {user_header = "X-Forwarded-User", secret_header = "X-Fleet-Proxy", secret_file = "secret"}
roles = {workshop = ["ann"]}
"""


def fill(engine: Engine, vehicle_count: int) -> None:
    """Store a few vehicles by the program's own way, and the fleet as their copies."""
    migrate(engine)
    keep_months(engine, datetime.now(UTC), back=18)
    rng, names = np.random.default_rng(5), [name for name in SHIFT_RESULT.columns.keys() if name != "vehicle"]  # noqa: SIM118
    for number, loss in enumerate(LOSSES):
        results = history(RESULTS_PER_VEHICLE, vehicle=f"t{number}")
        Writer(engine).store(Batch(shifts=[aged(result, 5.0 * loss, number, rng) for result in results]))
    busy = [row_of(result) for result in history(BUSY_RESULTS, vehicle="busy")]
    for first in range(0, BUSY_RESULTS, TOGETHER):
        Writer(engine).store(Batch(shifts=busy[first : first + TOGETHER]))
    queries.note_fill(engine, "busy", "DCTF 75W", at=START, odometer_m=None, note=None)
    columns = ", ".join(names)
    copies = (
        "vehicle (vehicle) SELECT name FROM names",
        "clutch (vehicle, clutch) SELECT name, clutch FROM names JOIN clutch ON vehicle = template",
        f"fluid_fill (vehicle, filled_at, product) SELECT name, timestamptz '{START}', 'DCTF 75W' FROM names",  # noqa: S608
        f"shift_result (vehicle, {columns}) SELECT name, {columns} FROM names JOIN shift_result ON vehicle = template",  # noqa: S608
    )
    series = "SELECT 'v' || lpad(n::text, 5, '0') AS name, 't' || n % {} AS template FROM generate_series({}, {}) AS n"
    for first in range(0, vehicle_count, TOGETHER):
        last = min(first + TOGETHER, vehicle_count) - 1
        with engine.begin() as connection:
            for copy in copies:
                names_of = series.format(len(LOSSES), first, last)
                connection.execute(text(f"WITH names AS ({names_of}) INSERT INTO {copy}"))
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("VACUUM ANALYZE"))


def spent(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


def call_pages(url: str) -> None:
    """Print what each page costs at its first and second call, each in a process that has answered nothing yet."""
    engine = open_database(url, must_exist=True, is_read_only=True)
    begin = time.process_time(), time.perf_counter()
    keeper = Keeper(DatabaseSource(engine))
    keeper.refresh()
    took = time.process_time() - begin[0], time.perf_counter() - begin[1]
    print(f"the fleet is read: {took[0]:.2f} s of processor, {took[1]:.2f} s", flush=True)
    site = application(Sources(engine=engine, keeper=keeper), routes())

    async def ask(path: str) -> None:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(site), base_url="http://127.0.0.1") as client:
            await client.get("/static/page.css")  # the thread, and what the client loads
            costs = []
            for _ in range(2):
                begin = time.process_time(), time.perf_counter()
                answer = await client.get(path)
                ends = time.process_time(), time.perf_counter()
                costs += [1e3 * (end - start) for start, end in zip(begin, ends, strict=True)]
        size_kb = len(answer.content) / 1e3
        words = "first {:.0f} ms of processor, {:.0f} ms; second {:.0f}, {:.0f}".format(*costs)
        print(f"{path}: {answer.status_code}, {size_kb:.0f} kB, {words}", flush=True)

    gc.collect()
    gc.freeze()  # else the first collection of a child copies all pages of memory
    for path in PAGES:
        if child := os.fork():
            os.waitpid(child, 0)
            continue
        engine.dispose(close=False)
        try:
            asyncio.run(ask(path))
        finally:
            os._exit(0)
    engine.dispose()


@contextmanager
def serving(url: str, folder: Path) -> Iterator[tuple[str, psutil.Process]]:
    """Serve until the block ends; yield host and port, and the process."""
    (folder / "secret").write_text(SECRET)
    (folder / "secret").chmod(0o600)
    (folder / "access.toml").write_text(ACCESS)
    command = [sys.executable, "-m", "fleet_backend", "serve", "--listen", "127.0.0.1:0", "--database", url]
    begin_s = time.perf_counter()
    with subprocess.Popen(
        [*command, "--access", str(folder / "access.toml")], stdout=subprocess.PIPE, text=True
    ) as child:
        process = psutil.Process(child.pid)
        line = child.stdout.readline() if child.stdout else ""
        print(
            f"start: {spent(process):.1f} s of processor, {time.perf_counter() - begin_s:.1f} s: {line.strip()}",
            flush=True,
        )
        try:
            yield urlsplit(line.split()[0]).netloc, process
        finally:
            child.terminate()


@asynccontextmanager
async def connection_to(place: str) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    host, port = place.split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        yield reader, writer
    finally:
        writer.close()


def request(method: str, path: str, *more: str) -> bytes:
    """Return the head of a request of somebody whom the proxy has logged in."""
    login = [f"{name}: {value}" for name, value in headers_of("ann").items()]
    head = [f"{method} {path} HTTP/1.1", "host: 127.0.0.1", *login, *more]
    return "\r\n".join([*head, "", ""]).encode("utf-8", "replace")


async def answer_to(reader: asyncio.StreamReader, *, has_body: bool = True) -> tuple[int, bytes]:
    """Read an answer, and return its status and its body."""
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    size = re.search(r"content-length: (\d+)", head, re.IGNORECASE)
    body = await reader.readexactly(int(size[1])) if size and has_body else b""
    return int(head.split()[1]), body


async def read_pages(place: str, count: int, duration_s: float, pause_s: float, vehicle_count: int) -> None:
    """Let clients read pages, each the next one after a pause, and print how long they waited."""
    waits_s, statuses, end_s = list[float](), Counter[int](), time.perf_counter() + duration_s

    async def client(number: int) -> None:
        rng = random.Random(number)  # noqa: S311 - a load, no secret
        async with connection_to(place) as (reader, writer):
            await asyncio.sleep(rng.random() * pause_s)
            while (begin_s := time.perf_counter()) < end_s:
                writer.write(request("GET", rng.choice(READ).format(rng.randrange(vehicle_count))))
                status, _ = await answer_to(reader)
                statuses[status] += 1
                waits_s.append(time.perf_counter() - begin_s)
                await asyncio.sleep(pause_s * 2.0 * rng.random())

    await asyncio.gather(*map(client, range(count)))
    median, p95, worst = np.quantile(waits_s, (0.5, 0.95, 1.0))
    words = f"{count} clients, {pause_s:g} s between two pages: {len(waits_s)} pages in {duration_s:g} s"
    print(f"{words}; median {median:.3f} s, p95 {p95:.3f} s, worst {worst:.3f} s; {dict(statuses)}", flush=True)


def odd_request(rng: random.Random) -> bytes:
    """Return a request of a known page with values that nobody meant, now and then to no page or by no method."""
    word = quote(rng.choice(ODD_WORDS)) if rng.random() < 0.7 else rng.choice(ODD_WORDS).replace("\0", "%00")
    path = rng.choice(ODD_PATHS).format(rng.choice((VEHICLE, "busy", quote(word[:60]) or "x")))
    path = ("/api/v1" if path != "/" and rng.random() < 0.4 else "") + path
    names = rng.choices(ODD_NAMES, k=rng.randrange(4))
    query = "&".join(f"{name}={word if rng.random() < 0.5 else rng.randrange(60)}" for name in names)
    method = "GET" if rng.random() < 0.8 else rng.choice(("HEAD", "POST", "PUT", "DELETE", "OPTIONS", "BREW"))
    more = rng.choice(((), (f"if-none-match: {rng.choice(ODD_WORDS[:4])}",), ("accept: ,;q=",), ("range: bytes=9-1",)))
    return request(method, "".join(f"{path}?{query}".split()) if query else path, *more, "connection: close")


async def ask_oddly(place: str, count: int) -> None:
    """Print what odd requests are answered."""
    statuses, reached_count = Counter[int](), 0
    rng = random.Random(7)  # noqa: S311 - as above
    for _ in range(count):
        odd = odd_request(rng)
        async with connection_to(place) as (reader, writer):
            writer.write(odd)
            try:
                status, body = await answer_to(reader, has_body=not odd.startswith(b"HEAD"))
            except asyncio.IncompleteReadError:  # no HTTP: the connection is closed
                status, body = 0, b""
        statuses[status] += 1
        is_of_router = status in {0, 405, 421} or b"Not Found" in body or b"Invalid HTTP" in body
        reached_count += not is_of_router
    print(f"{count} odd requests: {dict(statuses)}; {reached_count} reached a handler", flush=True)


async def send_halves(place: str, process: psutil.Process, count: int) -> None:
    """Hold so many forms half sent, and print how long a reader waits meanwhile."""
    head = request(
        "POST", f"/vehicles/{VEHICLE}/fluid", "content-type: application/x-www-form-urlencoded", "content-length: 99"
    )
    host, port = place.split(":")
    writers = list[asyncio.StreamWriter]()
    for first in range(0, count, 100):
        opened = await asyncio.gather(
            *(asyncio.open_connection(host, int(port)) for _ in range(first, min(first + 100, count)))
        )
        for _, writer in opened:
            writer.write(head + b"product=DCTF")
            writers.append(writer)
    waits_s, statuses = list[float](), Counter[int]()
    for number in range(40):
        begin_s = time.perf_counter()
        async with connection_to(place) as (reader, writer):
            writer.write(request("GET", ("/", f"/vehicles/{VEHICLE}")[number % 2]))
            status, _ = await answer_to(reader)
        statuses[status] += 1
        waits_s.append(time.perf_counter() - begin_s)
    print(
        f"{count} half bodies: readers {dict(statuses)}, median {np.median(waits_s):.3f} s, worst {max(waits_s):.3f} s",
        flush=True,
    )
    await asyncio.sleep(LET_GO_S)
    left_count = len(process.net_connections("tcp")) - 2  # the socket that listens, and one to the database
    print(f"  after {LET_GO_S:g} s more at most {left_count} connections are left", flush=True)
    for writer in writers:
        writer.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kept", type=Path, help="folder of the database, filled once")
    parser.add_argument("--vehicles", type=int, default=20_000)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--halves", type=int, default=4_500)
    options = parser.parse_args(arguments)
    server = PostgresServer(SETTINGS, options.kept)
    server.start()
    try:
        with open_database(server.url(), must_exist=True).connect() as connection:
            is_filled = connection.scalar(text("SELECT count(*) FROM pg_database WHERE datname = 'fleet'"))
        url = server.url("fleet") if is_filled else server.create("fleet")
        url = url.replace("+psycopg", "")
        if not is_filled:
            engine = open_database(url)
            fill(engine, options.vehicles)
            engine.dispose()
        with TemporaryDirectory() as folder:
            call_pages(url)
            with serving(url, Path(folder)) as (place, process):
                for pause_s in (1.0, 0.0):
                    before_s = spent(process)
                    asyncio.run(read_pages(place, options.clients, options.seconds, pause_s, options.vehicles))
                    print(
                        f"  {spent(process) - before_s:.1f} s of processor; load {os.getloadavg()[0]:.1f}", flush=True
                    )
                asyncio.run(ask_oddly(place, 2_000))
                asyncio.run(send_halves(place, process, options.halves))
    finally:
        server.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
