"""Pytest plugin: a Mosquitto of our own on a free loopback port, which a test may kill, freeze and restart."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from demo.fleet.brokers import Mosquitto

__all__ = ["Mosquitto", "broker", "idle_broker"]


@pytest.fixture
def idle_broker(tmp_path: Path) -> Iterator[Mosquitto]:
    """Return a broker that has not been started."""
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    broker = Mosquitto(folder)
    yield broker
    broker.stop()


@pytest.fixture
def broker(idle_broker: Mosquitto) -> Mosquitto:
    """Return a running broker that lets everyone in."""
    idle_broker.start()
    return idle_broker
