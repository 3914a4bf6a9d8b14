"""The story of a fluid: aged, ordered to be changed, changed, sound; at each step all who tell of it tell the same."""

import asyncio
import html
import json
import re
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Engine

from diag_service.delivery import MqttConnector, Outbox
from diag_service.store import ResultStore
from ecu_emulator.cli import main as emulator
from ecu_emulator.truth import read_truth, truth_path
from fleet_backend import queries
from fleet_backend.ageing.results import fills_of
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Letter
from fleet_backend.alarms.rules import AlarmRule
from fleet_backend.choices import Pace
from fleet_backend.cli import main as fleet
from fleet_backend.database import open_database
from fleet_backend.ingest import FILTERS, Worker, connected
from fleet_backend.office.watching import Orders, Watch
from fleet_backend.office_tables import ALARM
from fleet_backend.writer import Writer
from fleet_contract import CLUTCHES
from fleet_link import BrokerAddress
from tests.plugins.broker import Mosquitto
from tests.support.fleet_page import sources_of
from tests.support.fleet_page import told as told_by_page
from tests.support.in_process import ended
from tests.support.outboxes import STATUS, sending, until
from tests.support.patience import HANG_S
from tests.support.subscriber import Subscriber

pytestmark = pytest.mark.broker

OLD_SHIFTS, GOOD_SHIFTS = 10, 40
FILLED = "2026-01-01T12:00:00.000000Z"
NOW = datetime(2026, 1, 2, 12, tzinfo=UTC)
AGED = "Change the fluid now. Clutch 1: it can shudder (over 99 % sure). Clutch 2: it can shudder (over 99 % sure)."
CLOSED = (
    "New fluid since 2026-01-01 12:00 UTC: nothing is known of it yet. Clutch 1: nothing is known of it with "
    "this fluid. Clutch 2: nothing is known of it with this fluid."
)
SOUND = (
    "Nothing to do now: the fluid is sound. Clutch 1: its friction is sound (over 99 % sure). Clutch 2: its friction "
    "is sound (over 99 % sure)."
)


