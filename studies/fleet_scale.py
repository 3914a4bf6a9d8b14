"""The fleet's ingest and its page's questions on a PostgreSQL with a past: many rows in months, two workers.

Rows of the past are made inside PostgreSQL. Results come from Mosquitto and from JetStream, each alone and in bundles:
as many as go through, all of them once more, then half of the aim at a steady pace. The page's questions are asked of a
fleet with that past and of the same fleet with its last thirty days only, in turns.

    python -m studies.fleet_scale --rows 20000000
"""

import argparse
import random
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from sqlalchemy import Engine, text

from studies.fleet_history import PER_DAY, make_fleet, make_results, settle
from studies.fleet_ingest import BROKER_LINES, processor_s, spent_s, told_cost, workers
from studies.fleet_load import Load, Wire, result_count, rush_s, steady_s
from studies.fleet_results import alone, bundled
from demo.fleet.servers import PostgresServer, mosquitto
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_backend.months import keep_months, partitions
from fleet_backend.page import past
from fleet_backend.page.running import DatabaseSource
from fleet_backend.page.vehicle_state import state_of
from fleet_contract import Channel, filter_of
from tests.support.nats import NatsServer

AIM_PER_S = 15_000
LATENCY_AIM_S = 2.0
QUESTION_AIM = 1.3
RECENT = timedelta(days=30)
WINDOW = 8000
PACED_S = 10.0
ASKED = 151  # few enough for a minute, enough for answers of milliseconds on a machine with other work
CONNECTIONS = 8  # that publish
SETTINGS = ("shared_buffers=1GB", "max_wal_size=8GB", "checkpoint_timeout=15min")


WAYS: dict[str, Callable[[int, int, int], list[Wire]]] = {"alone": alone, "in bundles": bundled}


def made_fleet(
    server: PostgresServer, name: str, vehicle_count: int, span: timedelta, driven: timedelta, now: datetime
) -> Engine:
    """Return a fleet with a past of so long; its results have the positions of one that is ``driven`` for so long."""
    engine = open_database(server.create(name))
    migrate(engine)
    keep_months(engine, now, back=1 + int(span.days / 28))
    make_fleet(engine, vehicle_count)
    began_s = time.monotonic()
    count = make_results(engine, vehicle_count, now - span, now, origin=now - driven)
    settle(engine)
    size_gib = sum(one.size_bytes for one in partitions(engine)) / 2**30
    took_s = time.monotonic() - began_s
    print(f"{count:,} rows in {len(partitions(engine))} partitions, {size_gib:.2f} GiB, made in {took_s:.0f} s")
    return engine


def fleets(server: PostgresServer, vehicle_count: int, span: timedelta) -> tuple[Engine, Engine]:
    """Return a fleet with its last days only and one with a past of so long, both made or as they were kept."""
    now, mark = datetime.now(UTC), server.folder / "made"
    made = f"{vehicle_count} vehicles, {span}\n"
    if mark.exists():
        if mark.read_text(encoding="utf-8") != made:
            raise SystemExit(f"{server.folder} keeps {mark.read_text(encoding='utf-8').strip()}, not {made.strip()}")
        kept = open_database(server.url("recent")), open_database(server.url("past"))
        for engine in kept:
            migrate(engine)
        return kept
    recent = made_fleet(server, "recent", vehicle_count, min(RECENT, span), span, now)
    old = made_fleet(server, "past", vehicle_count, span, span, now)
    mark.write_text(made, encoding="utf-8")
    return recent, old


@cache
def newest(engine: Engine, vehicle: str) -> tuple[str, int]:
    """Return stream and position of the newest result of a vehicle."""
    one = max(DatabaseSource(engine).clutches_of([vehicle]), key=lambda clutch: clutch.end_at)
    return one.stream, one.seq


def questions(vehicle_count: int) -> dict[str, Callable[[Engine], object]]:
    """Return what the page asks a database; what it shows is as much with a past as without."""
    began = datetime.now(UTC)
    some = [f"h{number}" for number in range(1, vehicle_count + 1)][:20]
    return {
        "whole fleet": lambda engine: DatabaseSource(engine).all_clutches(),
        "who has news": lambda engine: DatabaseSource(engine).vehicles_with_news(began),
        "vehicles with news": lambda engine: DatabaseSource(engine).clutches_of(some),
        "newest results of a clutch": lambda engine: past.results_of(engine, "h7", 1),
        "state of a vehicle": lambda engine: state_of(engine, "h7"),
        "one event": lambda engine: past.shift_of(engine, "h7", *newest(engine, "h7")),
        "last seen": queries.last_seen,
    }


def compare(recent: Engine, old: Engine, vehicle_count: int) -> bool:
    """Print how long each question takes without and with a past; return whether all keep the aim."""
    is_kept = True
    for name, ask in questions(vehicle_count).items():
        took: dict[Engine, list[float]] = {recent: [], old: []}
        for number in range(ASKED + 1):
            for engine in (recent, old) if number % 2 else (old, recent):
                began_s = time.perf_counter()
                ask(engine)
                took[engine].append(time.perf_counter() - began_s)
        without_ms, with_ms = (1000.0 * statistics.median(took[engine][2:]) for engine in (recent, old))
        ratio = with_ms / without_ms
        is_kept = is_kept and ratio <= QUESTION_AIM
        print(f"question, {name}: {without_ms:.2f} ms, with the past {with_ms:.2f} ms, ratio {ratio:.2f}")
    return is_kept


