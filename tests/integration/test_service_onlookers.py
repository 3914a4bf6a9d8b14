"""The service's monitor and metrics as a user starts them, on a bus of UDP datagrams; the manager hears of its life."""

import re
import signal
import socket
import urllib.request
from pathlib import Path

import pytest

from tests.support.patience import HANG_S
from tests.support.replay import INTERFACE, Replay, free_bus
from tests.support.service import Service, service

FIRST_SHIFT_DONE_S = 3.2
SOME_SHIFT = r'clutchdiag_shifts_total\{status="\w+"\} [1-9]'


def fetch(running: Service, path: str) -> str:
    """Return what the running service serves, wherever it said that it does."""
    found = re.search(r"metrics on (http://[\d.]+:\d+)/metrics", running.err)
    assert found is not None
    with urllib.request.urlopen(f"{found[1]}{path}", timeout=HANG_S) as answer:  # noqa: S310 - our own server
        return str(answer.read().decode())


@pytest.mark.parametrize("command", ["run", "monitor"])
def test_onlookers_see_a_live_bus(tmp_path: Path, drive_log: Path, command: str) -> None:
    bus = free_bus()
    replay = Replay(bus, drive_log.read_bytes().splitlines())
    store = ("--store", tmp_path / "car.sqlite") if command == "run" else ()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(HANG_S)
        variables = {**bus.variables, "NOTIFY_SOCKET": manager.getsockname()}
        arguments = (command, "-i", INTERFACE, "-c", bus.group, "--metrics", "0", *store)
        with service(tmp_path / command, *arguments, variables=variables) as running:
            running.wait_for(lambda: "metrics on" in running.err)
            sent = replay.send_until(FIRST_SHIFT_DONE_S)
            decoded = f'clutchdiag_frames_total{{fate="decoded"}} {float(sent)}'
            running.wait_for(lambda: decoded in fetch(running, "/metrics"))
            running.wait_for(lambda: re.search(SOME_SHIFT, fetch(running, "/metrics")) is not None)
            assert fetch(running, "/livez") == fetch(running, "/readyz") == "OK\n"
            running.send(signal.SIGTERM)
            ended = running.wait()
        replay.close()
        assert manager.recv(1_000) == b"READY=1"
        assert manager.recv(1_000).startswith(b"WATCHDOG=1\nSTATUS=bus up, ")
    assert ended.status == 0
    assert f"{sent} decoded" in ended.out
    if command == "monitor":
        assert re.search(r"TCU_Shift +[\d.]+ +100\.0 +valid", ended.out)
        assert re.search(r"1-2 +[a-z ]+ 2 +(valid|rejected|unobserved)", ended.out)
