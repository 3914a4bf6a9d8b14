"""A CAN controller in a SIL Kit simulation as python-can's interface ``silkit``, in coordinated virtual time.

Time passes in steps. A step of this participant waits for its program: for one that sends by the bus's ``clock`` until
all that is due is handed over, for one that reads until there is room. The clock of the machine only tells when a
partner has been waited for too long.
"""

import asyncio
import ctypes
import errno
import logging
import math
import operator
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import can

from can_silkit.observer import Observer, silent_participants

NS_PER_S: Final = 1e9
AHEAD_NS: Final = 250_000_000  # of virtual time: how far a program that sends may be ahead,
NEAR_NS: Final = 50_000_000  # and how near time has come when it goes on, so that threads change seldom
INBOX_FRAMES: Final = 8_192  # a second and a half of a full bus of 500 kbit/s
OUTBOX_FRAMES: Final = 65_536
GATHER_FRAMES: Final = 64  # a reader is woken for so many at once
LONGEST_WAIT_S: Final = 0.02  # of this machine's time: or after so long
LONGEST_STEP_S: Final = 0.1
FAREWELL_NS: Final = 250_000_000  # from the last frame to the end: two of the others' longest steps, so all have it
WORD_S: Final = 10.0  # of this machine's time, each of which a simulation that does not begin is worth a word
STILL_S: Final = 5.0  # of this machine's time without a step, after which whoever holds time is named
PATIENCE_S: Final = 60.0  # of this machine's time without a step, after which the simulation is given up
LOOK_S: Final = 0.25  # how often is looked
NEWS_S: Final = 2.0  # of this machine's time, in which an observer hears of an end as well
EXTENDED, REMOTE, FD, RATE_SWITCH, PASSIVE_SENDER = 1 << 9, 1 << 4, 1 << 12, 1 << 13, 1 << 14  # SIL Kit's frame flags
ERROR: Final = 1 << 31  # ours, for what came as an error event
ERROR_EVENT: Final = struct.Struct("<I8s")  # SocketCAN's error class, and its eight bytes; the sender's name follows
QUIET: Final = "{Logging: {Sinks: []}, Experimental: {TimeSynchronization: {EnableMessageAggregation: Auto}}}"

Outgoing = tuple[int, Callable[..., None], tuple[Any, ...]]  # when it is due [ns], what sends it, with what

_LOG = logging.getLogger(__name__)


