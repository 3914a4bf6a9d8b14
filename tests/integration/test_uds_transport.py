"""Requests and responses frame by frame, as ISO 15765-2 writes them, and by another library on a bus."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import isotp
import pytest

from ecu_emulator.diagnostics.link import MOST_FRAMES, MOST_REQUESTS, DiagnosticLink
from ecu_emulator.diagnostics.memory import TestResult as Result
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.state import ServerState
from ecu_emulator.diagnostics.table import Transport
from tests.support.patience import HANG_S
from tests.support.uds.full_table import full_table
from tests.support.uds.streams import run
from tests.support.uds.wire import ALL_ID, RESPONSE_ID, Wire, parked_controller

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


@pytest.mark.parametrize(("own_address", "before"), [(None, ""), (0x18, "f1 ")])
def test_periodic_data_come_in_frames_of_their_own_as_long_as_they_are(own_address: int | None, before: str) -> None:
    with Wire(Transport(padding=None, own_address=own_address)) as wire:
        to = "" if own_address is None else f"{own_address:02x} "
        wire.put(f"{to}02 10 03")
        assert wire.get().startswith(f"{before}06 50 03")
        wire.put(f"{to}03 2a 02 00")
        assert wire.get() == f"{before}01 6a"
        assert [wire.get_periodic() for _ in range(2)] == [f"{before}00 0c af 00 00 00 ff"] * 2
    assert wire.link.counts.periodic >= 2


def test_a_request_to_all_is_a_single_frame(wire: Wire) -> None:
    wire.put("02 3e 00", ALL_ID)
    assert wire.get().startswith("02 7e 00")
    wire.put("10 08 22 f1 90 f1 90 f1", ALL_ID)
    wire.put("02 84 00", ALL_ID)  # not supported, and not only this controller was asked
    assert wire.is_quiet()


def test_requests_that_come_while_a_response_goes_out_wait_up_to_a_number(wire: Wire) -> None:
    wire.put("03 22 f1 90")
    wire.get()
    for _ in range(MOST_REQUESTS + 3):
        wire.put("03 22 f1 86")
    wire.put("02 3e 80")
    wire.put("30 00 00")
    answers = [wire.get() for _ in range(2 + MOST_REQUESTS)]
    assert answers[2:] == ["04 62 f1 86 01 cc cc cc"] * MOST_REQUESTS
    assert wire.is_quiet()
    assert wire.link.counts.dropped_requests == 3


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


def test_whom_78_has_promised_a_response_gets_one_that_others_would_not(tmp_path: Path) -> None:
    """ISO 14229-1: after 78 the final response comes in any case, also one that stays unsaid on a request to all."""
    with SlowFile(tmp_path / "memory.json") as store, Wire(store=store) as wire:
        store.may_go_on.clear()
        store.is_waited_for.clear()
        monitor = threading.Thread(target=wire.controller.report, args=(0x081107, Result.FAILED))
        monitor.start()
        try:
            assert store.is_waited_for.wait(HANG_S)
            wire.put("03 22 12 34", ALL_ID)
            assert wire.get_any().startswith("03 7f 22 78")
        finally:
            store.may_go_on.set()
        assert wire.get().startswith("03 7f 22 31")
        monitor.join()


def test_a_flood_is_bounded_and_counted() -> None:
    link = DiagnosticLink(parked_controller(), lambda _: None)  # nobody looks at the frames yet
    for _ in range(MOST_FRAMES + 7):
        link.feed(can.Message(arbitration_id=0x7E1, is_extended_id=False, data=b"\x02\x3e\0"))
    assert link.counts.dropped_frames == 7


def test_a_bus_that_takes_nothing_does_not_end_the_link() -> None:
    heard = threading.Event()
    is_down = True

    def send(message: can.Message) -> None:
        if is_down:
            raise can.CanOperationError("full")
        heard.set()

    with DiagnosticLink(parked_controller(), send) as link:
        request = can.Message(arbitration_id=0x7E1, is_extended_id=False, data=b"\x02\x3e\0")
        link.feed(request)
        deadline_s = time.monotonic() + HANG_S
        while not link.counts.unsent_frames and time.monotonic() < deadline_s:
            time.sleep(0.005)
        is_down = False
        link.feed(request)
        assert heard.wait(HANG_S)


def test_what_goes_wrong_in_the_thread_is_raised_where_it_was_started(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = parked_controller()
    monkeypatch.setattr(controller, "tick", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError), DiagnosticLink(controller, lambda _: None) as link:
        link._thread.join(HANG_S)


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