class Memory:
    """A carrier that keeps the alarms that it is given."""

    name = "memory"

    def __init__(self) -> None:
        self.letters: list[Letter] = []

    def deliver(self, letter: Letter) -> None:
        self.letters.append(letter)


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """A vehicle with its store, its fleet, and a broker between them."""

    store: Path
    broker: Mosquitto
    database: str
    engine: Engine
    watch: Watch
    alarms: Memory

    @asynccontextmanager
    async def connected(self) -> AsyncIterator[Outbox]:
        """Run backend and delivery of the vehicle until the block ends."""
        address, pace = BrokerAddress(host="127.0.0.1", port=self.broker.port), Pace()
        worker = Worker(
            lambda: connected(address, FILTERS, max_unsettled=pace.max_unsettled),
            Writer(self.engine),
            name="w",
            now=lambda: NOW,
            pace=pace,
        )
        async with AsyncExitStack() as stack:
            store = stack.enter_context(closing(ResultStore.open(self.store)))
            connector = MqttConnector(address, "clutchdiag-car1", STATUS)
            at = "2026-01-02T00:00:00.000000Z"
            outbox = Outbox(store, "car1", lambda: connector.connect(at), str(address))
            ingest = asyncio.create_task(worker.run())
            await until(lambda: worker.is_listening, HANG_S)
            async with sending(outbox):
                yield outbox
            ingest.cancel()
            await asyncio.gather(ingest, return_exceptions=True)

    async def until_told(self, result_count: int, order: str) -> None:
        """Wait until the fleet has all results, and the retained states of both clutches the order."""
        await until(lambda: queries.result_count(self.engine) == result_count, HANG_S)
        async with asyncio.timeout(HANG_S):
            while await self._retained_orders() != [order, order]:  # noqa: ASYNC110 - no broker tells when it has it
                await asyncio.sleep(0.1)

    async def _retained_orders(self) -> list[str]:
        """Return what whoever subscribes now is told of both clutches."""
        with Subscriber(self.broker.port) as listener:
            await until(lambda: len(clutch_states(listener)) == len(CLUTCHES), HANG_S)
            return [str(state["order"]) for state in clutch_states(listener)]

    def all_who_tell(self, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
        """Return the order in the words of everybody who tells of the vehicle as it is now."""
        history, told = ended("history", self.store).out.splitlines()[1:5], {}
        told["history"] = " ".join(history[:3])
        (record,) = (one for one in ended("history", self.store, "--json").records if one["record"] == "fills")
        told["history --json"] = record["order"]
        page = self.store.with_suffix(".html")
        assert ended("report", self.store, "-o", page, "--force").status == 0
        sheet = html.unescape(page.read_text())
        told["report"] = " ".join(part.split("<")[0] for part in re.split("<h2>|<p class=.why.>", sheet)[1:3])
        capsys.readouterr()
        assert fleet(["table", "--database", self.database, "--json"]) == 0
        rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        told |= {f"fleet table, clutch {row['clutch']}": row["order"] for row in rows}
        sources = sources_of(self.engine)
        sources.keeper.work_ahead(HANG_S)
        told |= {
            f"fleet page, clutch {one['clutch']}": one["order"]
            for one in told_by_page(sources, "/vehicles")["vehicles"]
        }
        vehicle = told_by_page(sources, "/vehicles/car1")
        assert {one["now"]["condition"] for one in vehicle["clutches"]} == {row["condition"] for row in rows}
        told["vehicle page"] = vehicle["order"]
        assert vehicle["outlook"] == history[3]
        for one in told_by_page(sources, "/maintenance")["clutches"]:
            told[f"maintenance, clutch {one['clutch']}"] = one["text"].removesuffix(f" {history[3]}")
        return told

    def alarms_now(self) -> list[tuple[str, str, str]]:
        """Return what the watch tells of verdicts, since it was asked last."""
        self.watch.round(judging_s=HANG_S)
        self.watch.deliver()
        letters, self.alarms.letters = self.alarms.letters, []
        told = [one.payload for one in letters if one.payload["rule"] == AlarmRule.VERDICT]
        return sorted((str(one["alarm"]), one["event"], one["reason"]) for one in told)


def clutch_states(listener: Subscriber) -> list[Any]:
    return [state for topic, state in listener.retained().items() if "/clutch/" in topic]


@pytest.fixture(name="world")
def _world(tmp_path: Path, broker: Mosquitto, sqlite_url: str) -> Iterator[World]:
    engine, memory = open_database(sqlite_url), Memory()
    yield World(
        store=tmp_path / "car1.sqlite",
        broker=broker,
        database=sqlite_url,
        engine=engine,
        watch=Watch(engine, Orders(carriers=[memory]), lambda: NOW),
        alarms=memory,
    )
    engine.dispose()


def console_of(world: World, log: Path) -> str:
    """Return the order that the analysis of a log prints, as one line."""
    lines = ended("analyze", log, "--store", world.store, "--vehicle", "car1").out.splitlines()
    first = next(place for place, line in enumerate(lines) if line.startswith("Clutch 1: "))
    return " ".join(lines[first - 1 : first + 2])


async def test_from_aged_fluid_to_sound_fluid_all_tell_the_same(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = tmp_path / "old.log", tmp_path / "new.log"
    assert emulator(["record", str(old), "--scenario", "case2"]) == 0
    totals = read_truth(truth_path(old)).totals
    assert totals is not None
    assert totals.odometer_m is not None
    odometer_km = totals.odometer_m / 1000.0
    later = ["--cycles", "4", "--start-time", "2026-01-02T00:00:00Z", "--odometer", str(odometer_km)]
    assert emulator(["record", str(new), "--scenario", "ideal", *later]) == 0

    assert console_of(world, old) == AGED
    async with world.connected() as outbox:
        await world.until_told(OLD_SHIFTS, AGED)
        assert set(world.all_who_tell(capsys).values()) == {AGED}
        raised = world.alarms_now()
        assert raised == [(f"car1/{clutch}/verdict/1", "raised", AGED) for clutch in (1, 2)]

        noted = ended("fluid-changed", world.store, "--at", FILLED, "--odometer", "12346", "--product", "DCTF-II")
        assert noted.status == 0
        outbox.wake()
        await world.until_told(OLD_SHIFTS, CLOSED)
        await until(lambda: len(fills_of(world.engine, "car1")) == 1, HANG_S)
        assert set(world.all_who_tell(capsys).values()) == {CLOSED}
        assert world.alarms_now() == [(f"car1/{clutch}/verdict/1", "cleared", CLOSED) for clutch in (1, 2)]
        assert book.alarms(world.engine, ALARM.c.cleared_at.is_(None)) == []
    assert console_of(world, old) == CLOSED  # what was analysed before is told again, and is of the earlier fluid

    assert console_of(world, new) == SOUND
    async with world.connected():
        await world.until_told(OLD_SHIFTS + GOOD_SHIFTS, SOUND)
        told = world.all_who_tell(capsys)
        assert set(told.values()) == {SOUND}, told
        assert world.alarms_now() == []
        outlook = ended("history", world.store).out.splitlines()[4]
        assert "Left out" not in outlook
        begins = ("No trend yet: left in, the fluid lasts at least ", "The fluid ages: ", "But the fluid ages: ")
        assert outlook.startswith(begins)

    undone = ended("fluid-changed", world.store, "--undo")
    assert undone.status == 0
    async with world.connected():  # what is taken back is so at both ends
        await until(lambda: fills_of(world.engine, "car1") == (), HANG_S)
