"""Requests and responses frame by frame, as ISO 15765-2 writes them, and by another library on a bus."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import isotp
import pytest

from tests.support.patience import HANG_S
from tests.support.uds.full_table import full_table
from tests.support.uds.streams import run
from tests.support.uds.wire import RESPONSE_ID, Wire, parked_controller
from workshop.controller.controller import MemoryFile
from workshop.controller.link import DiagnosticLink
from workshop.controller.state import ServerState
from workshop.controller.table import Transport

VIN = b"\x62\xf1\x90WDCTEMUL3TED00047"


@pytest.fixture
def wire() -> Iterator[Wire]:
    with Wire() as wire:
        yield wire


def test_a_long_response_waits_for_flow_control(wire: Wire) -> None:
    wire.put("03 22 f1 90")
    assert wire.get() == "10 14 62 f1 90 57 44 43"
    wire.put("30 01 00")  # one frame, then ask again
    assert wire.get() == "21 54 45 4d 55 4c 33 54"
    wire.put("31 00 00")  # wait
    wire.put("30 00 00")
    assert wire.get() == "22 45 44 30 30 30 34 37"


class SlowFile(MemoryFile):
    """A memory on a disk that takes its time."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, full_table())
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        self.is_waited_for = threading.Event()

    def save(self, state: ServerState) -> None:
        self.is_waited_for.set()
        assert self.may_go_on.wait(HANG_S)
        super().save(state)


def test_a_client_is_told_to_wait_for_a_slow_disk(tmp_path: Path) -> None:
    with SlowFile(tmp_path / "memory.json") as store, Wire(store=store) as wire:
        store.may_go_on.clear()
        wire.put("04 14 ff ff ff")
        wire.put("03 22 f1 86")
        assert wire.get_any().startswith("03 7f 14 78")
        store.may_go_on.set()
        assert wire.get().startswith("01 54")
        assert wire.get().startswith("04 62 f1 86 01")
        store.may_go_on.clear()
        wire.put("02 11 81")  # no response is wanted, but who hears none within P2 takes this controller for ready
        assert wire.get_any().startswith("03 7f 11 78")
        store.may_go_on.set()
        assert wire.get().startswith("02 51 01")  # once 78 was sent, ISO 14229-1 wants the last word too


@contextmanager
def client(
    channel: str, *, is_fd: bool, transport: Transport, address: isotp.Address
) -> Iterator[Callable[[bytes], bytes]]:
    """Let the library's own threaded client ask a controller on a virtual bus, with other traffic beside it."""
    with (
        can.Bus(channel, "virtual", fd=is_fd) as near,
        can.Bus(channel, "virtual", fd=is_fd) as far,
        DiagnosticLink(parked_controller(transport), near.send, is_fd=is_fd) as link,
        can.Notifier(near, [link.feed]),
        can.Notifier(far, [], timeout=0.05) as notifier,
    ):
        params = {"tx_data_length": 64 if is_fd else 8, "can_fd": is_fd, "stmin": 0xF1, "blocksize": 3}
        stack = isotp.NotifierBasedCanStack(far, notifier, address=address, params=params)
        stack.start()

        def ask(request: bytes) -> bytes:
            far.send(can.Message(arbitration_id=0x0A0, is_extended_id=False, data=bytes(8)))
            stack.send(request)
            while True:
                answer = stack.recv(block=True, timeout=HANG_S)
                assert answer is not None
                if bytes(answer) != bytes((0x7F, request[0], 0x78)):  # the answer takes its time, on a busy machine
                    return bytes(answer)

        yield ask
        stack.stop()


NORMAL = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=RESPONSE_ID)
EXTENDED = isotp.Address(
    isotp.AddressingMode.Extended_11bits, txid=0x7E1, rxid=RESPONSE_ID, source_address=0xF1, target_address=0x18
)


@pytest.mark.parametrize(
    ("is_fd", "transport", "address"),
    [
        (False, Transport(), NORMAL),
        (False, Transport(padding=None, block_size=0, separation_time=0xF1), NORMAL),
        (True, Transport(), NORMAL),
        (False, Transport(own_address=0x18), EXTENDED),
    ],
    ids=["classic", "no padding", "fd", "extended addressing"],
)
def test_another_end_asks_long_and_short(is_fd: bool, transport: Transport, address: isotp.Address) -> None:
    with client("uds transport", is_fd=is_fd, transport=transport, address=address) as ask:
        assert ask(b"\x22\xf1\x90") == VIN
        assert ask(b"\x3e\x00") == b"\x7e\x00"
        assert ask(b"\x22" + b"\xf1\x90" * 16) == b"\x62" + VIN[1:] * 16
        assert ask(b"\x2e\xf1\x98" + bytes(1000)) == b"\x7f\x2e\x7f"
        assert len(ask(b"\x19\x0a")) == 3 + 4 * 25


def test_hostile_streams_end_nothing() -> None:
    figures = run(count=150, seed=5)
    assert (figures.streams, figures.unanswered) == (150, 0)
    assert figures.frames > 1000
