"""A legitimate vehicle that means ill, under the brokers' configurations of docs/deploy: it hurts no other."""

import json
import re
from pathlib import Path

import pytest
from sqlalchemy import Engine

from clutch_results.records import shift_record
from fleet_backend import queries
from fleet_contract import CLUTCHES, TOPIC_ROOT, Channel, shift_message
from fleet_link.connection import MAX_PACKET_BYTES
from studies.fleet_hostile import MOST_BROKER_BYTES, attack, attack_by_properties
from studies.fleet_properties import RawVehicle, slow_messages
from tests.plugins.broker import Mosquitto
from tests.support.fleet import fleet_result
from tests.support.fleet_broker import DEPLOY
from tests.support.fleet_worker import worker_here
from tests.support.resending_edge import ResendingEdge

pytestmark = pytest.mark.broker

GOOD = [f"car{number}" for number in range(1, 6)]
SHIFTS = 20
KEPT_SHARE = {"mosquitto": 1 / 3, "nats": 1.0}  # a collector that is behind has freed, but not given back, some of it


@pytest.mark.parametrize("kind", ["mosquitto", "nats"])
async def test_it_hurts_nobody_and_is_seen(tmp_path: Path, kind: str) -> None:
    outcome = await attack(tmp_path, kind, GOOD, SHIFTS)
    assert (outcome.granted, outcome.heard) == ([], [])
    assert outcome.stored_count == 2 * len(GOOD) * SHIFTS
    assert outcome.unseen(kind) == []
    assert outcome.kept_bytes < outcome.sent_bytes * KEPT_SHARE[kind]
    if kind == "mosquitto":
        assert not any(f"Client {name} already connected" in outcome.log for name in (*GOOD, "fleet-backend"))


async def test_messages_that_are_all_properties_stop_nobody(tmp_path: Path) -> None:
    """Those that fill a broker it refuses; those that take long to unpack are put aside unread."""
    outcome = await attack_by_properties(tmp_path, SHIFTS, slow_count=3, filling_count=3)
    assert (outcome.stored_count, outcome.taken_count, outcome.kept_count) == (SHIFTS, 3, 0)
    assert outcome.aside == {"250000 bytes of properties, more than 1024"}
    assert outcome.broker_bytes < MOST_BROKER_BYTES


def test_a_receiver_holds_by_itself(broker: Mosquitto, postgres_url: str, postgres_engine: Engine) -> None:
    """Here the broker bounds packets as the receiver tells it, and nothing else."""
    sent = [shift_message(shift_record(fleet_result(seq))) for seq in range(1, SHIFTS + 1)]
    hostile = RawVehicle(broker.port, "bad")
    with worker_here(broker.url, postgres_url), ResendingEdge(broker.port) as edge:
        assert hostile.send(slow_messages("clutchdiag/v1/bad/shift", 3)) == 3
        edge.keep(sent)
        edge.deliver()
    records = queries.quarantined(postgres_engine, 10)
    assert [(record["vehicle"], record["detail"]) for record in records] == [
        ("bad", "250000 bytes of properties, more than 1024")
    ] * 3
    assert queries.result_count(postgres_engine) == SHIFTS


@pytest.mark.parametrize("path", [DEPLOY / "mosquitto.conf", DEPLOY.parents[1] / "docker-compose.yml"])
def test_a_broker_that_is_shipped_counts_whole_packets(path: Path) -> None:
    assert re.findall(r"max_packet_size (\d+)", path.read_text(encoding="utf-8")) == [str(MAX_PACKET_BYTES)]


def test_the_shipped_access_is_that_of_the_contract() -> None:
    """A vehicle says on its own topics and hears on those for it, all of them and no other; the office the reverse."""
    topics = {
        is_heard: [
            label
            for channel in Channel
            if channel.is_to_vehicle is is_heard
            for label in ([f"clutch/{one}" for one in CLUTCHES] if channel is Channel.CLUTCH else [channel.label])
        ]
        for is_heard in (False, True)
    }
    roles = json.loads((DEPLOY / "dynamic-security.json").read_text(encoding="utf-8"))["roles"]
    granted = {
        (role["rolename"], rule["acltype"], rule["topic"].removeprefix(f"{TOPIC_ROOT}/"))
        for role in roles
        for rule in role["acls"]
    }
    vehicle = {("publishClientSend", f"VEHICLE/{one}") for one in topics[False]}
    vehicle |= {
        (kind, f"VEHICLE/{one}") for kind in ("subscribeLiteral", "publishClientReceive") for one in topics[True]
    }
    told = {f"+/{re.sub('[12]$', '+', one)}" for one in topics[False]}
    office = {("publishClientSend", f"+/{one}") for one in topics[True]}
    office |= {(kind, one) for kind in ("publishClientReceive", "subscribePattern") for one in told}
    office |= {("subscribePattern", f"$share/+/{TOPIC_ROOT}/{one}") for one in told}
    assert granted == {("vehicle VEHICLE", *one) for one in vehicle} | {("office", *one) for one in office}
    own = re.findall(r'"(clutchdiag[^"]*VEHICLE[^"]*)"', (DEPLOY / "nats.conf").read_text(encoding="utf-8"))
    assert own == [f"{TOPIC_ROOT}/VEHICLE/{one}".replace("/", ".") for one in (*topics[False], *topics[True])]
