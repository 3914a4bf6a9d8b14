"""The gateway under test, between two buses."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from canlog.live.medium import Medium

GATEWAY = Path(__file__).with_name("gateway.py")


@dataclass(frozen=True)
class Gateway:
    """Its two sides."""

    near: Medium
    far: Medium


@pytest.fixture
def gateway(make_vcan_bus) -> Iterator[Gateway]:
    """Start the gateway as the program it is; GATEWAY_FAULT injects a fault."""
    sides = Gateway(near=make_vcan_bus(), far=make_vcan_bus())
    process = subprocess.Popen(
        [
            sys.executable,
            GATEWAY,
            json.dumps(sides.near.can_options),
            json.dumps(sides.far.can_options),
            "--fault",
            os.environ.get("GATEWAY_FAULT", "none"),
        ],
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"forwarding\n"
    yield sides
    process.terminate()
    process.wait(timeout=60)
    process.stdout.close()
