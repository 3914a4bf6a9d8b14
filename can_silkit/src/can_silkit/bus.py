"""A CAN controller in a SIL Kit simulation as python-can's interface ``silkit``, in coordinated virtual time.

Time passes in steps. A step of this participant waits for its program: for one that sends by the bus's ``clock`` until
all that is due is handed over, for one that reads until there is room. Nothing here goes by the clock of the machine.
"""

import asyncio
import ctypes
import errno
import logging
import math
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import can

NS_PER_S: Final = 1e9
AHEAD_NS: Final = 250_000_000  # of virtual time: how far a program that sends may be ahead,
NEAR_NS: Final = 50_000_000  # and how near time has come when it goes on, so that threads change seldom
INBOX_FRAMES: Final = 8_192  # a second and a half of a full bus of 500 kbit/s
OUTBOX_FRAMES: Final = 65_536
GATHER_FRAMES: Final = 64  # a reader is woken for so many at once
LONGEST_WAIT_S: Final = 0.02  # of this machine's time: or after so long
LONGEST_STEP_S: Final = 0.1
FAREWELL_NS: Final = 250_000_000  # from the last frame to the end: two of the others' longest steps, so all have it
PATIENCE_S: Final = 10.0  # of this machine's time, after which a simulation that does not begin is worth a word
GOODBYE_S: Final = 5.0  # of this machine's time without a step, after which nobody waits for the others any more
EXTENDED, REMOTE, FD, RATE_SWITCH, PASSIVE_SENDER = 1 << 9, 1 << 4, 1 << 12, 1 << 13, 1 << 14  # SIL Kit's frame flags
ERROR: Final = 1 << 31  # ours, for what came as an error event
ERROR_EVENT: Final = struct.Struct("<I8s")  # SocketCAN's error class, and its eight bytes; the sender's name follows
QUIET: Final = "{Logging: {Sinks: []}, Experimental: {TimeSynchronization: {EnableMessageAggregation: Auto}}}"

Outgoing = tuple[int, Callable[..., None], tuple[Any, ...]]  # when it is due [ns], what sends it, with what

_LOG = logging.getLogger(__name__)


class SimulationClock:
    """The virtual time of a simulation, which does not pass what its program waits for.

    Steps are taken in a thread of SIL Kit. Each side writes what the other reads before it looks whether that one
    waits, so that both go on without a lock as long as neither does.
    """

    LEAD_IN_S = 0.0

    def __init__(self, turn: threading.Condition) -> None:
        self._turn = turn
        self.is_used = False
        self.step_ns = 0  # when the last step began
        self.step_count = 0
        self.due_s, self.due_ns = 0.0, 0  # until here, and not beyond, the program has handed over what it sends
        self.sender: int | None = None  # its thread
        self.wake_ns = sys.maxsize  # when the program wants to go on
        self.is_held = False  # a step waits for the program
        self.end: str | None = None  # why there will be no step any more

    def now_s(self) -> float:
        """Return the virtual time [s] that the program has reached."""
        return max(self.step_ns / NS_PER_S, self.due_s)

    def sleep_until(self, deadline_s: float, stop: threading.Event) -> None:
        """Return when frames may be sent that are due then, or ``stop`` is set; they leave at that time, not before.

        Raises CanOperationError if the simulation has ended.
        """
        self.raise_if_ended()
        self.sender, self.due_s = threading.get_ident(), max(self.due_s, deadline_s)
        self.due_ns = round(self.due_s * NS_PER_S)
        self.let_go()
        if self.step_ns >= self.due_ns - AHEAD_NS:
            return
        with self._turn:
            self.wake_ns = wake_ns = self.due_ns - NEAR_NS
            while self.step_ns < wake_ns and not stop.is_set():
                self.raise_if_ended()
                self._turn.wait(LONGEST_WAIT_S)
            self.wake_ns = sys.maxsize

    def let_go(self) -> None:
        """Let a step look again whether it still has to wait."""
        if self.is_held:
            with self._turn:
                self._turn.notify_all()

    def raise_if_ended(self) -> None:
        if self.end is not None:
            raise can.CanOperationError(self.end)


