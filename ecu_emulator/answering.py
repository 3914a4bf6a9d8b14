"""The emulated transmission answers testers while it drives: what is sent tells it how the vehicle is."""

import math
import secrets
import threading
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType
from typing import Final, Protocol, Self

import can

from dbc.contract import load_contract
from ecu_emulator.bus import FrameSender
from ecu_emulator.diagnostics.codes import Status
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.doip.listening import Place
from ecu_emulator.diagnostics.doip.server import DoipServer
from ecu_emulator.diagnostics.elm327.server import ElmServer, parse_place
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.monitors import SENSED
from ecu_emulator.diagnostics.opinion import values_of
from ecu_emulator.diagnostics.table_file import load_table, shipped_table
from ecu_emulator.errors import ExtraMissingError
from ecu_emulator.monitoring import MONITOR_PERIOD_S, Monitoring
from ecu_emulator.on_board import FixedOpinion, OpinionSource
from ecu_emulator.requested_adaptation import AdaptedCar, RequestedAdaptation
from ecu_emulator.requested_clearing import RequestedClearing
from ecu_emulator.requested_routine import Driven, Performer, RequestedRoutine
from ecu_emulator.sent_values import SentValues

OWN_NODE: Final = "TCU"
RUNNING_RAD_S: Final = 30.0  # engine speed that no starter reaches
_NS_PER_S: Final = 1e9


class Car(Performer, AdaptedCar, Protocol):
    """The car, as far as testers can have it do something."""


