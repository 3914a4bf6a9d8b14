"""Live frames from SocketCAN, by a path that neither hangs nor loses frames in silence."""

import asyncio
import errno
import os
import shutil
import socket
import struct
import subprocess
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from canlog.errors import SourceError
from canlog.frames import (
    BRS_FLAG,
    ESI_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    NS_PER_US,
    PAYLOAD_BYTES,
    FrameBatch,
    clear_padding,
)
from canlog.live.bus_clock import BusClock, clock_alarm
from canlog.live.sources import RELAXED_S, SILENCE_S, URGENT_S, BusSilence, FrameQueue, ReadSchedule, SourceCounts

SOCKETCAN = "socketcan"  # as python-can calls it
RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024  # about ten thousand frames: some seconds of a full bus
SO_RCVBUFFORCE = 33  # linux/socket.h
SO_TIMESTAMPNS = 35
ALL_ERROR_CLASSES = 0x1FFF_FFFF
CAN_RAW_ERR_FILTER = 2
SO_MEMINFO = 55
MEMINFO_FORMAT = "9I"
MEMINFO_DROPS = 8  # index of SK_MEMINFO_DROPS


def open_socket(
    channel: str, *, fd: bool, receive_buffer_bytes: int, filters: Sequence[tuple[int, int]] = ()
) -> socket.socket:
    """Return a raw CAN socket, bound, stamping and non-blocking.

    Raises SourceError if this kernel has no CAN, or the interface is not there, not CAN, or down.
    """
    try:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
    except OSError as exc:
        raise opening_failed(channel, exc) from exc
    try:
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, ALL_ERROR_CLASSES)
        if filters:
            packed = b"".join(struct.pack("=II", *can_filter) for can_filter in filters)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        if fd:
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        grow_receive_buffer(raw, receive_buffer_bytes)
        raw.bind((channel,))
        if failure := raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):  # an interface that is down says so here
            raise OSError(failure, os.strerror(failure))  # noqa: TRY301 - one place translates every failure
    except OSError as exc:
        raw.close()
        raise opening_failed(channel, exc) from exc
    return raw


def grow_receive_buffer(opened: socket.socket, size_bytes: int = RECEIVE_BUFFER_BYTES) -> None:
    """Set the receive buffer's size, past the limit of the system if we may; its default loses frames in silence."""
    try:
        opened.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
    except OSError:  # not ours to force, or another system
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)


def let_nothing_in(raw: socket.socket) -> None:
    """Have the kernel give this socket no more frames; those that it holds can still be read."""
    raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
    raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0)


def granted_share(raw: socket.socket) -> float:
    """Return how much of the receive buffer that the schedule counts on the system has granted."""
    granted_bytes = raw.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # the kernel reports twice the size
    return min(1.0, granted_bytes / RECEIVE_BUFFER_BYTES)


def kernel_drops(raw: socket.socket) -> int:
    """Return how many frames the kernel could not put into this socket's receive buffer."""
    memory = raw.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, struct.calcsize(MEMINFO_FORMAT))
    return int(struct.unpack(MEMINFO_FORMAT, memory)[MEMINFO_DROPS])


def named_channel(channel: str | None) -> str:
    """Return the name of an interface; raises SourceError without."""
    if not channel:
        raise SourceError("no CAN channel given: name the interface, for example -i socketcan -c vcan0")
    return channel


def check_interface(channel: str | None, *, fd: bool) -> None:
    """Raise SourceError if an interface cannot be opened: python-can's driver says less, and leaves a socket open."""
    open_socket(named_channel(channel), fd=fd, receive_buffer_bytes=RECEIVE_BUFFER_BYTES).close()


