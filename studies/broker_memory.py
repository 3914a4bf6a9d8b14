"""What a connected vehicle costs a broker: memory of Mosquitto and of a nats-server with idle sessions of vehicles.

Each has a session that is kept, hears acknowledgements and fills, and has told both clutches (retained).

    python -m studies.broker_memory --vehicles 1000
"""

import argparse
import asyncio
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from diag_service.diagnosis.records import clutch_record, shift_record
from fleet_backend.config import parse_broker
from fleet_contract import Channel, clutch_message, topic_of
from fleet_link import BrokerAddress, Connection, Terms
from tests.plugins.broker import Mosquitto
from tests.support.fleet import fleet_result
from tests.support.nats import NatsServer

AT_ONCE = 50
SETTLE_S = 3.0


async def connect(address: BrokerAddress, name: str, *, is_version_5: bool) -> Connection:
    terms = Terms(identifier=f"clutchdiag-{name}", session_s=7 * 24 * 3600, is_version_5=is_version_5, keepalive_s=600)
    connection = await Connection.open(address, terms)
    await connection.subscribe([topic_of(name, Channel.ACK), topic_of(name, Channel.FILLS)])
    shifts = [shift_record(fleet_result(1, vehicle=name, clutch=clutch)) for clutch in (1, 2)]
    await connection.publish_all([clutch_message(clutch_record(shift)) for shift in shifts])
    return connection


async def measure(url: str, pid: int, count: int, *, is_version_5: bool) -> float:
    """Return how many bytes a vehicle takes."""
    process, address = psutil.Process(pid), parse_broker(url)
    first = [await connect(address, f"first{number}", is_version_5=is_version_5) for number in range(10)]
    await asyncio.sleep(SETTLE_S)
    before_bytes, connections = process.memory_info().rss, list[Connection]()
    for start in range(0, count, AT_ONCE):
        names = [f"car{number}" for number in range(start, min(start + AT_ONCE, count))]
        connections += await asyncio.gather(*(connect(address, name, is_version_5=is_version_5) for name in names))
    await asyncio.sleep(SETTLE_S)
    found = (process.memory_info().rss - before_bytes) / count
    for one in (*first, *connections):
        await one.close()
    return found


@contextmanager
def broker(kind: str, folder: Path) -> Iterator[tuple[str, int]]:
    """Run a broker for as long as the block lasts; yield the address for vehicles and the process."""
    server: Mosquitto | NatsServer = Mosquitto(folder, is_durable=False) if kind == "mosquitto" else NatsServer(folder)
    server.start()
    try:
        pid = next(one.pid for one in psutil.Process().children() if kind.split("-", maxsplit=1)[0] in one.name())
        yield f"mqtt://127.0.0.1:{server.port}", pid
    finally:
        server.stop()


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=1000)
    count = parser.parse_args().vehicles
    for kind in ("mosquitto", "nats-server"):
        with TemporaryDirectory() as folder, broker(kind, Path(folder)) as (url, pid):
            size_bytes = asyncio.run(measure(url, pid, count, is_version_5=kind == "mosquitto"))
            print(f"{kind}: {size_bytes / 1024:.1f} KiB a vehicle, {count} vehicles", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
