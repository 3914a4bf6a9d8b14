"""A second emulator on one bus is noticed and said, whatever the bus hears of itself."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from canlog.live.multicast import MulticastBus
from ecu_emulator.live import WORTH_SAYING, OtherSenders
from tests.support.patience import HANG_S
from tests.support.replay import UdpBus, free_bus
from tests.support.service import service

OWN = (0x0A0, 0x0B0)

Ends = tuple[can.BusABC, can.BusABC]


@contextmanager
def two_ends(kind: str, channel: str) -> Iterator[Ends]:
    if kind in {"virtual", "socketcan"}:
        with can.Bus(channel, kind) as near, can.Bus(channel, kind) as far:
            yield near, far
        return
    place, hops = free_bus(), 0 if kind == "this machine" else 1
    with MulticastBus(place.group, place.port, hops) as near, MulticastBus(place.group, place.port, hops) as far:
        yield near, far


@pytest.fixture(params=["virtual", "this machine", "network", pytest.param("socketcan", marks=pytest.mark.vcan)])
def ends(request: pytest.FixtureRequest) -> Iterator[Ends]:
    channel = str(request.getfixturevalue("vcan")) if request.param == "socketcan" else "others"
    with two_ends(str(request.param), channel) as both:
        yield both


def send(bus: can.BusABC, can_id: int, count: int, *, is_extended: bool = False) -> None:
    for _ in range(count):
        bus.send(can.Message(arbitration_id=can_id, is_extended_id=is_extended, data=b"\x01"))


def wait_for(others: OtherSenders, count: int) -> None:
    """Wait until so many frames were counted, or for a hang."""
    pause = threading.Event()
    for _ in range(1_200):
        if others.frame_count >= count:
            return
        pause.wait(0.05)


def test_the_frames_of_another_sender_are_counted_and_said_once(ends: Ends) -> None:
    near, far = ends
    heard: list[int] = []
    with OtherSenders(near, OWN, heard.append) as others:
        send(near, OWN[0], 50)
        send(far, OWN[1], 3 * WORTH_SAYING)
        wait_for(others, 3 * WORTH_SAYING)
    assert (heard, others.frame_count) == ([OWN[1]], 3 * WORTH_SAYING)


def start(bus: UdpBus) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "ecu_emulator",
            "run",
            "-i",
            "udp_multicast",
            "-c",
            bus.group,
            "--cycles",
            "9",
            "--json",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **bus.variables},
    )


def end(programs: "Sequence[subprocess.Popen[str]]") -> None:
    for program in programs:
        program.kill()


def test_two_emulators_on_one_group_both_say_so_and_the_service_too(tmp_path: Path) -> None:
    place = free_bus()
    listening = ("run", "-i", "udp_multicast", "-c", place.group, "--store", tmp_path / "car.sqlite")
    with (
        service(tmp_path / "run", *listening, variables=place.variables) as listener,
        start(place) as first,
        start(place) as second,
    ):
        programs = (first, second)
        watchdog = threading.Timer(HANG_S, end, [programs])
        watchdog.start()
        for program in programs:
            assert program.stderr is not None
            warning = next((line for line in program.stderr if line.startswith("warning: ")), "")
            assert "another sender" in warning
            assert "second emulator" in warning
        listener.wait_for(lambda: "two senders use the same identifiers" in listener.err)
        listener.send(signal.SIGTERM)
        listener.wait()
        for program in programs:
            program.send_signal(signal.SIGINT)
        for program in programs:
            out, said = program.communicate()
            assert json.loads(out)["foreign_frames"] >= WORTH_SAYING
            assert "came from another sender" in said
        watchdog.cancel()
