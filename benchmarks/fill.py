"""How soon a fluid fill that was entered in the fleet is in the vehicle's store, from the vehicle's next connection on.

Everything is a program of its own: broker, ingest, `fleet-backend fill`, and a service on a silent bus. In one series
the vehicle alone is started again after the fill, in the other one broker, ingest and vehicle, all at once.

    python -m benchmarks.fill --rounds 20
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from diag_service.errors import StoreError
from diag_service.store import StoreReader
from tests.plugins.broker import Mosquitto
from tests.support.subscriber import Subscriber

GOAL_S: Final = 5.0
LIMIT_S: Final = 300.0  # only a hang takes so long
VEHICLE: Final = "car1"
FIRST_FILL: Final = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One fill [s]."""

    since_connected_s: float
    since_started_s: float  # of the vehicle's program


class World:
    """A fleet of one vehicle."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._database = ("--database", f"sqlite:///{folder / 'fleet.sqlite'}")
        self.store = folder / "car1.sqlite"
        (folder / "mosquitto").mkdir()
        self.broker = Mosquitto(folder / "mosquitto")
        self.fill_count = 0

    def ask_backend(self, *words: str) -> bool:
        """Run a command of the backend; return whether it went well."""
        command = [sys.executable, "-m", "fleet_backend", *words, *self._database]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    @contextmanager
    def ingest(self) -> Iterator[None]:
        """Run the fleet's side."""
        words = ["-m", "fleet_backend", "ingest", "--broker", self.broker.url, *self._database]
        with self._running("ingest", words):
            yield

    @contextmanager
    def vehicle(self) -> Iterator[None]:
        """Run the vehicle's service."""
        bus = ["run", "-i", "virtual", "-c", "silent", "--vehicle", VEHICLE]
        words = ["-m", "diag_service", *bus, "--store", str(self.store), "--broker", self.broker.url]
        with self._running("vehicle", [*words, "--acknowledge", "backend"]):
            yield

    @contextmanager
    def _running(self, name: str, words: Sequence[str]) -> Iterator[None]:
        with (
            (self._folder / f"{name}.log").open("ab") as log,
            subprocess.Popen([sys.executable, *words], stdout=log, stderr=log) as process,
        ):
            try:
                yield
            finally:
                process.terminate()
                process.wait(LIMIT_S)

    def enter_fill(self) -> None:
        """Enter a fill in the fleet; wait until the fleet knows the vehicle."""
        moment = FIRST_FILL + timedelta(hours=self.fill_count)
        until_s = time.monotonic() + LIMIT_S
        while not self.ask_backend("fill", VEHICLE, f"fluid {self.fill_count}", "--at", moment.isoformat()):
            if time.monotonic() > until_s:
                raise RuntimeError((self._folder / "ingest.log").read_text(encoding="utf-8"))
        self.fill_count += 1

    def wait_for_fills(self) -> datetime:
        """Return when the vehicle's store has all fills."""
        until_s = time.monotonic() + LIMIT_S
        while time.monotonic() < until_s:
            with suppress(StoreError), StoreReader.open(self.store) as store:
                if len(store.fills(VEHICLE)) == self.fill_count:
                    return datetime.now(UTC)
            time.sleep(0.005)
        raise RuntimeError((self._folder / "vehicle.log").read_text(encoding="utf-8"))

    def connected_at(self) -> datetime:
        """Return when the vehicle connected, as its status says."""
        with Subscriber(self.broker.port) as heard:
            heard.wait(lambda _: any(one["status"] == "online" for one in heard.payloads("/status")))
            online = [one for one in heard.payloads("/status") if one["status"] == "online"]
        return max(datetime.fromisoformat(str(one["connected_at"])) for one in online)

    def measured(self) -> Round:
        """Start the vehicle and return how long the fill took."""
        started = datetime.now(UTC)
        with self.vehicle():
            there = self.wait_for_fills()
            connected = self.connected_at()
        return Round(
            since_connected_s=(there - connected).total_seconds(),
            since_started_s=(there - started).total_seconds(),
        )


def vehicle_restarts(world: World, count: int) -> list[Round]:
    """Return rounds in which broker and ingest go on."""
    found = []
    with world.ingest():
        with world.vehicle():  # the fleet gets to know it
            world.enter_fill()
        for _ in range(count):
            world.enter_fill()
            found.append(world.measured())
    return found


def all_restart(world: World, count: int) -> list[Round]:
    """Return rounds in which everything is started again at once after the fill."""
    found = []
    for _ in range(count):
        world.enter_fill()
        world.broker.stop()
        world.broker.start()
        with world.ingest():
            found.append(world.measured())
    return found


def show(what: str, rounds: Sequence[Round]) -> bool:
    connected = [one.since_connected_s for one in rounds]
    started = [one.since_started_s for one in rounds]
    print(
        f"{what:<34} {len(rounds):3d}  {statistics.median(connected):7.3f} {max(connected):7.3f}"
        f"  {statistics.median(started):7.3f} {max(started):7.3f}"
    )
    return max(connected) <= GOAL_S


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20, metavar="N", help="of each kind (default: %(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        world = World(Path(name))
        world.broker.start()
        stack.callback(world.broker.stop)
        if not world.ask_backend("migrate"):
            raise SystemExit("the database could not be made")
        print(f"{'[s]':<34} {'n':>3}  {'from the connection':^15}  {'from its start':^15}")
        print(f"{'after a fill there starts':<34} {'':3}  {'median':>7} {'worst':>7}  {'median':>7} {'worst':>7}")
        is_met = show("the vehicle", vehicle_restarts(world, options.rounds))
        is_met &= show("broker, ingest and vehicle", all_restart(world, options.rounds))
    print(f"goal: {GOAL_S:g} s from the connection: {'met' if is_met else 'NOT met'}")


if __name__ == "__main__":
    main()