class Answering:
    """A tester may ask while this is entered; frames that are to go out go through ``send``.

    Parameters
    ----------
    bus
        Where responses go, and the frames that ``send`` is given.
    table
        A TOML file that describes the controller; empty: the one that ships.
    memory
        The file that keeps trouble codes over restarts; without one they are forgotten.
    doip
        Where testers may ask over an IP network; None: nowhere.
    is_fd
        Whether responses are CAN FD frames.
    elm327
        ``[HOST:]PORT`` of an ELM327 adapter for OBD apps; without one there is none.
    bitrate
        Of the bus [bit/s], if it is known; the adapter names its protocol by it.
    on_board
        Whose estimate of the clutches the controller has; None: it has none.
    performer
        The car that performs the routines of the workshop when a tester starts them; None: it cannot.

    Raises
    ------
    ConfigError, RecordError, BusError, ExtraMissingError
        If the table, the memory or an address cannot be used, or can-isotp is not installed.
    """

    def __init__(
        self,
        bus: FrameSender,
        *,
        table: str,
        memory: Path | None,
        doip: Place | None,
        is_fd: bool,
        elm327: str | None = None,
        bitrate: int | None = None,
        on_board: OpinionSource | None = None,
        performer: Car | None = None,
    ) -> None:
        try:
            from ecu_emulator.diagnostics.link import DiagnosticLink  # noqa: PLC0415 - an extra
        except ImportError as exc:
            raise ExtraMissingError("diagnostics need can-isotp: pip install 'clutchdiag[diagnostics]'") from exc
        self._bus = bus
        self._stack = ExitStack()
        self._began_s = time.monotonic()
        database = load_contract()
        self._sent = SentValues(database)
        self._shift_id = database.get_message_by_name("TCU_Shift").frame_id
        self._pressure_id = database.get_message_by_name("TCU_Pressures").frame_id
        self._own_ids = {message.frame_id for message in database.messages if OWN_NODE in message.senders}
        self._on_board: OpinionSource = on_board or FixedOpinion(None)
        self._driven = Driven()
        self._driven_s = -math.inf  # when the newest frame was due: the drive's time, also where sending lags behind
        self._looked_s = -math.inf  # at which moment of that the monitors looked last
        self._engine_on_s: float | None = None  # since when the engine runs
        self._is_over = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="monitors", daemon=True)
        self._error: BaseException | None = None
        described = load_table(Path(table)) if table else shipped_table()
        store = None if memory is None else self._stack.enter_context(MemoryFile(memory, described))
        try:
            self.controller = Controller(
                described, values=self._values, clock=time.monotonic, chance=secrets.token_bytes, store=store
            )
            self._monitoring = Monitoring(
                self.controller,
                was_adapted=performer is None or performer.is_adapted,
            )
            self._routine = None if performer is None else RequestedRoutine(performer, self.controller)
            self._adaptation = None if performer is None else RequestedAdaptation(performer, self.controller)
            self._clearing = RequestedClearing(self._on_board, self.controller, self._monitoring, self._adaptation)
            self.link = DiagnosticLink(self.controller, bus.send, is_fd=is_fd)
            self.doip = None if doip is None else self._stack.enter_context(closing(DoipServer(self.controller, doip)))
            adapter = None if elm327 is None else ElmServer(self.controller, parse_place(elm327), bitrate)
            self.elm327 = None if adapter is None else self._stack.enter_context(closing(adapter))
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        parts: tuple[AbstractContextManager[object] | None, ...] = (self.elm327, self.link, self.doip, self._on_board)
        self._stack.callback(self._clearing.close)
        try:
            for part in parts:
                if part is not None:
                    self._stack.enter_context(part)
        except BaseException:
            self._stack.close()
            raise
        self._watcher.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over.set()
        self._watcher.join()
        self._stack.__exit__(kind, error, trace)
        if self._error is not None and error is None:
            raise self._error

    def send(self, message: can.Message) -> None:
        """Put a frame on the bus, unless a tester has switched this controller's messages off (service 28)."""
        can_id = message.arbitration_id
        if not message.is_error_frame:
            self._sent.note(can_id, bytes(message.data))
            self._driven_s = max(self._driven_s, message.timestamp)
        if can_id == self._pressure_id and self._adaptation is not None and self._adaptation.is_listening:
            self._adaptation.hear(message.timestamp, self._sent.now({}))
        if can_id == self._shift_id:
            self._count_shift(message.timestamp)
        if can_id not in self._own_ids or self.controller.state.communication.sends_normal:
            self._bus.send(message)
            if self.elm327 is not None:
                self.elm327.hear_frame(message)

    @property
    def outcome(self) -> dict[str, object]:
        """What was asked, and the trouble codes that are confirmed now."""
        records, troubles = self.controller.state.memory.records, self.controller.table.troubles
        confirmed = [troubles[number].code for number, record in records.items() if record.status & Status.CONFIRMED]
        over_ip = {} if self.doip is None else {"doip": self.doip.counts}
        adapter = {} if self.elm327 is None else {"elm327": asdict(self.elm327.counts)}
        return {**asdict(self.link.counts), **over_ip, **adapter, "confirmed": confirmed}

    @property
    def places(self) -> list[str]:
        """Where else than on the bus it can be asked, for people; each with a warning if others can reach it."""
        said = []
        if self.doip is not None:
            place = self.doip.place
            said.append(place_text("DoIP on", str(place), is_exposed=self.doip.is_exposed))
            if place.tls is not None:
                said.append(f"DoIP by TLS on port {place.tls.port}")
        if self.elm327 is not None:
            said.append(place_text("ELM327 adapter at", self.elm327.place, is_exposed=self.elm327.is_exposed))
        return said

    @property
    def summary(self) -> str:
        """What was asked and which codes are confirmed, for people."""
        told = self.outcome["confirmed"]
        codes = ", ".join(told) if isinstance(told, list) and told else "none"
        unkept = self._monitoring.problem or (self._adaptation.problem if self._adaptation is not None else None)
        problem = f"\nwarning: trouble codes could not be kept: {unkept}" if unkept else ""
        asked = f"{self.link.counts.requests} requests, {self.link.counts.responses} responses"
        if self.doip is not None:
            over_ip = self.doip.counts
            asked += f"; DoIP: {over_ip['requests']} requests, {over_ip['responses']} responses"
        if self.elm327 is not None:
            asked += f"; ELM327: {self.elm327.counts.lines} lines of {self.elm327.counts.clients} clients"
        if self._on_board.problem is not None:
            problem += f"\nwarning: {self._on_board.problem}"
        return f"diagnostics: {asked}; confirmed trouble codes: {codes}{problem}"

    def _look(self) -> None:
        """Judge the newest frames once: a sender that the machine keeps waiting makes no shift longer."""
        driven_s = self._driven_s
        if driven_s != self._looked_s:
            self._looked_s = driven_s
            values = self._values()
            self._note_engine(values)
            self._monitoring.look(values, driven_s)

    def _watch(self) -> None:
        """Let the monitors judge what the controllers say, from when those that they need have spoken."""
        try:
            while not self._is_over.wait(MONITOR_PERIOD_S):
                if self._sent.has_all(SENSED):
                    self._look()
                    self._monitoring.judge_clutches(self._on_board.opinions)
                if self._routine is not None:
                    is_live = self._on_board.is_live
                    self._routine.step(self._driven, self._on_board.opinions, time.monotonic(), is_live=is_live)
                if self._adaptation is not None:
                    self._adaptation.step(self._values())
                self._clearing.step()
        except BaseException as exc:  # noqa: BLE001 - carried to the caller's thread, which raises it
            self._error = exc

    def _note_engine(self, values: Mapping[str, float]) -> None:
        speed_rad_s = values.get("engine_speed_rad_s")
        if speed_rad_s is None:
            return
        if speed_rad_s < RUNNING_RAD_S:
            self._engine_on_s = None
        elif self._engine_on_s is None:
            self._engine_on_s = time.monotonic()

    def _count_shift(self, due_s: float) -> None:
        driven = self._driven
        gear = self._sent.now({}).get("current_gear", driven.gear)
        if gear and driven.gear and gear != driven.gear:
            driven = replace(driven, shift_count=driven.shift_count + 1, last_shift_ns=round(due_s * _NS_PER_S))
        self._driven = replace(driven, gear=gear or driven.gear)  # neutral between two gears is a part of their shift

    def _values(self) -> Mapping[str, float]:
        more = {
            "time_s": time.monotonic() - self._began_s,
            "shift_count": float(self._driven.shift_count),
            "engine_run_time_s": 0.0 if self._engine_on_s is None else time.monotonic() - self._engine_on_s,
            "revs_possible": float(self._routine is not None and self._routine.is_possible),
            "clearing_possible": float(self._clearing.is_possible),
            "adaptation_possible": float(self._adaptation is not None and self._adaptation.is_possible),
            **(self._adaptation.values if self._adaptation is not None else {}),
            **self._monitoring.temperatures,
            **values_of(self._on_board.opinions),
        }
        return self._sent.now(more)


def place_text(what: str, place: str, *, is_exposed: bool) -> str:
    """Return what people are told of a server for testers, with a warning if others than this machine can reach it."""
    warning = f"\nwarning: anyone who can reach {place} can ask this controller and change what testers can change"
    return f"{what} {place}{warning if is_exposed else ''}"
