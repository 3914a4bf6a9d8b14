"""Thousands of vehicles come back within a minute, each with results that waited: loss, order, time, memory.

Every vehicle is a connection of its own that sends its newest results first, in bundles packed before the storm, and
again what nobody has acknowledged.
Beside what is measured stands what the model of a storm says for the pace of the same ingest.

    python -m studies.fleet_reconnect --vehicles 10000 --results 100
"""

import argparse
import asyncio
import json
import random
import statistics
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
from sqlalchemy import text

from studies.fleet_ingest import workers
from studies.fleet_load import Load, Wire, connect_packet, packets_in, subscribe_packet, wire
from studies.fleet_results import alone, bundled, outgoing
from studies.fleet_scale import broker
from studies.storm_model import Storm, play, told
from demo.fleet.servers import PostgresServer
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_contract import MAX_BUNDLED, Channel, Outgoing, bundle_messages, filter_of, topic_of

PROBE_S = 5.0
ASTRAY_S = 150.0
AIM_S = 180.0
FIRST_SEQ = 1_000_001
CALIBRATED = 20_000
MADE = 200  # different results, in turn
LOOK_S = 0.5
RETRY_S = 1.0
LONGEST_PAUSE_S = 60.0  # between attempts of a vehicle that is cut off
GIVEN_UP = 2.0  # times the aim
_PUBLISH, _SUBACK, _PUBACK = 3, 9, 0x40
_NAME, _SEQ = b"v000000", b"7654321"


class Template:
    """Results of any vehicle and position, made by replacing two words of one of some."""

    def __init__(self) -> None:
        moment, rng = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ"), random.Random(1)  # noqa: S311
        stream, name = "storm", _NAME.decode()
        self._made = [outgoing(name, int(_SEQ), moment, rng, stream=stream) for _ in range(MADE)]

    def alone(self, name: bytes, seq: int) -> Outgoing:
        """Return the message of a result."""
        made = self._made[seq % MADE]
        payload = made.payload.replace(_NAME, name).replace(_SEQ, str(seq).encode())
        return replace(made, topic=made.topic.replace(_NAME.decode(), name.decode()), payload=payload)

    def together(self, name: bytes, seqs: Sequence[int]) -> list[Wire]:
        """Return the packets of results that waited, by the function that an outbox has for it."""
        made: list[Wire] = []
        for first in range(0, len(seqs), MAX_BUNDLED):
            some = seqs[first : first + MAX_BUNDLED]
            keys = [(name.decode(), seq) for seq in some]
            packed = bundle_messages([self.alone(name, seq) for seq in some])
            made += [wire(message.topic, message.payload, keys) for message in packed]
        return made


