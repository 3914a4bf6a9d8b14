"""Live frames from any other interface of python-can: a thread whose end the service sees, and a recorder for tests."""

import asyncio
import logging
import threading
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any, Final, Self

import can

from canlog.errors import BusEndedError, SourceError
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    Frame,
    FrameBatch,
    batch_of,
)
from canlog.live import multicast
from canlog.live.socketcan import SOCKETCAN, check_interface
from canlog.live.sources import SILENCE_S, BusSilence, FrameQueue, SourceCounts

POLL_S = 0.1  # how soon the thread notices that it shall stop
MESSAGES_PER_BATCH = 256
JOIN_S = 3.0  # for a driver that does not return
MANY_FRAMES = 1_000  # too many to have come at one moment
NOW_S = 5.0  # frames older than this have another clock: no reader is so late
LAST_BATCHES = 64  # what an interface may still hold; bounded, for the bus may never fall silent
NS_PER_US = 1_000
US_PER_S = 1e6

_LOG = logging.getLogger(__name__)


class PythonCanSource:
    """Frames of an open python-can bus, which this object owns from now on unless it is not ``is_owner``.

    python-can keeps times as floating-point seconds; they are rounded to whole microseconds, and a message without one
    gets that of its receipt. What an interface loses before python-can hands it over is not known, so
    ``kernel_dropped`` stays 0. Where frames have other times than this machine's, as those of a simulation, silence is
    not told: in their time it may be short. A bus of which ``waits_for_reader`` is true holds its time back until its
    frames are read; they are read as there is room for them, so that none is dropped. With ``leave_at`` and ``time_s``
    a bus has a time of its own, in which ``duration_s`` counts; ``has_ended`` says that it failed because it is over.
    """

    def __init__(
        self, bus: can.BusABC, description: str, *, is_owner: bool = True, duration_s: float | None = None
    ) -> None:
        self._bus = bus
        self._is_owner = is_owner
        self.description = description
        self._queue = FrameQueue()
        self._received = 0
        self._waits_for_reader = bool(getattr(bus, "waits_for_reader", False))
        self._own_s = 0.0 if self._waits_for_reader else None  # the last time of a bus with a clock of its own
        self._still_ns: int | None = None  # the time of all frames until now
        self.has_own_time = hasattr(bus, "leave_at")
        self._duration_s = duration_s if self.has_own_time else None
        if self._duration_s is not None:
            bus.leave_at(self._duration_s)  # type: ignore[attr-defined]
        self._failure: can.CanError | OSError | ValueError | None = None
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self._read, name="python-can reader", daemon=True)
        self._thread.start()

    @property
    def counts(self) -> SourceCounts:
        return SourceCounts(received=self._received, queue_dropped=self._queue.dropped)

    @property
    def time_s(self) -> float:
        """The time [s] of a bus that has its own."""
        return float(getattr(self._bus, "time_s", 0.0))

    def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence]:
        return aiter(self._queue)

    async def aclose(self) -> None:
        """Take what the interface still holds, then end the thread and the bus; a driver that hangs is left behind."""
        self._is_stopping.set()
        await asyncio.to_thread(self._thread.join, JOIN_S)
        if self._thread.is_alive():
            self._queue.close(SourceError(f"{self.description} does not answer"))

    def _read(self) -> None:
        """Read until `aclose`; the queue is closed however this thread ends."""
        error: SourceError | None = SourceError(f"{self.description}: the reader ended unexpectedly")
        try:
            heard_s: float | None = None  # time of the last frame; None once the silence was marked
            while not self._is_stopping.is_set():
                if self._waits_for_reader and not self._queue.wait_for_room(POLL_S):
                    continue
                asked_s = time.monotonic()
                messages = self._receive(POLL_S)
                self._offer(messages)
                if messages:
                    heard_s = time.monotonic() if _is_of_now(messages[-1]) else None
                elif heard_s is not None and asked_s - heard_s > SILENCE_S:
                    self._queue.mark_silent()
                    heard_s = None
            for _ in range(LAST_BATCHES):
                self._offer(self._receive(0.0))
            error = None
        except (can.CanError, OSError, ValueError) as exc:
            if not getattr(self._bus, "has_ended", False):
                error = SourceError(f"{self.description} cannot be read: {one_line(exc)}")
            elif self._duration_s is not None and self.time_s >= self._duration_s:
                error = None
            else:
                error = BusEndedError(f"{self.description}: {one_line(exc)}")
        finally:
            if self._is_owner:
                self._bus.shutdown()
            self._queue.close(error)

    def _receive(self, timeout_s: float) -> list[can.Message]:
        """Wait for one message, then take those that are there already; a failure comes after those before it."""
        if self._failure is not None:
            raise self._failure
        messages: list[can.Message] = []
        while len(messages) < MESSAGES_PER_BATCH:
            try:
                message = self._bus.recv(timeout=0.0 if messages else timeout_s)
            except (can.CanError, OSError, ValueError) as exc:
                self._failure, message = exc, None
                if not messages:
                    raise
            if message is None:
                break
            self._stamp(message)
            messages.append(message)
        return messages

    def _stamp(self, message: can.Message) -> None:
        """Give a message without a time that of its receipt; where the bus has its own clock, the last one heard."""
        if message.timestamp:
            self._own_s = None if _is_of_now(message) else message.timestamp
        else:
            message.timestamp = time.time() if self._own_s is None else self._own_s

    def _offer(self, messages: Sequence[can.Message]) -> None:
        if not messages:
            return
        batch = to_batch(messages)
        self._check_times(batch)
        self._received += len(batch)
        self._queue.offer(batch)

    def _check_times(self, batch: FrameBatch) -> None:
        """Warn once if the first frames all have the same time."""
        if self._received == 0:
            self._still_ns = int(batch.t_ns[0])
        if self._still_ns is None:
            return
        if (batch.t_ns[: MANY_FRAMES - self._received] != self._still_ns).any():
            self._still_ns = None
        elif self._received + len(batch) >= MANY_FRAMES:
            self._still_ns = None
            _LOG.warning(
                "%s: its first %s frames all have the same time, so nothing can be found in them: "
                "the sender has to give each its own time, or none",
                self.description, f"{MANY_FRAMES:,}",
            )  # fmt: skip


