"""A legitimate vehicle that means ill, under the brokers' configurations of docs/deploy: it hurts no other."""

import json
import re
from pathlib import Path

import pytest

from fleet_contract import CLUTCHES, TOPIC_ROOT, Channel
from studies.fleet_hostile import attack
from tests.support.fleet_broker import DEPLOY

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