def opening_failed(channel: str, error: OSError) -> SourceError:
    """Say why an interface cannot be opened and what to do about it."""
    match error.errno:
        case errno.EAFNOSUPPORT | errno.EPROTONOSUPPORT:
            return SourceError(
                "this kernel has no CAN sockets (modprobe can-raw), or use another interface: "
                "-i udp_multicast -c 239.74.163.2"
            )
        case errno.ENODEV if not os.path.exists(f"/sys/class/net/{channel}"):  # noqa: PTH110 - a name, not a path
            return SourceError(
                f"no CAN interface {channel!r}: create it (ip link add {channel} type vcan; ip link set {channel} up)"
            )
        case errno.ENODEV:
            return SourceError(f"{channel!r} is not a CAN interface: `ip link show type can` and `type vcan` list them")
        case errno.ENETDOWN:
            return SourceError(f"CAN interface {channel!r} is down: switch it on (ip link set {channel} up)")
        case _:
            return SourceError(f"CAN interface {channel!r} cannot be opened: {error.strerror or error}")


def reading_failed(channel: str, error: OSError) -> SourceError:
    """Say why an interface that was open can no longer be read."""
    match error.errno:
        case errno.ENETDOWN:
            return SourceError(f"CAN interface {channel!r} went down: switch it on (ip link set {channel} up)")
        case errno.ENODEV:
            return SourceError(f"CAN interface {channel!r} was removed")
        case _:
            return SourceError(f"CAN interface {channel!r} cannot be read: {error.strerror or error}")


_SYSTEM_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")
_PATIENCE_S = 10.0


