"""A legitimate vehicle that means ill, under the brokers' configurations of docs/deploy: it hurts no other."""

from pathlib import Path

import pytest

from fleet_backend.certificates.access import mosquitto_access, nats_users, write_access
from tests.support.fleet_broker import DEPLOY
from tests.support.hostile_vehicle import BAD, attack, authority_of

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
    assert outcome.took_s < 60.0
    if kind == "mosquitto":
        assert not any(f"Client {name} already connected" in outcome.log for name in (*GOOD, "fleet-backend"))


def test_the_shipped_access_is_what_the_program_writes(tmp_path: Path) -> None:
    authority = authority_of(tmp_path / "certificates", GOOD)
    write_access(authority.folder)
    written = (authority.folder / "dynamic-security.json").read_text(encoding="utf-8")
    assert f'"vehicle {BAD}"' in written
    assert '"vehicle fleet-backend"' not in written
    shipped = (DEPLOY / "dynamic-security.json").read_text(encoding="utf-8")
    assert shipped == mosquitto_access(["CAR1", "fleet-backend"])
    assert nats_users(["fleet-backend", "CAR1"]) in (DEPLOY / "nats.conf").read_text(encoding="utf-8")