def _is_of_now(message: can.Message) -> bool:
    return abs(time.time() - message.timestamp) < NOW_S


def to_batch(messages: Sequence[can.Message]) -> FrameBatch:
    return batch_of(
        [
            Frame(
                t_ns=round(message.timestamp * US_PER_S) * NS_PER_US,
                can_id=flagged_id(message),
                length=min(message.dlc, FD_PAYLOAD_BYTES if message.is_fd else PAYLOAD_BYTES),
                data=bytes(message.data),
                flags=frame_flags(message),
            )
            for message in messages
        ]
    )


def flagged_id(message: can.Message) -> int:
    """Return the identifier with the flags of frames.py."""
    return (
        message.arbitration_id
        | (EXTENDED_FLAG if message.is_extended_id and not message.is_error_frame else 0)
        | (REMOTE_FLAG if message.is_remote_frame else 0)
        | (ERROR_FLAG if message.is_error_frame else 0)
    )


def frame_flags(message: can.Message) -> int:
    """Return the flags of a message; a classic frame has none."""
    if not message.is_fd:
        return 0
    return FD_FLAG | (BRS_FLAG if message.bitrate_switch else 0) | (ESI_FLAG if message.error_state_indicator else 0)


def open_bus(
    interface: str,
    channel: str | None,
    bitrate: int | None,
    *,
    fd: bool,
    options: Mapping[str, Any] = multicast.NOTHING,
) -> can.BusABC:
    """Open a python-can bus; ``udp_multicast`` keeps to this machine unless ``hop_limit`` is configured.

    Raises SourceError if the interface is unknown, its driver is missing, or the channel cannot be opened.
    """
    if interface == SOCKETCAN:
        check_interface(channel, fd=fd)
    try:
        return multicast.open_bus(interface, channel, bitrate, fd=fd, options=options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, RuntimeError) as exc:
        raise SourceError(f"CAN interface {interface} {channel or ''} cannot be opened: {one_line(exc)}") from exc


def one_line(error: BaseException) -> str:
    """Return the text of a third-party error and of its cause as one line."""
    cause = error.__cause__
    texts = [str(error) or type(error).__name__] + ([str(cause)] if cause is not None else [])
    return " ".join("; ".join(texts).split())


WAIT_S: Final = 0.01


class FrameRecorder(can.Listener):
    """Keeps the frames of an open bus, in the order in which they come, while the ``with`` block runs.

    Parameters
    ----------
    bus
        It is only read, in a thread of its own, and not closed.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._messages: list[can.Message] = []
        self._error: Exception | None = None

    def __enter__(self) -> Self:
        self._notifier = can.Notifier(self._bus, [self], timeout=POLL_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._notifier.stop()
        while self._error is None and (message := self._bus.recv(timeout=0.0)) is not None:
            self._messages.append(message)

    def on_message_received(self, msg: can.Message) -> None:
        self._messages.append(msg)

    def on_error(self, exc: Exception) -> None:
        self._error = exc

    @property
    def messages(self) -> tuple[can.Message, ...]:
        """The frames until now; raises SourceError if the bus has failed."""
        if self._error is not None:
            raise SourceError(f"the bus cannot be read: {one_line(self._error)}") from self._error
        return tuple(self._messages)

    def wait_for(self, count: int, timeout_s: float) -> tuple[can.Message, ...]:
        """Return the frames as soon as there are so many; raises TimeoutError if there are fewer after this time."""
        deadline_s = time.monotonic() + timeout_s
        while len(self.messages) < count:
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s {len(self._messages)} frames, {count} were waited for")
            time.sleep(WAIT_S)
        return self.messages

    def wait_until_quiet(self, quiet_s: float, timeout_s: float) -> tuple[can.Message, ...]:
        """Return the frames when none has come for so long; raises TimeoutError if the bus does not fall silent."""
        deadline_s = time.monotonic() + timeout_s
        count, since_s = len(self.messages), time.monotonic()
        while time.monotonic() - since_s < quiet_s:
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s frames still come, {len(self._messages)} until now")
            time.sleep(WAIT_S)
            if len(self.messages) != count:
                count, since_s = len(self._messages), time.monotonic()
        return self.messages
