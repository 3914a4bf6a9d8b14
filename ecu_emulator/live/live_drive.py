"""A drive onto a bus in real time, with the truth of every shift once its frames are on the bus."""

import json
import logging
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Final

import can

from canlog.e2e.message_contract import message_contracts
from clutchdiag_io.files import give_sign, make_sign
from dbc.contract import load_contract
from ecu_emulator.bus.sender import TransmitReport, open_bus, transmit
from ecu_emulator.diagnostics.doip.listening import Place, parse_place
from ecu_emulator.diagnostics.doip.tls import TlsNode
from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import ConfigError, RecordError
from ecu_emulator.live.control import ControlSocket
from ecu_emulator.live.other_senders import WORTH_SAYING, OtherSenders
from ecu_emulator.live.sent_truth import SentTruth
from ecu_emulator.progress import ProgressLine, driven_text, people, print_json
from ecu_emulator.scenario.scenario import OpinionFrom, Scenario
from ecu_emulator.truth.records import ROTATED_BYTES, TruthWriter

if TYPE_CHECKING:
    from ecu_emulator.answering.answering_tester import Answering
    from ecu_emulator.answering.on_board import OpinionSource

PRIVATE_INTERFACE: Final = "virtual"  # of python-can, within one process
MS_PER_S: Final = 1e3