def run_program(program: str, *arguments: str) -> str:
    """Return what a program of the system prints; raises OSError with the reason if it is missing or fails."""
    path = shutil.which(program, path=os.pathsep.join((os.environ.get("PATH", os.defpath), *_SYSTEM_FOLDERS)))
    if path is None:
        raise FileNotFoundError(errno.ENOENT, f"{program} is not installed")
    try:
        ended = subprocess.run(  # noqa: S603 - constant programs, no shell
            [path, *arguments], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
            timeout=_PATIENCE_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise TimeoutError(errno.ETIMEDOUT, f"{program} does not answer") from None
    if ended.returncode:
        raise OSError(errno.EIO, " ".join(ended.stderr.split()) or f"{program} ended with status {ended.returncode}")
    return ended.stdout


def restart_controller(name: str) -> str | None:
    """Ask the kernel to restart a CAN controller that is bus-off; return why it will not, None if it does.

    The kernel permits this to the administrator of the network only, for hardware only, and not where it restarts
    controllers by itself (restart-ms).
    """
    try:
        run_program("ip", "link", "set", name, "type", "can", "restart")
    except OSError as exc:
        return exc.strerror or str(exc)
    return None


SLOTS = 512  # frames that are read at once
CLASSIC_BYTES = 16  # struct can_frame
FD_BYTES = 72  # struct canfd_frame
STAMP = struct.Struct("qq")  # seconds, nanoseconds
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Reception:
    """What one reading brought: frames as columns, and how many there were that are neither CAN nor CAN FD."""

    batch: FrameBatch
    read: int  # all of them
    unsupported: int


class FrameReceiver:
    """Reads a non-blocking raw CAN socket with SO_TIMESTAMPNS switched on."""

    def __init__(self, raw: socket.socket) -> None:
        self._receive = raw.recvmsg
        self._failure: OSError | None = None

    def receive(self) -> Reception:
        """Return what is waiting, at most ``SLOTS`` frames.

        Raises
        ------
        OSError
            As the kernel reports it, once all frames before the failure were returned or are still to be returned;
            also if a frame has no time.
        """
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        packets, stamps = list[bytes](), list[tuple[int, int]]()
        read = 0
        while read < SLOTS:
            try:
                packet, control, _, _ = self._receive(FD_BYTES, socket.CMSG_SPACE(STAMP.size))
            except BlockingIOError:
                break
            except OSError as exc:
                if not read:
                    raise
                self._failure = exc
                break
            read += 1
            if len(packet) not in {CLASSIC_BYTES, FD_BYTES}:
                continue
            stamp = next((data for _, kind, data in control if kind == SO_TIMESTAMPNS), None)
            if stamp is None:
                raise OSError(errno.EPROTO, "the kernel delivered a frame without its time")
            packets.append(packet)
            stamps.append(STAMP.unpack(stamp))
        return Reception(batch=columns_of(packets, stamps), read=read, unsupported=read - len(packets))


def columns_of(packets: Sequence[bytes], stamps: Sequence[tuple[int, int]]) -> FrameBatch:
    """Return frames as the kernel lays them out, and their times, as columns.

    Times are whole microseconds, cut as candump cuts them: a live stream and its recording have identical times.
    """
    is_fd = np.array([len(packet) == FD_BYTES for packet in packets], np.bool_)
    raw = np.frombuffer(b"".join(packet.ljust(FD_BYTES, b"\0") for packet in packets), np.uint8).reshape(-1, FD_BYTES)
    times = np.array(stamps, np.int64).reshape(-1, 2)
    width = FD_PAYLOAD_BYTES if is_fd.any() else PAYLOAD_BYTES
    length = np.minimum(raw[:, 4], np.where(is_fd, FD_PAYLOAD_BYTES, PAYLOAD_BYTES).astype(np.uint8))
    return FrameBatch(
        t_ns=times[:, 0] * NS_PER_S + times[:, 1] // NS_PER_US * NS_PER_US,
        can_id=raw[:, :4].copy().view(np.uint32)[:, 0],
        length=length,
        # The byte of the flags is padding in a classic frame.
        flags=np.where(is_fd, raw[:, 5] & (BRS_FLAG | ESI_FLAG) | FD_FLAG, 0).astype(np.uint8),
        channel=np.zeros(len(packets), np.uint8),
        data=clear_padding(raw[:, 8 : 8 + width], length),
    )


CALLS_PER_WAKE_UP = 8  # 4096 frames, then the rest of the service gets its turn
CROWD = 8 * SLOTS  # frames at one wake-up, twice those of a full bus: the buffer must not fill up


class SocketCanSource:
    """Frames of one SocketCAN interface, among them error frames; it receives from construction on.

    While frames come they gather in the kernel, which notes their times, and the socket is emptied as often as the
    schedule says, whether or not somebody consumes them. Once the bus has fallen silent, the socket itself
    tells when there is a frame.

    The kernel's own counter of frames lost in the receive buffer is read with SO_MEMINFO. SO_RXQ_OVFL would tell
    the same number with the next frame only, and so never the losses after the last one.

    Parameters
    ----------
    channel : str
        Interface name, such as ``vcan0``.
    fd : bool
        Receive CAN FD frames as well; without it the kernel keeps them from this socket, uncounted.
    filters : sequence of (identifier, mask)
        What the kernel lets through besides error frames; everything if empty. What it holds back is not counted.
    receive_buffer_bytes : int
        What to ask of the kernel; without privileges it may grant less.

    Raises
    ------
    SourceError
        If the interface cannot be listened to; the text says what to do.
    """

    def __init__(
        self,
        channel: str,
        *,
        fd: bool = False,
        filters: Sequence[tuple[int, int]] = (),
        receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
        queue: FrameQueue | None = None,
        schedule: ReadSchedule | None = None,
    ) -> None:
        self._channel = channel
        self.description = f"socketcan {channel}"
        self._queue = queue or FrameQueue(linger_s=0.0)
        self._socket: socket.socket | None = open_socket(
            channel, fd=fd, filters=filters, receive_buffer_bytes=receive_buffer_bytes
        )
        self._receiver = FrameReceiver(self._socket)
        self._granted = granted_share(self._socket)
        self._clock = BusClock()
        self._schedule = schedule or ReadSchedule()
        self._schedule.on_change = self._hurry
        self._received = 0
        self._seen_ns: int | None = None  # bus time of the last frame
        self._unsupported = 0
        self._final_drops = 0
        self._failure: SourceError | None = None
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._gathered_s = 0.0  # when the socket was emptied last, as the loop counts
        self._heard_s = self._loop.time()  # latest time at which a frame had come
        self._alarm = clock_alarm()
        if self._alarm is not None:
            self._loop.add_reader(self._alarm, self._see_clock_set)
        self._loop.add_reader(self._socket, self._wake)

    @property
    def counts(self) -> SourceCounts:
        return SourceCounts(
            received=self._received,
            kernel_dropped=self._final_drops if self._socket is None else kernel_drops(self._socket),
            queue_dropped=self._queue.dropped,
            unsupported=self._unsupported,
            clock_steps=self._clock.step_count,
        )

    def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence]:
        return aiter(self._queue)

    async def aclose(self) -> None:
        """Let nothing more in, take what the kernel still holds, then stop."""
        if self._socket is not None:
            let_nothing_in(self._socket)
        while self._socket is not None:
            self._drain(is_last=True)

    def _wake(self) -> None:
        """Begin to empty the socket at regular times; runs at the first frame after a silence."""
        if self._socket is not None:
            self._loop.remove_reader(self._socket)
            self._gather()

    def _gather(self) -> None:
        """Empty the socket, and see to it that this happens again."""
        before = self._received
        self._gathered_s = self._loop.time()
        is_empty = self._drain()
        if self._socket is None:
            return
        if self._received > before:
            self._heard_s = self._loop.time()
        if self._gathered_s - self._heard_s <= SILENCE_S:
            is_crowded = self._received - before > CROWD * self._granted
            gather_s = URGENT_S if is_crowded else self._gather_s()
            self._timer = self._loop.call_later(gather_s if is_empty else 0.0, self._gather)
        else:
            self._timer = None
            self._queue.mark_silent()
            self._loop.add_reader(self._socket, self._wake)

    def _gather_s(self) -> float:
        """Return for how long frames may gather: no longer than a small receive buffer holds a full bus [s]."""
        return min(self._schedule.gather_s(self._seen_ns), max(self._granted * RELAXED_S, URGENT_S))

    def _hurry(self) -> None:
        """Empty the socket earlier than was thought, if what is waited for now comes earlier."""
        when_s = self._gathered_s + self._gather_s()
        if self._timer is not None and when_s < self._timer.when():
            self._timer.cancel()
            self._timer = self._loop.call_at(when_s, self._gather)

    def _see_clock_set(self) -> None:
        if self._alarm is not None and self._alarm.acknowledge():
            self._clock.look()

    def _drain(self, *, is_last: bool = False) -> bool:
        """Move what is waiting from the socket to the queue; return whether nothing is left there."""
        for _ in range(CALLS_PER_WAKE_UP):
            try:
                reception = self._receiver.receive()
            except OSError as exc:
                # A failure overtakes the frames received before it: note it, and read on until nothing is left.
                is_repeated = self._failure is not None
                self._failure = self._failure or reading_failed(self._channel, exc)
                if is_repeated:
                    self._close()
                    return True
                continue
            self._hand_over(reception)
            if reception.read == 0 and (is_last or self._failure is not None):
                self._close()
                return True
            if reception.read < SLOTS and not is_last and self._failure is None:
                self._clock.end_of_backlog()
                return True  # frames that come meanwhile wait for the next time
        return False

    def _hand_over(self, reception: Reception) -> None:
        """Count what one call brought and put it into the queue, in bus time."""
        self._received += reception.read
        self._unsupported += reception.unsupported
        batch = reception.batch
        if not len(batch):
            return
        if self._alarm is None:
            self._clock.look()
        else:
            self._clock.look_if_stale(int(batch.t_ns[-1]))
        times = self._clock.bus_time_ns(batch.t_ns)
        self._seen_ns = int(times[-1])
        self._queue.offer(batch if times is batch.t_ns else replace(batch, t_ns=times))

    def _close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._alarm is not None:
            self._loop.remove_reader(self._alarm)
            self._alarm.close()
            self._alarm = None
        if self._socket is not None:
            self._loop.remove_reader(self._socket)
            self._final_drops = kernel_drops(self._socket)
            self._socket.close()
            self._socket = None
        failure, self._failure = self._failure, None  # once raised it refers to this source
        self._queue.close(failure)