@contextmanager
def broker(name: str, folder: Path) -> Iterator[tuple[int, str]]:
    """Run a broker; yield the port of vehicles and the address for workers."""
    if name == "mosquitto":
        with mosquitto(folder, BROKER_LINES) as port:
            yield port, f"mqtt://127.0.0.1:{port}"
        return
    server = NatsServer(folder)
    server.start()
    try:
        yield server.port, server.url
    finally:
        server.stop()


def ingest(
    name: str, database: str, vehicle_count: int, count: int, pace_per_s: float, *, way: str, is_rush: bool
) -> bool:
    """Print rate, idempotence and latency from one broker; return whether all keep their aims."""
    engine, title = open_database(database), f"{name}, {way}"
    began, first = datetime.now(UTC), _last_live(engine) + 1
    with ExitStack() as stack:
        stack.callback(engine.dispose)
        folder = Path(stack.enter_context(TemporaryDirectory()))
        port, address = stack.enter_context(broker(name, folder))
        stack.enter_context(workers(address, database, 2))
        # The gateway of NATS grants 63 subscriptions of one client, and takes the messages of one client one by one.
        load = Load(port, "load", [filter_of(Channel.ACK)], connections=CONNECTIONS)
        stack.callback(load.close)
        made = WAYS[way](vehicle_count, first, count)
        count = result_count(made)
        used_s = processor_s()
        rate = count / load.send(made, WINDOW, timeout_s=300.0)
        used_s = spent_s(used_s)
        load.acknowledged_count = 0
        again = count / load.send(made, WINDOW, timeout_s=300.0)
        new = _live_count(engine, began)
        print(f"{title}: {rate:,.0f} results/s (aim {AIM_PER_S:,}); once more {again:,.0f}/s; {new:,} new of {count:,}")
        print(f"{title}: {told_cost(used_s, count)}")
        size = sum(len(message.packet(0)) for message in made) / count
        print(f"{title}: {len(made):,} packets, {size:,.0f} bytes per result")
        load.acknowledged_count, load.is_timed = 0, True
        p99_s = latency(
            title, load, WAYS[way](vehicle_count, first + count, int(PACED_S * pace_per_s)), is_rush=is_rush
        )
        return rate >= AIM_PER_S and new == count and p99_s <= LATENCY_AIM_S


def latency(title: str, load: Load, paced: list[Wire], *, is_rush: bool) -> float:
    """Print how long results take that come as slowly as is wanted; return what 99 of 100 keep [s]."""
    per_s, rng = len(paced) / PACED_S, random.Random(1)  # noqa: S311 - no secret
    after_s = rush_s(len(paced), per_s, rng) if is_rush else steady_s(len(paced), per_s)
    due_s = load.pace(paced, after_s, timeout_s=300.0)
    late_s = [load.heard_s[key] - at_s for message, at_s in zip(paced, due_s, strict=True) for key in message.keys]
    p99_s = statistics.quantiles(late_s, n=100)[-1]
    kind = "on average, with rush hours," if is_rush else "steadily"
    pace_per_s = result_count(paced) / PACED_S
    print(f"{title}: at {pace_per_s:,.0f}/s {kind} median {statistics.median(late_s):.3f} s, p99 {p99_s:.3f} s")
    return p99_s


def _live_count(engine: Engine, began: datetime) -> int:
    question = text("SELECT count(*) FROM shift_result WHERE stored_at >= :began AND stream = 'live'")
    with transaction(engine) as connection:
        return int(connection.execute(question, {"began": began}).scalar_one())


def _last_live(engine: Engine) -> int:
    """Return the highest position that any vehicle has of an earlier ingest."""
    question = text("SELECT coalesce(max(seq), 0) FROM shift_result WHERE vehicle = 'h1' AND stream = 'live'")
    with transaction(engine) as connection:
        return int(connection.execute(question).scalar_one())


def main() -> int:
    """Print the figures; return 0 if all keep their aims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=20_000_000, help="of the past")
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--results", type=int, default=60_000, help="sent from each broker")
    parser.add_argument("--pace", type=float, default=AIM_PER_S / 2, help="results per second, of the latency")
    parser.add_argument("--rush", action="store_true", help="of a day with rush hours, put into ten seconds")
    parser.add_argument("--broker", choices=["mosquitto", "nats"], help="only this one")
    parser.add_argument("--way", choices=WAYS, help="in which results come; only this one")
    parser.add_argument("--only", choices=["questions", "ingest"], help="of the two parts; by default both")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the past there, or take up what was kept")
    options = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a text stream
    span = timedelta(days=options.rows / (2 * options.vehicles * PER_DAY))
    with closing(PostgresServer(SETTINGS, options.keep)) as server:
        server.start()
        recent, old = fleets(server, options.vehicles, span)
        is_kept = options.only == "ingest" or compare(recent, old, options.vehicles)
        recent.dispose()
        old.dispose()
        names = [options.broker] if options.broker else ["mosquitto", "nats"]
        names = [] if options.only == "questions" else names
        for name, way in product(names, [options.way] if options.way else WAYS):
            done = ingest(
                *(name, server.url("past"), options.vehicles, options.results, options.pace),
                way=way,
                is_rush=options.rush,
            )
            is_kept = is_kept and done
    return 0 if is_kept else 1


if __name__ == "__main__":
    sys.exit(main())
