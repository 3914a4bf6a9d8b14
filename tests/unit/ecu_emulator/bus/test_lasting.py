"""A bus that is lost while an emulator sends: opened again, said once, nothing lost but what was due meanwhile."""

import errno
import threading
import time
from collections.abc import Callable

import can
import pytest

from ecu_emulator.bus.lasting import LastingBus, lasting
from ecu_emulator.bus.sender import transmit
from ecu_emulator.errors import BusError
from tests.support.patience import HANG_S
from tests.support.traffic import random_frames

Failure = can.CanError | OSError
FRAME = can.Message(arbitration_id=0x10, data=b"\1", is_extended_id=False)


class Adapter(can.BusABC):
    """One opening of an adapter, which fails from some frame on, and is silent."""

    def __init__(self, failure: Failure | None = None, after: int = 0) -> None:
        super().__init__(channel="adapter")
        self.channel_info = "an adapter"
        self._failure, self._after = failure, after
        self.taken: list[can.Message] = []
        self.is_shut = False
        self.given_filters: object = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        if self._failure is not None and len(self.taken) >= self._after:
            raise self._failure
        self.taken.append(msg)

    def shutdown(self) -> None:
        super().shutdown()
        self.is_shut = True

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        return can.Message(arbitration_id=0x7E0, is_extended_id=False), True

    def _apply_filters(self, filters: object) -> None:
        self.given_filters = filters


class Socket:
    """Where adapters are plugged in: the first, nothing for some attempts, then the next."""

    def __init__(self, *adapters: Adapter, missing: int = 3) -> None:
        self._adapters = list(adapters)
        self._missing = missing
        self.attempts = 0

    def open(self) -> can.BusABC:
        self.attempts += 1
        if 1 < self.attempts <= 1 + self._missing or not self._adapters:
            raise BusError("there is no adapter")
        return self._adapters.pop(0)


def until(is_so: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not is_so():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@pytest.mark.parametrize(
    "failure",
    [
        can.CanOperationError("Failed to transmit", errno.ENODEV),
        can.CanOperationError("Failed to transmit", errno.ENXIO),
        can.CanOperationError("Failed to transmit", errno.ENETDOWN),
        OSError(errno.EIO, "the serial port is gone"),
    ],
    ids=str,
)
def test_an_adapter_that_is_pulled_is_waited_for_and_sent_on(failure: Failure) -> None:
    first, second = Adapter(failure, after=20), Adapter()
    socket, said = Socket(first, second), list[str]()
    stop = threading.Event()
    with lasting(socket.open, "serial port", said.append) as bus:
        report = transmit(bus, iter([random_frames(400, mean_gap_s=3e-3)]), stop)
    assert (len(first.taken), report.interruptions, report.is_complete) == (20, 1, True)
    assert len(second.taken) > 0
    assert report.frames_sent == len(first.taken) + len(second.taken) == 400 - report.frames_given_up
    lost, back = said
    assert lost.startswith("serial port is lost: ")
    assert lost.endswith("; waiting for its return")
    assert back.startswith("serial port is there again after ")
    assert (first.is_shut, second.is_shut) == (True, True)


def test_it_is_said_once_however_often_it_is_opened_in_vain() -> None:
    """As a driver does that opens without its adapter, and fails at the first frame."""
    gone = can.CanOperationError("no hardware", errno.ENODEV)
    last, said = Adapter(), list[str]()
    bus = lasting(Socket(*(Adapter(gone) for _ in range(3)), last, missing=0).open, "pcan", said.append)

    def passes() -> bool:
        try:
            bus.send(FRAME)
        except can.CanError:
            return False
        return True

    with bus:
        until(passes)
    assert len(said) == 2
    assert last.taken == [FRAME]


def test_an_error_of_an_adapter_without_a_known_code_is_a_loss_when_it_lasts() -> None:
    unknown = can.CanOperationError("PCAN_ERROR_ILLHW", 0x1400)
    said: list[str] = []
    for stuck_s, lines in ((None, 0), (HANG_S, 0), (0.0, 1)):
        first = Adapter(unknown)
        with LastingBus(first, "pcan", Socket().open, said.append, stuck_s=stuck_s) as bus:
            for _ in range(8):
                time.sleep(1e-3)
                with pytest.raises(can.CanError):
                    bus.send(FRAME)
        assert len(said) == lines


def test_a_full_buffer_is_no_loss() -> None:
    full = can.CanOperationError("no buffer space", errno.ENOBUFS)
    said: list[str] = []
    with LastingBus(Adapter(full), "can0", Socket().open, said.append, stuck_s=None) as bus:
        for _ in range(3):
            with pytest.raises(can.CanOperationError, match="no buffer space"):
                bus.send(FRAME)
    assert said == []


def test_what_is_heard_and_filtered_goes_on_behind_a_loss() -> None:
    gone = can.CanOperationError("gone", errno.ENODEV)
    second = Adapter()
    with lasting(Socket(Adapter(gone), second).open, "pcan", lambda _: None) as bus:
        filters: list[can.typechecking.CanFilter] = [{"can_id": 0x7E0, "can_mask": 0x7FF}]
        bus.set_filters(filters)
        with pytest.raises(can.CanError):
            bus.send(FRAME)
        assert bus.recv(0.0) is None  # away
        until(lambda: bus.recv(0.01) is not None)
    assert second.given_filters == filters


def test_a_bus_that_cannot_be_opened_at_first_is_an_error() -> None:
    with pytest.raises(BusError, match="there is no adapter"):
        lasting(Socket().open, "pcan", lambda _: None)


def test_it_is_closed_while_it_is_away() -> None:
    first = Adapter(can.CanOperationError("gone", errno.ENODEV))
    socket = Socket(first, missing=1_000_000)
    with lasting(socket.open, "", lambda _: None) as bus:
        with pytest.raises(can.CanError):
            bus.send(FRAME)
        until(lambda: socket.attempts > 2)
    assert first.is_shut
    assert not [thread for thread in threading.enumerate() if thread.name == "bus opener"]