class SimulationClock:
    """The virtual time of a simulation, which does not pass what its program waits for.

    Steps are taken in a thread of SIL Kit. Each side writes what the other reads before it looks whether that one
    waits, so that both go on without a lock as long as neither does. A program that sends may be ahead of time, unless
    something is done in each step (``in_each_step``), which then finds what was sent until now and nothing later.
    """

    LEAD_IN_S = 0.0

    def __init__(self, turn: threading.Condition, step_s: float) -> None:
        self._turn = turn
        self.step_s = step_s  # from one step to the next, in which frames leave
        self.is_used = False
        self.tasks: tuple[Callable[[], None], ...] = ()  # that are done in each step
        self.at_work = threading.Lock()  # held meanwhile
        self.time_ns = 0  # of the last step
        self.step_ns = 0  # the same, as soon as the program may go on in it
        self.step_count = 0
        self.due_s, self.due_ns = 0.0, 0  # until here, and not beyond, the program has handed over what it sends
        self.sender: int | None = None  # its thread
        self.wake_ns = sys.maxsize  # when the program wants to go on
        self.is_held = False  # a step waits for the program
        self.end: str | None = None  # why there will be no step any more
        self.has_ended = False  # whether it was the regular end of the simulation

    def now_s(self) -> float:
        """Return the virtual time [s] that the program has reached."""
        return max(self.step_ns / NS_PER_S, self.due_s)

    def step_time_s(self) -> float:
        """Return the virtual time [s] of the simulation: that of the last step."""
        return self.time_ns / NS_PER_S

    @contextmanager
    def in_each_step(self, task: Callable[[], None]) -> Iterator[None]:
        """Have something done in each step while this is entered: frames that it sends leave in that step.

        It is called in a thread of SIL Kit and must raise nothing. What it receives are the frames of earlier steps, in
        the order of their times, so that it does not depend on how busy the machine is. The task that was given last is
        done first.
        """
        self.tasks = (task, *self.tasks)
        try:
            yield
        finally:
            with self.at_work:
                self.tasks = tuple(other for other in self.tasks if other is not task)

    def sleep_until(self, deadline_s: float, stop: threading.Event) -> None:
        """Return when frames may be sent that are due then, or ``stop`` is set; they leave at that time, not before.

        Raises CanOperationError if the simulation has ended.
        """
        self.raise_if_ended()
        self.sender, self.due_s = threading.get_ident(), max(self.due_s, deadline_s)
        self.due_ns = round(self.due_s * NS_PER_S)
        self.let_go()
        ahead_ns, near_ns = (0, 0) if self.tasks else (AHEAD_NS, NEAR_NS)
        if self.step_ns >= self.due_ns - ahead_ns:
            return
        with self._turn:
            self.wake_ns = wake_ns = self.due_ns - near_ns
            while self.step_ns < wake_ns and not stop.is_set():
                self.raise_if_ended()
                self._turn.wait(LONGEST_WAIT_S)
            self.wake_ns = sys.maxsize

    def work(self) -> None:
        """Do what is to be done in each step."""
        if self.tasks:
            with self.at_work:
                for task in self.tasks:
                    task()

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
    with the first that leaves. Frames and errors carry its virtual time. A participant that crashes ends it for all, as
    does one that holds time for longer than ``patience_s``; both are named.

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
    patience_s
        For how long another participant may hold time [s of this machine]; ``inf``: for ever.
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
        patience_s: float = PATIENCE_S,
        bitrate: int = 500_000,
        data_bitrate: int = 2_000_000,
        fd: bool = False,
        receive_own_messages: bool = False,
        **others: Any,  # noqa: ANN401 - python-can's signature
    ) -> None:
        self._is_closed = True  # until it is open: python-can warns of others when they go
        if not 0.0 < float(step_s) <= LONGEST_STEP_S:
            raise ValueError(f"step_s must be above 0 and at most {LONGEST_STEP_S:g} s, got {step_s}")
        if not float(patience_s) > 0.0:
            raise ValueError(f"patience_s must be above 0 s, got {patience_s}")
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
        self._clock = SimulationClock(self._turn, float(step_s))
        self._patience_s = float(patience_s)
        self._inbox: deque[tuple[int, int, int, int, bytes]] = deque()
        self._on_time: deque[Outgoing] = deque()  # by the clock, in the order of their times
        self._at_once: deque[Outgoing] = deque()
        self._is_begun = self._is_reading = self._has_waiting_reader = self._is_leaving = self._has_left = False
        self._step_thread: int | None = None  # that of SIL Kit, in a step
        self._leaves_ns = 0  # virtual time at which all have the last frame
        self._last_ns = sys.maxsize  # virtual time at which to leave, whatever comes later is not heard
        self.dropped = 0  # frames that nobody read
        self._opened_s = time.monotonic()
        self._warn_s = self._opened_s + WORD_S
        self._has_changed = threading.Event()  # what the observer knows
        try:
            self._participant = silkit.create_participant(
                silkit.participant_configuration_from_String(QUIET), self._name, registry
            )
        except RuntimeError as exc:
            raise _refused(registry, self._name, exc) from exc
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
        self._observe(Path(silkit.__file__).with_name("libSilKit.so"), registry)
        self._threads = [
            threading.Thread(target=work, name=f"SIL Kit {name}", daemon=True)
            for name, work in (("lifecycle", self._live), ("watch", self._watch))
        ]
        for thread in self._threads:
            thread.start()
        super().__init__(channel, **others)
        self._is_closed = False

    def _observe(self, path: Path, registry: str) -> None:
        """Begin to look on: last, since the binding waits for all participants and lets no thread of Python run."""
        library, name = ctypes.CDLL(str(path)), f"{self._name} looks on"
        self._ask_who_is_silent = partial(silent_participants, library, f"{self._name} asks", registry)
        try:
            self._observer = Observer(library, name, registry, self._has_changed.set)
        except RuntimeError as exc:
            raise _refused(registry, name, exc) from exc

    @property
    def clock(self) -> SimulationClock:
        """The virtual time; who has asked for it once is waited for in each step."""
        self._clock.is_used = True
        return self._clock

    @property
    def has_ended(self) -> bool:
        """Whether the simulation has come to its regular end, so that there is nothing to wait for."""
        return self._clock.has_ended

    @property
    def time_s(self) -> float:
        """The virtual time [s] of the simulation; who asks is not waited for."""
        return self._clock.step_time_s()

    def leave_at(self, t_s: float) -> None:
        """Leave the simulation at this virtual time [s]; what is sent from then on is not received."""
        self._last_ns = round(t_s * NS_PER_S)

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
            while self._clock.end is None and self._clock.step_count:  # `_watch` ends it if others hold time
                self._turn.wait(LONGEST_WAIT_S)
            self._set_end(f"{self._name} left")
        self._has_changed.set()
        for thread in self._threads:
            thread.join(NEWS_S)
        del self._controller, self._errors, self._lifecycle, self._participant
        self._observer.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if threading.get_ident() == self._step_thread:
            return self._of_earlier_steps(), True
        if not (self._inbox or self._has_come(timeout)):
            return None, False
        received = self._inbox.popleft()
        if len(self._inbox) == INBOX_FRAMES // 2:
            self._clock.let_go()
        return self._message(*received), False

    def _of_earlier_steps(self) -> can.Message | None:
        """Return the first frame that was sent before this step and that the filters let through."""
        while earlier := [received for received in self._inbox if received[0] < self._clock.time_ns]:
            received = min(earlier, key=operator.itemgetter(0, 1))
            self._inbox.remove(received)
            if self._matches_filters(message := self._message(*received)):
                return message
        return None

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
        """Let time pass: the program takes part; say now and then that there is no time yet."""
        self._is_begun = True
        self._clock.let_go()
        if self._clock.step_count == 0 and time.monotonic() > self._warn_s:
            self._warn_s = time.monotonic() + WORD_S
            _LOG.warning(
                "%s: the simulation has not begun for %.0f s; a system controller that names all its participants, "
                "this one included, begins it: silkit-system-controller %s OTHERS",
                self.channel_info, time.monotonic() - self._opened_s, self._name,
            )  # fmt: skip

    def _live(self) -> None:
        """Take part until the simulation ends."""
        while True:  # first of all until the observer has heard of the others
            time.sleep(LOOK_S)
            if self._observer.is_joinable or self._is_leaving:
                break
        try:
            asyncio.run(self._lifecycle.start_lifecycle())
            failure = self._last_failure()
        except Exception as exc:  # noqa: BLE001 - whatever it is, it is the end
            failure = " ".join(str(exc).split())
        with self._turn:
            if failure is None:
                self._set_end("the simulation has ended", is_regular=True)
            else:
                self._set_end(f"the simulation has failed: {failure}")

    def _last_failure(self) -> str | None:
        """Return why the simulation ended, None if in order, once the observer has heard of the end by its own way."""
        deadline_s = time.monotonic() + NEWS_S
        while not self._observer.has_shut_down(self._name) and time.monotonic() < deadline_s:
            time.sleep(LONGEST_WAIT_S)
        return self._failure()

    def _failure(self) -> str | None:
        """Return why the simulation cannot go on, None if it can; who is to blame may be heard a moment later."""
        deadline_s = time.monotonic() + NEWS_S
        while self._observer.failure and not self._observer.errors() and time.monotonic() < deadline_s:
            time.sleep(LONGEST_WAIT_S)
        return self._observer.failure

    def _set_end(self, end: str, *, is_regular: bool = False) -> None:
        """Let the program know, once, that there will be no further step; the turn is held."""
        if self._clock.end is None:
            self._clock.has_ended, self._clock.end = is_regular, end
        self._turn.notify_all()

    def _watch(self) -> None:
        """Name who has crashed or holds time, and end what cannot go on."""
        count, since_s, is_named, told = -1, 0.0, False, set[str]()
        while self._clock.end is None:
            self._has_changed.wait(LOOK_S)
            self._has_changed.clear()
            if (failure := self._failure()) is not None:
                self._give_up(failure)
                return
            for error in self._observer.errors().difference(told):
                told.add(error)
                _LOG.warning("%s: %s; the simulation was not begun with it", self.channel_info, error)
            moved = self._clock.step_count
            if moved != count or not moved or self._clock.is_held or self._observer.is_paused:
                count, since_s, is_named = moved, time.monotonic(), False
                continue
            still_s = time.monotonic() - since_s
            if still_s >= STILL_S and not is_named:
                is_named, names = True, self._who_holds_time()
                _LOG.warning("%s: %s for %.0f s", self.channel_info, names, still_s)
            if still_s >= self._patience_s:
                self._give_up(f"{self._who_holds_time()} for {still_s:.0f} s")
                return

    def _who_holds_time(self) -> str:
        """Return a sentence's beginning about whom the simulation waits for."""
        if names := self._ask_who_is_silent():
            return f"{' and '.join(names)} is stuck or busy in a step and has held time"
        if errors := self._observer.errors():
            return f"{'; '.join(sorted(errors))}; nothing goes on, perhaps until it leaves,"
        others = [name for name in self._observer.running() if name != self._name]
        return f"all answer, but one of {', '.join(others) or 'nobody'} takes no step and has held time"

    def _give_up(self, failure: str) -> None:
        """End the simulation for all who are left: SIL Kit's participants would wait for ever."""
        with self._turn:
            self._set_end(f"the simulation has failed: {failure}")
        try:
            self._observer.abort()
        except RuntimeError as exc:
            _LOG.debug("the others cannot be told: %s", exc)

    def _on_step(self, now_ns: int, _duration_ns: int) -> None:
        """Wait for the program, then send what is due; SIL Kit calls this, and holds the simulation meanwhile."""
        clock = self._clock
        if clock.step_count == 0:  # of SIL Kit's thread: else Python makes and forgets a state of it in each call
            ctypes.pythonapi.PyGILState_Ensure()
        clock.time_ns = now_ns
        self._step_thread = threading.get_ident()
        clock.work()
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
        self._step_thread = None
        for outbox in (self._on_time, self._at_once):
            while outbox and outbox[0][0] <= now_ns:
                _, send, arguments = outbox.popleft()
                send(*arguments)
        if self._is_leaving and not (self._on_time or self._at_once):
            self._leaves_ns = self._leaves_ns or now_ns + FAREWELL_NS
        if not self._has_left and now_ns >= min(self._leaves_ns or sys.maxsize, self._last_ns):
            self._has_left = True
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
        if received[0] >= self._last_ns:
            return
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


def _refused(registry: str, name: str, error: RuntimeError) -> can.CanInitializationError:
    return can.CanInitializationError(
        f"no SIL Kit registry at {registry} takes {name!r}: silkit-registry --listen-uri URI starts one, which takes a "
        f"name once ({' '.join(str(error).split())})"
    )
