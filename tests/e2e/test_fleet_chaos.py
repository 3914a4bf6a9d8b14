"""A short storm over the whole fleet; ``python -m studies.fleet_chaos`` is the long one."""

from pathlib import Path

import pytest

from studies.fleet_chaos import BrokerDisk, Storm, StormPlan

pytestmark = [pytest.mark.broker, pytest.mark.slow]

SHORT = StormPlan(
    edges=2,
    results_per_edge=300,
    storm_s=5.0,
    broker_every_s=2.0,
    worker_every_s=2.5,
    edge_every_s=3.0,
    calm_s=180.0,
    disk=BrokerDisk.DELETED,
)


def test_a_storm_loses_nothing_and_doubles_nothing(tmp_path: Path, postgres_url: str) -> None:
    account = Storm(tmp_path, postgres_url, SHORT).run()
    assert account.drained_s is not None
    assert (account.stored, account.waiting, account.lost, account.is_equal) == (600, 0, 0, True)
    assert min(account.kills.values()) >= 1