class SilKitBus(can.BusABC):
    """A participant with one CAN controller.

    The simulation begins when all participants that its system controller names are there, waits for each, and ends
    with the first that leaves. Frames and errors carry its virtual time.

    Parameters
    ----------
    channel
        The network of SIL Kit, which participants share.
    registry
        Where the registry listens.
    participant
        The name in the simulation; that of the program by default.
    step_s
        From one step to the next [s], at most 0.1: frames leave at whole steps. Who only listens saves time with long
        ones.
    bitrate, data_bitrate
        Told to a network simulator, if there is one [bit/s].
    fd
        Whether frames of CAN FD may be sent.
    receive_own_messages
        Whether what is sent is received as well.

    Raises CanInterfaceNotImplementedError without SIL Kit's binding, CanInitializationError if no registry answers or
    the name is taken.
    """

    waits_for_reader = True  # see canlog.live.pythoncan

    def __init__(
        self,
        channel: str = "CAN1",
        registry: str = "silkit://localhost:8500",
        participant: str | None = None,
        *,
        step_s: float = 0.001,
        bitrate: int = 500_000,
        data_bitrate: int = 2_000_000,
        fd: bool = False,
        receive_own_messages: bool = False,
        **others: Any,  # noqa: ANN401 - python-can's signature
    ) -> None:
        self._is_closed = True  # until it is open: python-can warns of others when they go
        if not 0.0 < float(step_s) <= LONGEST_STEP_S:
            raise ValueError(f"step_s must be above 0 and at most {LONGEST_STEP_S:g} s, got {step_s}")
        try:
            import SilKit_py as silkit  # noqa: PLC0415 - there is none for Python 3.11, which may ask for the reason
        except ImportError as exc:
            raise can.CanInterfaceNotImplementedError(
                "SIL Kit's binding is missing: pip install silkit-py, with Python 3.12 or newer"
            ) from exc
        program = Path(sys.argv[0])  # a script, or a module's __main__.py
        own_name = program.parent.name if program.stem == "__main__" else program.stem
        self._name = participant or own_name.replace("_", "-") or "python-can"
        self._channel, self.channel_info = channel, f"silkit {channel} at {registry} as {self._name}"
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._turn = threading.Condition()
        self._clock = SimulationClock(self._turn)
        self._inbox: deque[tuple[int, int, int, int, bytes]] = deque()
        self._on_time: deque[Outgoing] = deque()  # by the clock, in the order of their times
        self._at_once: deque[Outgoing] = deque()
        self._is_begun = self._is_reading = self._has_waiting_reader = self._is_leaving = False
        self._leaves_ns = 0  # virtual time at which all have the last frame
        self.dropped = 0  # frames that nobody read
        self._warn_s = time.monotonic() + PATIENCE_S
        try:
            self._participant = silkit.create_participant(
                silkit.participant_configuration_from_String(QUIET), self._name, registry
            )
        except RuntimeError as exc:
            raise can.CanInitializationError(
                f"no SIL Kit registry at {registry} takes {self._name!r}: silkit-registry --listen-uri URI starts one, "
                f"which takes a name once ({' '.join(str(exc).split())})"
            ) from exc
        lifecycle = self._participant.create_lifecycle_service(
            silkit.LifecycleConfiguration(silkit.OperationMode.Coordinated)
        )
        self._controller = self._participant.create_can_controller(channel, channel)
        self._hears_itself = receive_own_messages
        directions = silkit.TransmitDirection.TXRX if receive_own_messages else silkit.TransmitDirection.RX
        self._controller.add_frame_handler(self._on_frame, int(directions))
        spec = silkit.PubSubSpec(f"can-silkit/errors/{channel}", "application/vnd.can-silkit.error")
        self._errors = self._participant.create_data_publisher("errors", spec)
        self._participant.create_data_subscriber("heard errors", spec, self._on_error)
        rates = int(bitrate), int(data_bitrate), 0
        controller = self._controller
        lifecycle.set_communication_ready_handler(lambda: (controller.set_baud_rate(*rates), controller.start()))
        lifecycle.create_time_sync_service().set_simulation_step_handler(self._on_step, round(float(step_s) * NS_PER_S))
        self._lifecycle = lifecycle
        threading.Thread(target=self._live, name="SIL Kit lifecycle", daemon=True).start()
        super().__init__(channel, **others)
        self._is_closed = False

    @property
    def clock(self) -> SimulationClock:
        """The virtual time; who has asked for it once is waited for in each step."""
        self._clock.is_used = True
        return self._clock

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - there is nothing to wait for
        """Hand over a frame, which leaves in the next step, or in that for which the clock's program has waited.

        Raises CanOperationError if it is of CAN FD and the bus is not, too many wait, or the simulation has ended.
        """
        if msg.is_fd and self._can_protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError("a frame of CAN FD does not fit a classic bus")
        self._clock.raise_if_ended()
        self._begin()
        if self._clock.sender == threading.get_ident():
            due_ns, outbox = self._clock.due_ns, self._on_time
        else:
            due_ns, outbox = 0, self._at_once
        if len(outbox) >= OUTBOX_FRAMES:
            raise can.CanOperationError(f"{OUTBOX_FRAMES} frames wait for their step", errno.ENOBUFS)
        outbox.append((due_ns, *self._packed(msg)))

    def shutdown(self) -> None:
        """Send what is waiting, then leave the simulation, which ends it for the others; a second call does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        super().shutdown()
        with self._turn:
            self._is_leaving = True
            self._turn.notify_all()
            self._wait_for_end()
            is_stuck = self._clock.end is None and self._clock.step_count and self._leaves_ns < sys.maxsize
        if is_stuck:  # others take no step: they get no last frame, but must not wait for ever
            self._lifecycle.stop(f"{self._name} leaves")
            with self._turn:
                self._wait_for_end()
        del self._controller, self._errors, self._lifecycle, self._participant

    def _wait_for_end(self) -> None:
        """Wait for the end of the simulation as long as it takes steps; the turn is held."""
        count, since_s = 0, time.monotonic()
        while self._clock.end is None and self._clock.step_count and time.monotonic() - since_s < GOODBYE_S:
            if self._clock.step_count != count:
                count, since_s = self._clock.step_count, time.monotonic()
            self._turn.wait(LONGEST_WAIT_S)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not (self._inbox or self._has_come(timeout)):
            return None, False
        received = self._inbox.popleft()
        if len(self._inbox) == INBOX_FRAMES // 2:
            self._clock.let_go()
        return self._message(*received), False

    def _has_come(self, timeout_s: float | None) -> bool:
        deadline_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        self._is_reading = True
        self._begin()
        with self._turn:
            self._has_waiting_reader = True
            while not self._inbox:
                self._clock.raise_if_ended()
                if (left_s := deadline_s - time.monotonic()) <= 0.0:
                    break
                self._turn.wait(min(left_s, LONGEST_WAIT_S))
            self._has_waiting_reader = False
        return bool(self._inbox)

    def _begin(self) -> None:
        """Let time pass: the program takes part; say once if there is no time yet."""
        self._is_begun = True
        self._clock.let_go()
        if self._clock.step_count == 0 and time.monotonic() > self._warn_s:
            self._warn_s = math.inf
            _LOG.warning(
                "%s: the simulation has not begun; a system controller that names all its participants, this one "
                "included, begins it: silkit-system-controller %s OTHERS", self.channel_info, self._name,
            )  # fmt: skip

    def _live(self) -> None:
        """Take part until the simulation ends."""
        try:
            asyncio.run(self._lifecycle.start_lifecycle())
            end = "the simulation has ended"
        except Exception as exc:  # noqa: BLE001 - whatever it is, it is the end
            end = f"the simulation has failed: {' '.join(str(exc).split())}"
        with self._turn:
            self._clock.end = end
            self._turn.notify_all()

    def _on_step(self, now_ns: int, _duration_ns: int) -> None:
        """Wait for the program, then send what is due; SIL Kit calls this, and holds the simulation meanwhile."""
        clock = self._clock
        if clock.step_count == 0:  # of SIL Kit's thread: else Python makes and forgets a state of it in each call
            ctypes.pythonapi.PyGILState_Ensure()
        clock.step_ns = now_ns
        clock.step_count += 1
        has_news = self._has_waiting_reader and len(self._inbox) >= GATHER_FRAMES
        if has_news or clock.wake_ns <= now_ns:
            with self._turn:
                self._turn.notify_all()
        if self._is_waited_for(now_ns):
            with self._turn:
                clock.is_held = True
                while self._is_waited_for(now_ns):
                    self._turn.wait()
                clock.is_held = False
        for outbox in (self._on_time, self._at_once):
            while outbox and outbox[0][0] <= now_ns:
                _, send, arguments = outbox.popleft()
                send(*arguments)
        if self._is_leaving and not (self._on_time or self._at_once):
            self._leaves_ns = self._leaves_ns or now_ns + FAREWELL_NS
            if now_ns >= self._leaves_ns:
                self._leaves_ns = sys.maxsize  # once
                self._lifecycle.stop(f"{self._name} leaves")

    def _is_waited_for(self, now_ns: int) -> bool:
        """Whether the program has something to do before time may go on."""
        is_ahead = self._clock.due_ns > now_ns if self._clock.is_used else self._is_begun
        has_room = not self._is_reading or len(self._inbox) <= INBOX_FRAMES
        return not (self._is_leaving or (is_ahead and has_room))

    def _on_frame(self, _: object, event: Any) -> None:  # noqa: ANN401 - SIL Kit's
        frame = event.frame
        self._keep(event.timestamp, frame.can_id, frame.flags, frame.dlc, frame.data)

    def _on_error(self, _: object, event: Any) -> None:  # noqa: ANN401 - SIL Kit's
        can_id, data = ERROR_EVENT.unpack_from(event.data)
        if self._hears_itself or event.data[ERROR_EVENT.size :] != self._name.encode():  # SIL Kit's events come back
            self._keep(event.timestamp, can_id, ERROR, len(data), data)

    def _keep(self, *received: Any) -> None:  # noqa: ANN401 - what `_message` takes
        if self._is_reading or len(self._inbox) < INBOX_FRAMES:
            self._inbox.append(received)
        else:
            self.dropped += 1

    def _packed(self, msg: can.Message) -> tuple[Callable[..., None], tuple[Any, ...]]:
        if msg.is_error_frame:
            return self._errors.publish, (ERROR_EVENT.pack(msg.arbitration_id, bytes(msg.data)) + self._name.encode(),)
        flags = (
            EXTENDED * msg.is_extended_id + REMOTE * msg.is_remote_frame + FD * msg.is_fd
            + RATE_SWITCH * msg.bitrate_switch + PASSIVE_SENDER * msg.error_state_indicator
        )  # fmt: skip
        return self._controller.send_frame, (msg.arbitration_id, bytes(msg.data), flags, can.util.len2dlc(msg.dlc))

    def _message(self, t_ns: int, can_id: int, flags: int, dlc: int, data: bytes) -> can.Message:
        return can.Message(
            timestamp=t_ns / NS_PER_S, arbitration_id=can_id, dlc=can.util.dlc2len(dlc), data=data,
            channel=self._channel, is_error_frame=bool(flags & ERROR), is_extended_id=bool(flags & EXTENDED),
            is_remote_frame=bool(flags & REMOTE), is_fd=bool(flags & FD), bitrate_switch=bool(flags & RATE_SWITCH),
            error_state_indicator=bool(flags & PASSIVE_SENDER),
        )  # fmt: skip