class Vehicle(asyncio.Protocol):
    """One vehicle: connects, sends its newest first, comes back where it is cut off, goes when all are acknowledged."""

    def __init__(self, number: int, results: int, template: Template, *, bundles: bool) -> None:
        self.name = f"v{number:06}".encode()
        self.waiting = dict.fromkeys(range(FIRST_SEQ + results - 1, FIRST_SEQ - 1, -1))
        self.newest = FIRST_SEQ + results - 1
        self.began_s = 0.0
        self.newest_s: float | None = None
        self.is_in_order = False  # the newest was among the first to be acknowledged
        self.resent_count = 0
        self.lost_count = 0  # connections
        self.gone = asyncio.Event()  # this connection
        self._template = template
        self._bundles = template.together(self.name, list(self.waiting)) if bundles else []
        self._buffer = bytearray()
        self._transport: asyncio.Transport | None = None
        self._probe: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("no stream")
        self._transport = transport
        self._buffer.clear()
        self.gone.clear()
        topic = topic_of(self.name.decode(), Channel.ACK)
        transport.write(connect_packet(self.name.decode()) + subscribe_packet([topic]))

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self.lost_count += bool(self.waiting)
        if self._probe is not None:
            self._probe.cancel()
        self.gone.set()

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        for first_byte, body in packets_in(self._buffer):
            if first_byte >> 4 == _SUBACK:
                self._send_all()
            elif first_byte >> 4 == _PUBLISH:
                self._hear(first_byte, body)

    def _send_all(self) -> None:
        if self._bundles:
            waiting = (one for one in self._bundles if any(seq in self.waiting for _, seq in one.keys))
            self._write(waiting)
        else:
            self._send(self.waiting)
        self._look_again(PROBE_S)

    def _send(self, seqs: Iterable[int]) -> None:
        made = (self._template.alone(self.name, seq) for seq in seqs)
        self._write(wire(message.topic, message.payload) for message in made)

    def _write(self, packets: Iterable[Wire]) -> None:
        if self._transport is None or self._transport.is_closing():
            return
        self._transport.write(b"".join(one.packet(place) for place, one in enumerate(packets)))

    def _look_again(self, pause_s: float) -> None:
        loop = asyncio.get_running_loop()
        self._probe = loop.call_later(pause_s, self._send_again, pause_s, len(self.waiting))

    def _send_again(self, pause_s: float, waited: int) -> None:
        """Ask with one result, ever more seldom, while nothing is heard; in the end with all."""
        if not self.waiting:
            return
        if len(self.waiting) == waited:
            astray = list(self.waiting)[: 1 if pause_s < ASTRAY_S else None]
            self.resent_count += len(astray)
            self._send(astray)
            pause_s *= 2.0
        self._look_again(pause_s)

    def _hear(self, first_byte: int, body: bytes) -> None:
        at = 2 + int.from_bytes(body[:2])
        if first_byte & 0x06 and self._transport is not None:
            self._transport.write(bytes([_PUBACK, 2]) + body[at : at + 2])
            at += 2
        seqs = [one["seq"] for one in json.loads(body[at:])["data"]["results"]]
        if self.newest_s is None:
            self.is_in_order = self.newest in seqs
        if self.newest in seqs:
            self.newest_s = time.perf_counter() - self.began_s
        for seq in seqs:
            self.waiting.pop(seq, None)
        if not self.waiting and self._transport is not None:
            self._transport.close()


async def _connect(vehicle: Vehicle, port: int) -> None:
    """Connect, again after a while where the broker has no time for it."""
    while True:
        try:
            await asyncio.get_running_loop().create_connection(lambda: vehicle, "127.0.0.1", port)
        except OSError:
            await asyncio.sleep(RETRY_S)
        else:
            return


async def storm(vehicles: Sequence[Vehicle], port: int, window_s: float, timeout_s: float) -> None:
    """Let all vehicles come back; return when all are done, or after so long."""
    loop, rng = asyncio.get_running_loop(), random.Random(1)  # noqa: S311
    end_s = loop.time() + timeout_s

    async def drive(vehicle: Vehicle) -> None:
        await asyncio.sleep(rng.uniform(0.0, window_s))
        vehicle.began_s = time.perf_counter()
        with suppress(TimeoutError):
            async with asyncio.timeout_at(end_s):
                while vehicle.waiting:
                    await _connect(vehicle, port)
                    await vehicle.gone.wait()
                    pause_s = min(LONGEST_PAUSE_S, RETRY_S * 2.0**vehicle.lost_count)
                    await asyncio.sleep(rng.uniform(0.5, 1.0) * pause_s if vehicle.waiting else 0.0)

    await asyncio.gather(*map(drive, vehicles))


class Memory:
    """The most memory of each part that was seen [bytes]."""

    def __init__(self) -> None:
        self.most: dict[str, int] = {}
        self._own = psutil.Process()

    async def watch(self) -> None:
        while True:
            now: dict[str, int] = {"vehicles": self._own.memory_info().rss}
            for process in self._own.children(recursive=True):
                try:
                    name = "workers" if "fleet_backend" in process.cmdline() else process.name()
                    now[name] = now.get(name, 0) + process.memory_full_info().pss
                except psutil.NoSuchProcess:
                    continue
            self.most = {name: max(self.most.get(name, 0), now.get(name, 0)) for name in self.most | now}
            await asyncio.sleep(LOOK_S)


