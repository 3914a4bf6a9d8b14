"""The health checks of docker-compose.yml, asked of programs that run."""

import json
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.plugins.broker import Mosquitto
from tests.support.image.compose import read_compose
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.replay import INTERFACE, free_bus
from tests.support.service import service

SERVICES = read_compose(Path(__file__).parents[2] / "docker-compose.yml")["services"]


def is_well(name: str, **replaced: str) -> bool:
    """Ask a service's health check as docker does, with other paths and ports."""
    kind, *words = SERVICES[name]["healthcheck"]["test"]
    text = json.dumps(words)
    for old, new in replaced.items():
        text = text.replace({"port": "9464", "alive": "/tmp/alive", "page": "${PAGE_PORT:-8090}"}[old], new)  # noqa: S108 - of the container
    words = json.loads(text)
    words = ["/bin/sh", "-c", *words] if kind == "CMD-SHELL" else [sys.executable, *words[1:]]
    return subprocess.run(words, capture_output=True, check=False, timeout=HANG_S).returncode == 0


def wait_until_well(name: str, program: "subprocess.Popen[str]", **replaced: str) -> bool:
    """Return whether it becomes well before it ends or hangs."""
    pause = threading.Event()
    for _ in range(600):
        if is_well(name, **replaced):
            return True
        if program.poll() is not None:
            return False
        pause.wait(0.3)
    return False


def test_the_service_is_well_while_it_hears_its_bus(tmp_path: Path) -> None:
    bus, port = free_bus(), str(free_port())
    assert not is_well("service", port=port)
    arguments = ("run", "-i", INTERFACE, "-c", bus.group, "--metrics", port, "--store", tmp_path / "car.sqlite")
    with service(tmp_path / "run", *arguments, variables=bus.variables) as running:
        running.wait_for(lambda: is_well("service", port=port))
        running.send(signal.SIGTERM)
        running.wait()
    assert not is_well("service", port=port)


@pytest.mark.broker
def test_a_worker_is_well_while_it_has_broker_and_database(tmp_path: Path, broker: Mosquitto, sqlite_url: str) -> None:
    alive = tmp_path / "alive"
    words = ["ingest", "--broker", f"mqtt://127.0.0.1:{broker.port}", "--database", sqlite_url]
    program = subprocess.Popen(
        [sys.executable, "-m", "fleet_backend", *words, "--alive", str(alive)], stderr=subprocess.PIPE, text=True
    )
    assert wait_until_well("ingest", program, alive=str(alive))
    program.send_signal(signal.SIGTERM)
    program.communicate(timeout=HANG_S)
