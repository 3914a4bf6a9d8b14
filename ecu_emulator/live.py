"""A drive onto a bus in real time: faults asked for meanwhile, and the truth of every shift once it is sent."""

import logging
import os
import socket
import stat
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from threading import Event
from typing import Any, Final, Protocol, Self

import can
import can.typechecking

from canlog.e2e.message_contract import message_contracts
from canlog.live.multicast import NOTHING
from clutchdiag_io.files import give_sign, make_sign
from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.lasting import lasting
from ecu_emulator.bus.pace import SendingPace, WallPace, pace_of
from ecu_emulator.bus.sender import CHUNKS_AHEAD, TransmitReport, WallClock, clock_of, open_bus, transmit
from ecu_emulator.drive.orders import NO_CODES, FaultsOfCode, LiveOrders, Ordered, follow
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive, DriveStretch
from ecu_emulator.errors import EmulatorConfigError, RecordError
from ecu_emulator.progress import driven_text, people, print_json
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.sensing import MS_PER_S
from ecu_emulator.truth import EventTruth, Happened, ShiftTruth, Totals, TruthLog, TruthWriter, known_at_s, truth_log

LINE_BYTES: Final = 4096
POLL_S: Final = 0.2  # how soon the end of the drive is noticed
IDLE_S: Final = 30.0  # a caller who says nothing is left
OWNER_ONLY: Final = 0o177  # umask


