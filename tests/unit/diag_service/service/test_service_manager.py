"""What the service manager hears, on a socket of its own."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from diag_service.service.bus_run import ServiceManager
from tests.support.patience import HANG_S


@pytest.fixture(name="manager_socket")
def _manager_socket(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(HANG_S)
        yield heard


def test_a_manager_is_told_the_life_of_the_service(manager_socket: socket.socket) -> None:
    manager = ServiceManager(manager_socket.getsockname())
    manager.ready()
    manager.alive("bus up")
    manager.struggling("stuck in store")
    manager.stopping()
    heard = [manager_socket.recv(200).decode() for _ in range(4)]
    assert heard == ["READY=1", "WATCHDOG=1\nSTATUS=bus up", "STATUS=stuck in store", "STOPPING=1"]
