"""A fleet of the schema before months is migrated: killed half-way, taken up again, read all the while.

python -m benchmarks.fleet_migrate --rows 1000000
"""

import argparse
import subprocess
import sys
import threading
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta

from sqlalchemy import Engine, text

from benchmarks.fleet_history import PER_DAY, make_fleet, make_results
from demo.fleet.servers import PostgresServer
from fleet_backend import queries
from fleet_backend.choices import Axis
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_backend.queries import table_hash

BEFORE = "r0007"
VEHICLES = 100
PERIOD_S = 0.05
KILLED_AT = 0.4  # of the results


class Reader:
    """Asks what a page asks, again and again."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._read)
        self.took_s: list[float] = []
        self.failures: list[str] = []

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._is_over.set()
        self._thread.join()

    def _found(self) -> tuple[int, int]:
        """Ask by the documented views, which every schema has."""
        return len(queries.worst_first(self._engine)), len(queries.trend(self._engine, "h7", 1, Axis.SHIFT))

    def _read(self) -> None:
        expected = self._found()
        while not self._is_over.wait(PERIOD_S):
            began_s = time.perf_counter()
            try:
                found = self._found()
            except Exception as exc:  # noqa: BLE001 - whatever it is, it counts
                self.failures.append(str(exc).splitlines()[0])
                continue
            self.took_s.append(time.perf_counter() - began_s)
            if found != expected:
                self.failures.append(f"found {found}, expected {expected}")


def migrating(database: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "fleet_backend", "migrate", "--database", database]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def moved(process: "subprocess.Popen[str]", until: int | None = None) -> int:
    """Return how many results have moved: at the end, or as soon as these are enough."""
    count = 0
    for line in process.stderr or ():
        count = int(line.split()[0])
        if until is not None and count >= until:
            break
    return count


def measure(database: str, row_count: int) -> bool:
    """Print the figures; return whether all results were readable throughout and all are there."""
    engine = open_database(database)
    migrate(engine, BEFORE)
    make_fleet(engine, VEHICLES)
    now = datetime.now(UTC)
    made = make_results(engine, VEHICLES, now - timedelta(days=row_count / (2 * VEHICLES * PER_DAY)), now)
    before = table_hash(engine)
    reader = Reader(engine)
    reader.start()
    began_s = time.monotonic()
    first = migrating(database)
    done = moved(first, until=int(KILLED_AT * made))
    first.kill()
    first.communicate()
    killed_s = time.monotonic() - began_s
    second = migrating(database)
    total = moved(second)
    second.communicate()
    took_s = time.monotonic() - began_s
    reader.end()
    is_same = table_hash(engine) == before
    with transaction(engine) as connection:
        parts = connection.execute(text("SELECT count(DISTINCT tableoid) FROM shift_result")).scalar_one()
    engine.dispose()
    print(
        f"{made:,} results: {took_s:.1f} s, {made / took_s:,.0f}/s; killed after {killed_s:.1f} s with {done:,} moved"
    )
    print(f"the second run ended with status {second.returncode} at {total:,}; results in {parts} partitions")
    print(f"the table is {'equal' if is_same else 'NOT EQUAL'} to that before")
    longest_s = max(reader.took_s, default=0.0)
    print(f"read meanwhile {len(reader.took_s)} times, {len(reader.failures)} failures, longest {longest_s:.2f} s")
    for failure in reader.failures[:3]:
        print(failure)
    return is_same and second.returncode == 0 and not reader.failures


def main() -> int:
    """Print the figures; return 0 if nothing was lost and everything readable."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000)
    options = parser.parse_args()
    with closing(PostgresServer(("shared_buffers=512MB", "max_wal_size=4GB"))) as server:
        server.start()
        return 0 if measure(server.create("fleet"), options.rows) else 1


if __name__ == "__main__":
    sys.exit(main())