class ControlSocket:
    """Listens while the ``with`` block runs, in threads of its own.

    Parameters
    ----------
    path
        Where the socket shall be; one that a dead process left there is replaced.
    drive
        Is given every order, in those threads; what it raises as ConfigError is the caller's answer.
    faults_of_code
        Faults that lead to each trouble code.

    Raises
    ------
    RecordError
        If the socket cannot be made, or another process listens there.
    """

    def __init__(self, path: Path, drive: Ordered, faults_of_code: FaultsOfCode = NO_CODES) -> None:
        class Caller(StreamRequestHandler):
            timeout = IDLE_S

            def handle(self) -> None:
                with suppress(OSError):  # a caller that goes away is no concern of the drive
                    while (line := self.rfile.readline(LINE_BYTES)).endswith(b"\n"):
                        self.wfile.write(f"{follow(line, drive, faults_of_code)}\n".encode())
                    if len(line) == LINE_BYTES:
                        self.wfile.write(f"error: a line has less than {LINE_BYTES} bytes\n".encode())

        self._path = path
        before = os.umask(OWNER_ONLY)
        try:
            _remove_dead(path)
            self._server = ThreadingUnixStreamServer(str(path), Caller)
        except OSError as exc:
            raise RecordError(f"cannot listen at {path}: {exc.strerror or exc}") from exc
        finally:
            os.umask(before)
        self._server.daemon_threads, self._server.block_on_close = True, False
        self._thread = threading.Thread(target=self._server.serve_forever, args=(POLL_S,), name="control", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        with suppress(OSError):
            self._path.unlink()


def _remove_dead(path: Path) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise RecordError(f"cannot listen at {path}: there is a file")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
            try:
                caller.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
            else:
                raise RecordError(f"cannot listen at {path}: another process listens there already")


@dataclass(frozen=True, slots=True, kw_only=True)
class SendPace:
    """How far ahead of the bus a drive is computed."""

    stretch_s: float
    stretches_ahead: int


STEADY: Final = SendPace(stretch_s=SHORT_STRETCH_S, stretches_ahead=CHUNKS_AHEAD)  # two seconds: punctual
AHEAD: Final = SendPace(stretch_s=2.0, stretches_ahead=2)  # in virtual time, which waits: the least work
PROMPT: Final = SendPace(stretch_s=0.02, stretches_ahead=3)  # with the stretch that is sent, an order waits for 80 ms


class SentTruth:
    """Yields a drive's frames, and writes the truth of what happened once its frames have been sent.

    Parameters
    ----------
    drive
        Whose frames are sent.
    writer
        Writes what is true, as it becomes known.
    max_truths
        How many truths ``log`` holds at most: the latest ones.
    pace
        How far ahead it is driven.
    """

    def __init__(
        self, drive: Drive, writer: TruthWriter | None, max_truths: int = 0, *, pace: SendPace = STEADY
    ) -> None:
        self.drive: Final = drive
        self.orders: Final = LiveOrders(drive)
        self.pace: Final = pace
        self._writer = writer
        self._ahead: deque[Happened] = deque()  # filled by the thread that drives
        self._happened: deque[Happened] = deque(maxlen=max_truths)
        self._totals: Totals | None = None
        self.shift_count = 0
        self.event_count = 0
        self.sent_s = 0.0
        if writer is not None:
            writer.write(drive.truth)

    @property
    def log(self) -> TruthLog:
        """The truth about what has been sent; any thread may ask."""
        return truth_log(self.drive.truth, self._happened.copy(), self._totals)

    def frames(self, stop: Event) -> Iterator[EncodedFrames]:
        """Drive until ``stop`` is set, and yield what is to be sent; may run in a thread of its own."""
        for stretch in self.drive.stretches(self.pace.stretch_s):
            self._ahead.extend(stretch.truths)
            yield stretch.frames
            self.orders.stay(stop)
            if stop.is_set():
                return

    def take(self, stretch: DriveStretch) -> None:
        """Take note of a stretch whose frames somebody else sends at once."""
        self._ahead.extend(stretch.truths)
        self.sent_until(stretch.end_s)

    def sent_until(self, t_s: float) -> None:
        """Write what had happened by this scenario time [s]."""
        self.sent_s = t_s
        while self._ahead and known_at_s(self._ahead[0]) <= t_s:
            truth = self._ahead.popleft()
            self._happened.append(truth)
            if self._writer is not None:
                self._writer.write(truth)
            self.shift_count += isinstance(truth, ShiftTruth)
            self.event_count += isinstance(truth, EventTruth)

    def finish(self, report: TransmitReport) -> None:
        """Write what is left, and the totals of what was sent."""
        if report.is_complete:
            self.sent_until(self.drive.totals.duration_s)
        self._totals = replace(
            self.drive.totals,
            shifts=self.shift_count,
            events=self.event_count,
            duration_s=self.sent_s,
            frames=report.frames_sent,
        )
        if self._writer is not None:
            self._writer.write(self._totals)


MIXED_BUS: Final = (
    "warning: another sender on this bus uses this emulator's identifiers ({:03X} for one), "
    "probably a second emulator; nothing can be estimated from a mixture: give each a bus of its own"
)
LONGEST_STEP_RATIO: Final = 0.5  # of the shortest cycle; 20 of 20 shifts are valid with it, 10 with a whole cycle
WORTH_SAYING: Final = 10  # frames; fewer may be the last ones of an emulator that has just been stopped
STANDARD_MASK: Final = 0x7FF
EXTENDED_MASK: Final = 0x1FFFFFFF


class OtherSenders:
    """Counts frames on a bus that carry given identifiers and that this bus object did not send, while entered.

    Parameters
    ----------
    bus
        An open bus that does not hear itself; it is only read here, in a thread of its own, through a filter.
    can_ids
        Standard identifiers that nobody else should send.
    on_heard
        Called once, in that thread, with the identifier of a frame, as soon as it cannot be chance.
    wanted_ids, pass_on
        Identifiers of frames that somebody else on this end wants, and who is handed them, in that thread.
    pace
        In whose time it listens.
    """

    def __init__(
        self,
        bus: can.BusABC,
        can_ids: Sequence[int],
        on_heard: Callable[[int], None],
        *,
        wanted_ids: Sequence[int] = (),
        pass_on: Callable[[can.Message], None] = lambda _: None,
        pace: SendingPace | None = None,
    ) -> None:
        self._bus = bus
        self._can_ids = frozenset(can_ids)
        self._on_heard = on_heard
        self._wanted_ids = tuple(wanted_ids)
        self._pass_on = pass_on
        self._pace = WallPace() if pace is None else pace
        self._stack = ExitStack()
        self.frame_count = 0

    def __enter__(self) -> Self:
        self._bus.set_filters([_filter(can_id) for can_id in (*sorted(self._can_ids), *self._wanted_ids)])
        self._stack.enter_context(self._pace.listening(self._listen, "other senders"))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _listen(self, timeout_s: float) -> bool:
        try:
            message = self._bus.recv(timeout=timeout_s)
        except (can.CanError, OSError, ValueError):
            time.sleep(timeout_s)  # whoever sends will say what is wrong with the bus
            return False
        if message is None:
            return False
        is_plain = not (message.is_error_frame or message.is_extended_id)
        if not is_plain or message.arbitration_id not in self._can_ids:
            self._pass_on(message)
            return True
        self.frame_count += 1
        if self.frame_count == WORTH_SAYING:
            self._on_heard(message.arbitration_id)
        return True


def _filter(can_id: int) -> can.typechecking.CanFilter:
    is_extended = can_id > STANDARD_MASK
    return {"can_id": can_id, "can_mask": EXTENDED_MASK if is_extended else STANDARD_MASK, "extended": is_extended}


@dataclass(frozen=True, slots=True, kw_only=True)
class BusChoice:
    """Which bus to open; None leaves the choice to python-can's configuration."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    is_fd: bool

    @property
    def name(self) -> str:
        """What the user asked for, empty if it is left to the configuration."""
        return " ".join(part for part in (self.interface, self.channel) if part)

    def opened(self, say: Callable[[str], None], options: Mapping[str, Any] = NOTHING) -> can.BusABC:
        """Return the bus, kept open while it is used; ``say`` gets a line when it is lost, and when it is back.

        ``options`` are more arguments of its driver. Raises BusError if it cannot be opened at first.
        """
        return lasting(
            partial(open_bus, self.interface, self.channel, self.bitrate, fd=self.is_fd, options=options),
            self.name,
            say,
        )


class BusEnd(Protocol):
    """Where a controller that answers hears the bus."""

    @property
    def can_ids(self) -> Sequence[int]:
        """The identifiers that it listens to."""

    def feed(self, message: can.Message) -> None:
        """Take a frame of one of them."""


class AnsweringController(AbstractContextManager["AnsweringController"], Protocol):
    """A controller that answers testers; frames of the drive go out through it."""

    @property
    def link(self) -> BusEnd:
        """Where it hears the bus."""

    @property
    def faults_of_code(self) -> FaultsOfCode:
        """The faults that lead to each of its trouble codes, as far as they are known."""

    @property
    def places(self) -> Sequence[str]:
        """Where else than on the bus it can be asked, for people."""

    @property
    def outcome(self) -> Mapping[str, object]:
        """What was asked, for programs."""

    @property
    def summary(self) -> str:
        """The same for people."""

    def send(self, message: can.Message) -> None:
        """Put a frame on the bus, unless a tester has forbidden that."""


class AnswersTesters(Protocol):
    """What opens a controller that answers testers; raises ConfigError, RecordError, BusError if that cannot be."""

    def opened(self, bus: can.BusABC, choice: BusChoice, drive: Drive) -> AnsweringController:
        """Return the controller, which answers while it is entered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SendOptions:
    """What is written beside a drive on a bus, and how long it pauses."""

    truth: Path | None
    control: Path | None
    alive: Path | None
    longest_stay_s: float
    is_json: bool


def run(
    scenario: Scenario, choice: BusChoice, options: SendOptions, answers: AnswersTesters | None, stop: Event
) -> None:
    """Stream a drive onto a bus in real time and report how punctual it was; a request to stop ends it in order.

    Raises ConfigError, BusError, RecordError if the scenario's truth is not possible, the bus cannot be used, or a file
    cannot be written.
    """
    logging.getLogger("can").setLevel(logging.CRITICAL)  # python-can logs what it raises, and more when a bus goes
    console = people()
    drive = Drive(scenario, options.longest_stay_s)
    with (
        choice.opened(lambda line: console.print(line, markup=False)) as bus,
        answering_of(answers, bus, choice, scenario, drive) as answering,
        ExitStack() as begun,
    ):
        if options.alive is not None:
            try:
                make_sign(options.alive)
            except OSError as exc:
                raise RecordError(f"cannot touch {options.alive}: {exc.strerror}") from exc
        shown_count = 0
        writer = begun.enter_context(TruthWriter(options.truth)) if options.truth is not None else None
        progress = begun.enter_context(console.status("preparing the plant"))
        steady = STEADY if isinstance(clock_of(bus), WallClock) else AHEAD
        sent = SentTruth(drive, writer, pace=steady if options.control is None else PROMPT)
        if options.control is not None:
            codes = NO_CODES if answering is None else answering.faults_of_code
            begun.enter_context(ControlSocket(options.control, sent.orders, codes))

        def show(sent_s: float, frame_count: int) -> None:
            nonlocal shown_count
            if options.alive is not None and frame_count > shown_count:
                give_sign(options.alive)
            shown_count = frame_count
            progress.update(f"{driven_text(sent_s, sent.shift_count, sent.event_count)}, {frame_count} frames sent")

        result = send(
            scenario, sent, bus, choice=choice, answering=answering, stop=stop,
            say=lambda line: console.print(line, markup=False), show=show,
        )  # fmt: skip
    if options.is_json:
        print_json(result)


def send(
    scenario: Scenario,
    sent: SentTruth,
    bus: can.BusABC,
    *,
    choice: BusChoice,
    answering: AnsweringController | None,
    stop: Event,
    say: Callable[[str], None],
    show: Callable[[float, int], None],
) -> dict[str, object]:
    """Send a drive in real time and return how that went, as ``--json`` prints it.

    ``say`` gets lines for people, ``show`` five times a second the scenario time [s] and the frames sent. Raises
    ConfigError, BusError, RecordError if time passes in steps that are too long for the drive, the bus goes away, or a
    file cannot be written.
    """
    clock = clock_of(bus)
    contracts = message_contracts(load_contract(scenario.transmission)).values()
    check_step(clock.step_s, [max(contract.cycle_ms, scenario.effects.least_cycle_ms) for contract in contracts])
    with OtherSenders(
        bus,
        [contract.can_id for contract in contracts],
        lambda can_id: say(MIXED_BUS.format(can_id)),
        wanted_ids=answering.link.can_ids if answering is not None else (),
        pass_on=answering.link.feed if answering is not None else lambda _: None,
        pace=WallPace() if answering is None else pace_of(bus),
    ) as others:
        for line in answering.places if answering is not None else ():
            say(line)
        drive = f"{scenario.name}, {scenario.drive}" if scenario.is_on_the_road else scenario.name
        of_vehicle, of_drive = scenario.seed_of_vehicle, scenario.seed_of_drive
        seeds = f"seed {of_drive}" if of_vehicle == of_drive else f"vehicle seed {of_vehicle}, drive seed {of_drive}"
        say(f"{drive}, {seeds}: sending on {choice.name or bus.channel_info}")

        def progress(sent_s: float, frame_count: int) -> None:
            sent.sent_until(sent_s)
            show(sent_s, frame_count)

        report = transmit(
            answering or bus,
            sent.frames(stop),
            stop,
            clock=clock,
            on_progress=progress,
            ahead=sent.pace.stretches_ahead,
        )
        sent.finish(report)
    result = {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "vehicle_seed": scenario.seed_of_vehicle,
        "drive_seed": scenario.seed_of_drive,
        "shifts": sent.shift_count,
        "events": sent.event_count,
        **asdict(report),
        "foreign_frames": others.frame_count,
    }
    if answering is not None:
        result["diagnostics"] = answering.outcome
        say(answering.summary)
    say(_report_text(report))
    if sent.drive.endless_shift:
        say(sent.drive.endless_shift)
    if others.frame_count >= WORTH_SAYING:
        say(f"{others.frame_count} frames with the same identifiers came from another sender")
    return result


def check_step(step_s: float, cycles_ms: Sequence[int]) -> None:
    """Raise ConfigError if frames that leave at whole steps [s] would be as late as a good part of their cycle."""
    shortest_s = min(cycle_ms for cycle_ms in cycles_ms if cycle_ms) / MS_PER_S
    if step_s > LONGEST_STEP_RATIO * shortest_s:
        raise EmulatorConfigError(
            f"a step of {step_s:g} s is too long: frames leave at whole steps, and the shortest cycle of this car is "
            f"{shortest_s:g} s, so that shifts would be rejected as late; at most {LONGEST_STEP_RATIO * shortest_s:g} "
            "s are possible (step_s in CAN_CONFIG or can.conf)"
        )


def answering_of(
    answers: AnswersTesters | None, bus: can.BusABC, choice: BusChoice, scenario: Scenario, drive: Drive
) -> AbstractContextManager[AnsweringController | None]:
    """Return the controller that answers testers while it is entered; raises ConfigError, RecordError, BusError."""
    if answers is not None:
        return answers.opened(bus, choice, drive)
    if scenario.routine.on_request:
        raise EmulatorConfigError(
            "the workshop routine waits for a tester: --diagnostics is needed, so that one is answered"
        )
    return nullcontext()


def _report_text(report: TransmitReport) -> str:
    early = "the simulation has ended early" if report.simulation_ended else "stopped early"
    state = "complete" if report.is_complete else early
    p50, p95, p99, most = (
        f"{value_s * MS_PER_S:.2f}"
        for value_s in (report.lateness_p50_s, report.lateness_p95_s, report.lateness_p99_s, report.lateness_max_s)
    )
    down = f"; the interface was down {report.interruptions} times" if report.interruptions else ""
    return (
        f"{state}: {report.frames_sent} frames sent in {report.duration_s:.1f} s, {report.frames_given_up} given up "
        f"after {report.retries} retries{down}\n"
        f"lateness [ms] p50 {p50}, p95 {p95}, p99 {p99}, max {most}; drift {report.drift_ppm:+.1f} ppm; "
        f"{report.overruns} overruns, {report.underruns} underruns"
    )
