"""Pacing against a bus that answers as told: order, counts, retries, stopping."""

import errno
import threading
from collections.abc import Callable, Iterator

import can
import pytest

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sender import transmit
from ecu_emulator.errors import BusError
from tests.support.patience import HANG_S
from tests.support.traffic import random_frames


class AnsweringBus(can.BusABC):
    """Keeps what it is given, unless its answer to a frame is an error."""

    def __init__(self, answer: Callable[[int], can.CanError | None] = lambda _: None) -> None:
        super().__init__(channel="nowhere")
        self._answer = answer
        self.attempts = 0
        self.taken: list[can.Message] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        self.attempts += 1
        if (error := self._answer(self.attempts)) is not None:
            raise error
        self.taken.append(msg)


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


def quick_frames(count: int) -> EncodedFrames:
    return random_frames(count, mean_gap_s=20e-6)


def chunks(frames: EncodedFrames, size: int = 7) -> Iterator[EncodedFrames]:
    for first in range(0, len(frames), size):
        yield frames[first : first + size]


def test_all_frames_go_out_in_order_and_are_counted(stop: threading.Event) -> None:
    frames = quick_frames(500)
    with AnsweringBus() as bus:
        report = transmit(bus, chunks(frames), stop)
        assert [bytes(message.data) for message in bus.taken] == [
            data[:length].tobytes() for data, length in zip(frames.data, frames.length, strict=True)
        ]
    assert (report.frames_sent, report.frames_given_up, report.retries, report.is_complete) == (500, 0, 0, True)
    assert 0.0 < report.lateness_p50_s <= report.lateness_p95_s <= report.lateness_p99_s <= report.lateness_max_s
    assert report.duration_s >= frames.t_s[-1]


def test_a_full_buffer_is_tried_again(stop: threading.Event) -> None:
    full = can.CanOperationError("no buffer space", errno.ENOBUFS)
    with AnsweringBus(lambda attempt: full if attempt % 3 == 1 else None) as bus:
        report = transmit(bus, chunks(quick_frames(30)), stop)
    assert report.frames_sent == 30
    assert report.retries == bus.attempts - 30 > 0
    assert report.frames_given_up == 0


def test_a_bus_that_goes_away_ends_the_transmission(stop: threading.Event) -> None:
    down = can.CanOperationError("Failed to transmit", errno.ENETDOWN)
    with (
        AnsweringBus(lambda attempt: down if attempt == 11 else None) as bus,
        pytest.raises(BusError, match="after 10 frames"),
    ):
        transmit(bus, chunks(quick_frames(100)), stop)


def test_a_plant_that_is_too_slow_is_counted(stop: threading.Event) -> None:
    gate = threading.Event()

    def slow() -> Iterator[EncodedFrames]:
        yield quick_frames(3)
        gate.wait(HANG_S)
        yield quick_frames(3)

    def on_progress(_t_s: float, _sent: int) -> None:
        threading.Timer(0.05, gate.set).start()

    with AnsweringBus() as bus:
        report = transmit(bus, slow(), stop, on_progress=on_progress)
    assert report.frames_sent == 6
    assert report.underruns >= 1
