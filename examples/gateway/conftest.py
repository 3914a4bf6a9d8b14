"""The gateway under test, between two buses."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread

import gateway as program
import pytest

from canlog.live.medium import Medium

FAULT = os.environ.get("GATEWAY_FAULT", "none")


@dataclass(frozen=True)
class Sides:
    """The two buses of the gateway."""

    near: Medium
    far: Medium


@pytest.fixture
def gateway(make_vcan_bus) -> Iterator[Sides]:
    """Start the gateway between two buses; GATEWAY_FAULT injects a fault."""
    sides = Sides(near=make_vcan_bus(), far=make_vcan_bus())
    is_here = sides.near.interface == "virtual"  # such a bus ends at this process
    with thread(sides) if is_here else process(sides):
        yield sides


@contextmanager
def process(sides: Sides) -> Iterator[None]:
    """Run the gateway as the program it is."""
    buses = [json.dumps(bus.can_options) for bus in (sides.near, sides.far)]
    command = [sys.executable, Path(program.__file__), *buses, "--fault", FAULT]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"forwarding\n"
        yield
        running.terminate()


@contextmanager
def thread(sides: Sides) -> Iterator[None]:
    """Run the gateway in this process."""
    is_ready, stop = Event(), Event()
    running = Thread(
        target=program.run, args=(sides.near.can_options, sides.far.can_options, FAULT, stop, is_ready.set)
    )
    running.start()
    assert is_ready.wait(60)
    yield
    stop.set()
    running.join()
