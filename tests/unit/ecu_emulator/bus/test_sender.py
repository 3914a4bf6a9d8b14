"""Pacing against a bus that answers as told: order, counts, retries, stopping."""

import errno
import threading
from collections.abc import Callable, Iterator

import can
import pytest

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sender import SendLateness, clock_of, transmit
from ecu_emulator.errors import BusError
from tests.support.patience import HANG_S
from tests.support.traffic import random_frames

FIRST_LOST, LOST = 11, 20  # frames
DOWN = can.CanOperationError("Failed to transmit", errno.ENETDOWN)


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


class LosingBus(AnsweringBus):
    """Refuses, however often it is asked, some frames that follow each other."""

    def __init__(self, error: can.CanError) -> None:
        super().__init__()
        self._error = error
        self._asked: list[can.Message] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if not any(msg is known for known in self._asked[-1:]):
            self._asked.append(msg)
        if FIRST_LOST < len(self._asked) <= FIRST_LOST + LOST:
            raise self._error
        super().send(msg, timeout)


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


def test_a_full_buffer_is_tried_again(stop: threading.Event, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ecu_emulator.bus.sender.RETRY_FOR_S", HANG_S)  # however slow the machine is
    full = can.CanOperationError("no buffer space", errno.ENOBUFS)
    with AnsweringBus(lambda attempt: full if attempt % 3 == 1 else None) as bus:
        report = transmit(bus, chunks(quick_frames(30)), stop)
    assert report.frames_sent == 30
    assert report.retries == bus.attempts - 30 > 0
    assert report.frames_given_up == 0


@pytest.mark.parametrize(
    ("error", "interruptions"),
    [
        (DOWN, 1),
        (can.CanOperationError("no buffer space", errno.ENOBUFS), 0),
        (can.CanOperationError("Transmit buffer full"), 0),  # how python-can reports a controller that is bus-off
    ],
)
def test_what_is_due_while_no_frame_passes_is_counted_and_the_rest_follows(
    error: can.CanError, interruptions: int, stop: threading.Event
) -> None:
    """Each frame keeps its payload, so what was lost is known by name."""
    frames = quick_frames(200)
    with LosingBus(error) as bus:
        report = transmit(bus, chunks(frames), stop)
    kept = [*range(FIRST_LOST), *range(FIRST_LOST + LOST, 200)]
    assert [(message.arbitration_id, bytes(message.data)) for message in bus.taken] == [
        (int(frames.can_id[row]) & 0x1FFF_FFFF, frames.data[row, : frames.length[row]].tobytes()) for row in kept
    ]
    assert (report.frames_sent, report.frames_given_up) == (200 - LOST, LOST)
    assert (report.interruptions, report.is_complete) == (interruptions, True)


def test_two_interruptions_are_two(stop: threading.Event) -> None:
    with AnsweringBus(lambda attempt: DOWN if attempt in {3, 4, 9} else None) as bus:
        report = transmit(bus, chunks(quick_frames(30)), stop)
    assert (report.frames_sent, report.frames_given_up, report.interruptions, report.retries) == (27, 3, 2, 0)


@pytest.mark.parametrize("lateness_s", [3e-6, 0.0123, 0.7, 95.0])
def test_percentiles_of_lateness_are_never_clipped(lateness_s: float) -> None:
    lateness = SendLateness()
    for _ in range(98):
        lateness.add(0.0, lateness_s)
    for _ in range(2):
        lateness.add(0.0, 7_000.0)
    assert lateness.quantile_s(0.5) == pytest.approx(lateness_s, rel=0.02)
    assert lateness.quantile_s(0.99) == pytest.approx(7_000.0, rel=0.02)


class SteppedClock:
    """The time of a simulation: it passes only as somebody waits for it."""

    LEAD_IN_S = 0.25
    step_s = 0.001

    def __init__(self, last_s: float, *, is_regular: bool = False) -> None:
        self._now_s = 0.0
        self._last_s = last_s
        self._is_regular = is_regular
        self.has_ended = False

    def now_s(self) -> float:
        return self._now_s

    def sleep_until(self, deadline_s: float, stop: threading.Event) -> None:  # noqa: ARG002 - the protocol's
        if deadline_s > self._last_s:
            self.has_ended = self._is_regular
            raise can.CanOperationError("the simulation has ended")
        self._now_s = deadline_s


class PacedBus(AnsweringBus):
    def __init__(self, clock: SteppedClock) -> None:
        super().__init__()
        self.clock = clock


def test_the_regular_end_of_a_simulation_ends_the_transmission(stop: threading.Event) -> None:
    frames = random_frames(2_000, mean_gap_s=1.0)
    with PacedBus(SteppedClock(last_s=100.0, is_regular=True)) as bus:
        report = transmit(bus, chunks(frames), stop, clock=clock_of(bus))
    assert report.frames_sent == len(bus.taken) == int((frames.t_s + 0.25 <= 100.0).sum())
    assert (report.is_complete, report.simulation_ended) == (False, True)


def test_the_clock_of_a_bus_paces_the_frames_and_its_failure_is_an_error(stop: threading.Event) -> None:
    frames = random_frames(2_000, mean_gap_s=1.0)  # half an hour
    with PacedBus(SteppedClock(last_s=1e5)) as bus:
        report = transmit(bus, chunks(frames), stop, clock=clock_of(bus))
    assert [message.timestamp for message in bus.taken] == (0.25 + frames.t_s).tolist()
    assert (report.lateness_max_s, report.underruns, report.overruns) == (0.0, 0, 0)
    assert report.duration_s == pytest.approx(frames.t_s[-1])
    with (
        PacedBus(SteppedClock(last_s=100.0)) as bus,
        pytest.raises(BusError, match=r"the bus went away after \d+ frames: the simulation has ended"),
    ):
        transmit(bus, chunks(frames), stop, clock=clock_of(bus))


def test_a_bus_that_goes_away_ends_the_transmission(stop: threading.Event) -> None:
    gone = can.CanOperationError("Failed to transmit", errno.ENODEV)
    with (
        AnsweringBus(lambda attempt: gone if attempt == 11 else None) as bus,
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