class SignOfLife:
    """Touches a file whenever it is told of more frames than before; until then the file is from 1970.

    Raises
    ------
    RecordError
        If the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frame_count = 0
        try:
            make_sign(path)
        except OSError as exc:
            raise RecordError(f"cannot touch {path}: {exc.strerror}") from exc

    def tell(self, frame_count: int) -> None:
        """Touch the file if frames were sent since the last time."""
        if frame_count > self._frame_count:
            self._frame_count = frame_count
            give_sign(self._path)


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

    @property
    def words(self) -> list[str]:
        """The same as words of a command line."""
        named = {"-i": self.interface, "-c": self.channel, "-b": None if self.bitrate is None else str(self.bitrate)}
        return [word for name, value in named.items() if value for word in (name, value)] + ["--fd"] * self.is_fd


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosticsChoice:
    """Which controller answers testers, and what it keeps."""

    table: str  # a TOML file; empty: the one that ships
    memory: Path | None
    doip: Place | None  # where it answers on an IP network
    elm327: str | None  # [HOST:]PORT of an adapter for OBD apps
    has_service: bool = False  # whether a diag-service beside it tells it of its clutches


def run(
    scenario: Scenario,
    *,
    choice: BusChoice,
    truth: Path | None,
    summary: Path | None,
    control: Path | None,
    alive: Path | None,
    diagnostics: DiagnosticsChoice | None,
    start_delay_s: float,
    longest_stay_s: float,
    is_json: bool,
    stop: Event,
) -> None:
    """Stream a drive onto a bus in real time and report how punctual it was; a request to stop ends it in order.

    Raises
    ------
    ConfigError, BusError, RecordError
        If the scenario's truth is not possible, the bus cannot be used, or a file cannot be written.
    """
    logging.getLogger("can").setLevel(logging.CRITICAL)  # python-can logs what it raises, and more when a bus goes
    console = people()
    drive = Drive(scenario, longest_stay_s)
    most_bytes = ROTATED_BYTES if scenario.endless else None
    with (
        open_bus(choice.interface, choice.channel, choice.bitrate, fd=choice.is_fd) as bus,
        TruthWriter(truth, most_bytes=most_bytes) if truth is not None else nullcontext() as writer,
        ControlSocket(control, drive.add_fault) if control is not None else nullcontext(),
        ProgressLine(console, "preparing the plant") as progress,
    ):
        sent = SentTruth(drive, writer)
        _write_summary(summary, {})
        life = SignOfLife(alive) if alive is not None else None

        def show(sent_s: float, frame_count: int) -> None:
            if life is not None:
                life.tell(frame_count)
            progress.update(
                f"{driven_text(sent_s, sent.shift_count, sent.event_count)}, {frame_count} frames sent", sent_s
            )

        result = send(
            scenario, sent, bus, choice=choice, diagnostics=diagnostics, start_delay_s=start_delay_s, stop=stop,
            say=lambda line: console.print(line, markup=False), show=show,
        )  # fmt: skip
    _write_summary(summary, result)
    if is_json:
        print_json(result)


def send(
    scenario: Scenario,
    sent: SentTruth,
    bus: can.BusABC,
    *,
    choice: BusChoice,
    diagnostics: DiagnosticsChoice | None,
    start_delay_s: float,
    stop: Event,
    say: Callable[[str], None],
    show: Callable[[float, int], None],
) -> dict[str, object]:
    """Send a drive in real time and return how that went, as ``--json`` prints it.

    ``say`` gets lines for people, ``show`` five times a second the scenario time [s] and the frames sent.

    Raises
    ------
    ConfigError, BusError, RecordError
        If the controller that answers testers cannot be used, the bus goes away, or a file cannot be written.
    """
    with (
        _answering(bus, diagnostics, choice, scenario, sent.drive) as answering,
        OtherSenders(
            bus,
            own_ids(),
            lambda can_id: say(_mixed_bus_text(can_id)),
            wanted_ids=answering.link.can_ids if answering is not None else (),
            pass_on=answering.link.feed if answering is not None else lambda _: None,
        ) as others,
    ):
        for line in answering.places if answering is not None else ():
            say(line)
        say(f"{_drive_text(scenario)}, {_seeds_text(scenario)}: sending on {choice.name or bus.channel_info}")

        def progress(sent_s: float, frame_count: int) -> None:
            sent.sent_until(sent_s)
            show(sent_s, frame_count)

        report = transmit(answering or bus, sent.frames(), stop, start_delay_s=start_delay_s, on_progress=progress)
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
    if others.frame_count >= WORTH_SAYING:
        say(f"{others.frame_count} frames with the same identifiers came from another sender")
    return result


def _answering(
    bus: can.BusABC,
    choice: DiagnosticsChoice | None,
    bus_choice: BusChoice,
    scenario: Scenario,
    drive: Drive,
) -> "AbstractContextManager[Answering | None]":
    if choice is None and scenario.routine.on_request:
        raise ConfigError("the workshop routine waits for a tester: --diagnostics is needed, so that one is answered")
    if choice is None:
        return nullcontext()
    from ecu_emulator.answering.answering_tester import Answering  # noqa: PLC0415 - a drive that nobody asks begins sooner

    return Answering(
        bus,
        table=choice.table,
        memory=choice.memory,
        doip=choice.doip,
        is_fd=bus_choice.is_fd,
        elm327=choice.elm327,
        bitrate=bus_choice.bitrate,
        on_board=_opinion_source(choice, bus_choice, scenario),
        performer=drive,
        ignition=drive.ignition,
    )


def _opinion_source(choice: DiagnosticsChoice, bus: BusChoice, scenario: Scenario) -> "OpinionSource | None":
    """Return whose opinion of its clutches the controller tells, None if it has none."""
    from ecu_emulator.answering.on_board import FixedOpinion, OnBoardService  # noqa: PLC0415 - see above
    from ecu_emulator.diagnostics.opinion import own_opinion  # noqa: PLC0415 - see above

    if scenario.on_board.estimate is OpinionFrom.OWN:
        return FixedOpinion(own_opinion(scenario.on_board))
    if not choice.has_service or scenario.on_board.estimate is OpinionFrom.NONE:
        return None
    if bus.interface == PRIVATE_INTERFACE:
        raise ConfigError(f"--on-board needs a bus that another process can hear, not {PRIVATE_INTERFACE}")
    store = None if choice.memory is None else choice.memory.with_name(choice.memory.name + ".on-board.sqlite")
    return OnBoardService(bus.words, store)


def diagnostics_choice(
    table: str | None,
    memory: Path | None,
    doip: str | None,
    elm327: str | None = None,
    *,
    has_service: bool = False,
    tls: TlsNode | None = None,
) -> DiagnosticsChoice | None:
    """Return what was chosen on the command line; None if nobody is to answer.

    Raises
    ------
    ConfigError
        If there is a memory or an address and nobody who uses it, or the address is none.
    """
    options = {
        "--diagnostic-memory": memory, "--doip": doip, "--elm327": elm327, "--on-board": has_service or None,
        "--doip-certificate": tls,
    }  # fmt: skip
    for option, value in options.items():
        if table is None and value is not None:
            raise ConfigError(f"{option} needs --diagnostics")
    if table is None:
        return None
    if doip is None and tls is not None:
        raise ConfigError("--doip-certificate needs --doip")
    place = None if doip is None else replace(parse_place(doip), tls=tls)
    return DiagnosticsChoice(table=table, memory=memory, doip=place, elm327=elm327, has_service=has_service)


def _drive_text(scenario: Scenario) -> str:
    return f"{scenario.name}, {scenario.drive}" if scenario.is_on_the_road else scenario.name


def _seeds_text(scenario: Scenario) -> str:
    vehicle, drive = scenario.seed_of_vehicle, scenario.seed_of_drive
    return f"seed {drive}" if vehicle == drive else f"vehicle seed {vehicle}, drive seed {drive}"


def own_ids() -> list[int]:
    """Return the identifiers of the wire contract, which on one bus only one emulator may send."""
    return [contract.can_id for contract in message_contracts(load_contract()).values()]


def _mixed_bus_text(can_id: int) -> str:
    return (
        f"warning: another sender on this bus uses this emulator's identifiers ({can_id:03X} for one), "
        "probably a second emulator; nothing can be estimated from a mixture: give each a bus of its own"
    )


def _report_text(report: TransmitReport) -> str:
    state = "complete" if report.is_complete else "stopped early"
    lateness = ", ".join(
        f"{name} {value_s * MS_PER_S:.2f}"
        for name, value_s in (
            ("p50", report.lateness_p50_s),
            ("p95", report.lateness_p95_s),
            ("p99", report.lateness_p99_s),
            ("max", report.lateness_max_s),
        )
    )
    return (
        f"{state}: {report.frames_sent} frames sent in {report.duration_s:.1f} s, {report.frames_given_up} given up "
        f"after {report.retries} retries\n"
        f"lateness [ms] {lateness}; drift {report.drift_ppm:+.1f} ppm; "
        f"{report.overruns} overruns, {report.underruns} underruns"
    )


def _write_summary(path: Path | None, result: dict[str, object]) -> None:
    """Write the report; called with nothing at first, so that a path that cannot be written is found at once."""
    if path is None:
        return
    try:
        path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    except OSError as exc:
        raise RecordError(f"cannot write summary {path}: {exc.strerror}") from exc