def measure(name: str, vehicle_count: int, results: int, window_s: float, *, bundles: bool) -> bool:
    """Print how a storm goes; return whether nothing is lost and all is in within three minutes."""
    with ExitStack() as stack:
        server = stack.enter_context(closing(PostgresServer(("shared_buffers=512MB", "max_wal_size=4GB"))))
        server.start()
        database = server.create("fleet")
        engine = open_database(database)
        stack.callback(engine.dispose)
        migrate(engine)
        folder = Path(stack.enter_context(TemporaryDirectory()))
        port, address = stack.enter_context(broker(name, folder))
        stack.enter_context(workers(address, database, 2))
        load = Load(port, "load", [filter_of(Channel.ACK)])
        calibrated = (bundled if bundles else alone)(CALIBRATED // MAX_BUNDLED, 1, CALIBRATED)
        pace = CALIBRATED / load.send(calibrated, CALIBRATED, timeout_s=300.0)
        load.close()
        memory, template = Memory(), Template()
        vehicles = [Vehicle(number, results, template, bundles=bundles) for number in range(vehicle_count)]

        async def run() -> float:
            watcher = asyncio.create_task(memory.watch())
            began_s = time.perf_counter()
            await storm(vehicles, port, window_s, GIVEN_UP * AIM_S)
            took_s = time.perf_counter() - began_s
            watcher.cancel()
            return took_s

        took_s = asyncio.run(run())
        with transaction(engine) as connection:
            count = text("SELECT count(*) FROM shift_result WHERE stream = 'storm'")
            stored = int(connection.execute(count).scalar_one())
    wanted = vehicle_count * results
    newest_s = [vehicle.newest_s for vehicle in vehicles if vehicle.newest_s is not None]
    resent = sum(vehicle.resent_count for vehicle in vehicles)
    unheard = sum(len(vehicle.waiting) for vehicle in vehicles)
    ordered = sum(vehicle.is_in_order for vehicle in vehicles)
    print(
        f"{name}: {vehicle_count:,} vehicles in {window_s:g} s, {wanted:,} results: {stored:,} stored, {took_s:.0f} s"
    )
    if unheard:
        print(
            f"{name}: given up after {took_s:.0f} s, {unheard:,} results without a word, {wanted - stored:,} not stored"
        )
    cut_off = sum(vehicle.lost_count for vehicle in vehicles)
    print(f"{name}: {resent:,} sent again, {cut_off:,} connections lost; of {ordered:,} vehicles the newest came first")
    middle_s, late_s = statistics.median(newest_s), statistics.quantiles(newest_s, n=100)[-1]
    print(f"{name}: newest of a vehicle in after {middle_s:.1f} s (median), {late_s:.1f} s (99 %)")
    print(f"{name}: most memory: " + ", ".join(f"{part} {size / 2**20:.0f} MiB" for part, size in memory.most.items()))
    size = round(sum(len(one.packet(0)) for one in calibrated) / CALIBRATED)
    model = Storm(
        vehicle_count=vehicle_count, results_each=results, window_s=window_s, pace_per_s=pace, result_bytes=size
    )
    print(f"{name}: model, with the pace of {pace:,.0f}/s measured before: {''.join(told(play(model), model))}")
    return stored == wanted and took_s <= AIM_S and not any(vehicle.waiting for vehicle in vehicles)


def main() -> int:
    """Print the figures; return 0 if all is well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=10_000)
    parser.add_argument("--results", type=int, default=100, help="of each")
    parser.add_argument("--window", type=float, default=60.0, help="seconds in which they connect")
    parser.add_argument("--broker", choices=["mosquitto", "nats"], default="mosquitto")
    parser.add_argument("--alone", action="store_true", help="each result in a message of its own, not in bundles")
    options = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a text stream
    is_good = measure(options.broker, options.vehicles, options.results, options.window, bundles=not options.alone)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
