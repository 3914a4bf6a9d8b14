"""An entity on real sockets: several testers, each with what it asked for, and those who misbehave."""

import socket
import struct
import time
from collections.abc import Iterator

import pytest

from tests.support.doip.desk import framed, request
from tests.support.doip.streams import run_on_sockets
from tests.support.doip.tester import Tester, entity
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.uds.wire import Wire
from workshop.controller.doip_server import DoipAddress, DoipServer

EVERYBODY = "127.255.255.255"


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with entity() as (_, server):
        yield server.place.port


def test_everybody_is_asked_who_is_there(port: int) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as one:
        one.settimeout(HANG_S)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for host in ("127.0.0.1", EVERYBODY):
            one.sendto(framed(1), (host, port))
            data, sender = one.recvfrom(100)
            assert data[8:27] == b"WDCTEMUL3TED00047\x10\x11"
            assert sender == ("127.0.0.1", port)


def test_two_testers_are_answered_each_by_its_own(port: int) -> None:
    with Tester(port) as one, Tester(port, 0x0E01) as other:
        one.unlock()
        assert one.ask("22 f1 86") == "62 f1 86 03"
        assert other.ask("22 f1 86") == "62 f1 86 01"
        assert other.ask("10 03") == "7f 10 21"
        one.socket.close()
        while other.ask("10 03") != "50 03 00 32 01 f4":  # the session ends once its connection has
            time.sleep(0.001)
        assert other.ask("2e f1 98 43 4c 55 54 43 48 53 48 4f 50") == "7f 2e 33"


def test_testers_on_can_and_over_ip_share_a_controller_and_not_their_answers() -> None:
    place = DoipAddress(host="127.0.0.1", port=free_port())
    with Wire() as wire, DoipServer(wire.controller, place), Tester(place.port) as one:
        wire.put("02 10 03")
        assert wire.get().startswith("06 50 03")
        assert one.ask("10 03") == "7f 10 21"
        wire.put("02 10 01")
        assert wire.get().startswith("06 50 01")
        one.unlock()
        assert one.first("31 01 03 01 04 04") == "7f 31 78"
        wire.put("02 10 03")
        assert wire.get().startswith("03 7f 10 21")
        wire.controller.finish(0x0301)
        assert one.final().startswith("71 01 03 01")
        wire.put("03 22 f1 86")
        assert wire.get().startswith("04 62 f1 86 01")  # and nothing before it


def test_hostile_streams_do_not_disturb_a_tester() -> None:
    assert run_on_sockets(count=30, seed=5) == 30


def test_one_who_never_reads_and_one_who_breaks_off_do_not_disturb_others(
    port: int, caplog: pytest.LogCaptureFixture
) -> None:
    with Tester(port) as deaf, Tester(port, 0x0E01) as other:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.send(request("19 0a") * 100)
        deaf.socket.settimeout(0.05)
        with pytest.raises(TimeoutError):  # the entity does not read what it could not answer
            deaf.send(request("19 0a") * 1_000_000)
        cut = Tester(port, 0x0E02)
        cut.send(request("22 f1 90", 0x0E02) * 20)
        cut.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        cut.socket.close()
        assert other.ask("22 f1 86") == "62 f1 86 01"
        for address in range(0x0E03, 0x0E20):
            with Tester(port, address) as broken:
                broken.send(request("22 f1 90", address) * 200)
        assert other.ask("22 f1 86") == "62 f1 86 01"
    assert caplog.text == ""
