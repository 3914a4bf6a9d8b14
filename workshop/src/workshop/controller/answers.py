"""The emulated transmission answers testers while it drives; attached to a drive by an entry point."""

import math
import os
import secrets
from collections import deque
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import can

from canlog.e2e.message_contract import message_contracts
from clutch_model.calibration import CONVERTERS
from dbc.contract import load_contract
from ecu_emulator.bus.sender import FrameSender
from ecu_emulator.bus.sent_values import OWN_NODE, SentValues, recounted
from ecu_emulator.drive.orders import FaultsOfCode
from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import EmulatorConfigError, LogFormatExtraError
from ecu_emulator.live import BusChoice
from workshop.controller.controller import Controller, MemoryFile
from workshop.controller.doip_server import DoipAddress, DoipServer, parse_place
from workshop.controller.elm327_server import ElmServer
from workshop.controller.inquiry import Inquiry, ThreadInquiry, inquiry_of
from workshop.controller.iso14229 import DtcStatus
from workshop.controller.monitoring import MONITOR_PERIOD_S, Monitoring
from workshop.controller.monitors import SENSED, SENSED_OF_CONVERTER
from workshop.controller.requested_tasks import (
    Driven,
    RequestedAdaptation,
    RequestedRoutine,
    clear_if_requested,
)
from workshop.controller.services.data import STARTING
from workshop.controller.table import check_personality, engine_table, load_table, table_like, table_of

RUNNING_RAD_S: Final = 30.0  # engine speed above that of a starter
LEAST_LOOK_S: Final = 0.8 * MONITOR_PERIOD_S  # time of the drive between two samples of the monitors


class Answering:
    """Answers testers while it is entered; all frames of the drive go through ``send``.

    Parameters
    ----------
    bus
        Gets responses and the frames of ``send``.
    options
        Table, memory, and further places to answer.
    is_fd
        Whether responses are CAN FD frames.
    bitrate
        Of the bus [bit/s], None if unknown; it decides the protocol of the ELM327 adapter.
    performer
        The car that performs routines; None: it performs none.
    ignition
        Times of the drive [s] at which the ignition is switched on, the first frame included; consumed here.
    inquiry
        In whose time it answers; that of this machine by default.

    Raises
    ------
    ConfigError, RecordError, BusError, ExtraMissingError
        If the table, the memory or an address cannot be used, or can-isotp is not installed.
    """

    def __init__(
        self,
        bus: FrameSender,
        options: "Answers",
        *,
        is_fd: bool = False,
        bitrate: int | None = None,
        performer: Drive | None = None,
        ignition: deque[float] | None = None,
        inquiry: Inquiry | None = None,
    ) -> None:
        try:
            from workshop.controller.link import DiagnosticLink, Links  # noqa: PLC0415 - an extra
        except ImportError as exc:
            raise LogFormatExtraError("diagnostics need can-isotp: pip install './workshop[diagnostics]'") from exc
        self._bus = bus
        self._stack = ExitStack()
        self._inquiry = inquiry = ThreadInquiry() if inquiry is None else inquiry
        self._pace = inquiry.pace
        self._clock = clock = self._pace.now_s
        self._began_s = clock()
        self._ignition: deque[float] = deque() if ignition is None else ignition
        self._switched_on_s = math.inf  # next, time of the bus
        self._epoch_s: float | None = None  # time 0 of the drive, time of the bus
        self._is_new_cycle = self._is_restarted = False  # for the next call of `watch`
        self._reset_s = 0.0  # end of the last reset by a tester, time of the clock
        self._counted_from: dict[int, int] | None = None  # alive counters since that reset
        transmission = "nominal" if performer is None else performer.transmission
        database = load_contract(transmission)
        self._sent = SentValues(database, clock)
        is_converter = transmission in CONVERTERS
        self._sensed = SENSED_OF_CONVERTER if is_converter else SENSED
        self._shift_id = database.get_message_by_name("TCU_Gear" if is_converter else "TCU_Shift").frame_id
        self._pressure_id = database.get_message_by_name("TCU_LockUp" if is_converter else "TCU_Pressures").frame_id
        contracts = message_contracts(database).values()
        self._own_ids = {
            contract.can_id: contract.data_id or 0 for contract in contracts if contract.sender == OWN_NODE
        }
        self._driven = Driven()
        self._driven_s = -math.inf  # drive time of the newest frame, also where sending lags behind
        self._looked_s = -math.inf  # drive time of the last sample of the monitors
        self._engine_ran_s = 0.0  # since the controller was switched on
        shipped = table_of(transmission) if options.like is None else table_like(options.like, transmission)
        described = shipped if options.table is None else load_table(Path(options.table))
        engine = () if options.like is None else (engine_table(),)
        store = (
            None if options.memory is None else self._stack.enter_context(MemoryFile(Path(options.memory), described))
        )
        try:
            self.controller, *others = (
                Controller(
                    table,
                    values=self._values,
                    clock=clock,
                    chance=secrets.token_bytes,
                    store=store if table is described else None,
                    work=inquiry.work(table.timing),
                )
                for table in (described, *engine)
            )
            self._monitoring = Monitoring(
                self.controller,
                was_adapted=performer is None or performer.is_adapted,
                transmission=transmission,
            )
            self._routine = None if performer is None else RequestedRoutine(performer, self.controller)
            self._adaptation = None if performer is None else RequestedAdaptation(performer, self.controller)
            self._links = [
                DiagnosticLink(controller, bus.send, is_fd=is_fd, inquiry=inquiry)
                for controller in (self.controller, *others)
            ]
            self.link = Links(*self._links)
            doip = options.doip_address
            self.doip = None if doip is None else self._stack.enter_context(closing(DoipServer(self.controller, doip)))
            there = None if options.elm327 is None else parse_place(options.elm327, "--elm327", least_port=0)
            adapter = None if there is None else ElmServer(self.controller, (there.host, there.port), bitrate, *others)
            self.elm327 = None if adapter is None else self._stack.enter_context(closing(adapter))
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        parts: tuple[AbstractContextManager[object] | None, ...] = (
            self._inquiry, self.elm327, *self._links, self.doip
        )  # fmt: skip
        try:
            for part in parts:
                if part is not None:
                    self._stack.enter_context(part)
            self._stack.enter_context(self._pace.looking(self._watch, MONITOR_PERIOD_S, "monitors"))
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def send(self, message: can.Message) -> None:
        """Put a frame on the bus, unless a tester has switched this controller's messages off (28) or reset it (11)."""
        can_id = message.arbitration_id
        if not message.is_error_frame:
            self._note_reset()
            self._note_ignition(message.timestamp)
            if can_id in self._own_ids or self.controller.state.communication.receives_normal:
                self._sent.note(can_id, bytes(message.data), message.timestamp)
            self._driven_s = max(self._driven_s, message.timestamp)
        if can_id == self._pressure_id and self._adaptation is not None and self._adaptation.needs_moments:
            self._adaptation.feed(message.timestamp, self._sent.now({}))
        if can_id == self._shift_id:
            self._count_shift()
        if can_id in self._own_ids:
            if not self.controller.state.communication.sends_normal or self.controller.is_asleep:
                return
            if self._counted_from is not None:
                message = recounted(message, self._own_ids[can_id], self._counted_from)
        self._bus.send(message)
        if self.elm327 is not None:
            self.elm327.feed_frame(message)

    @property
    def outcome(self) -> dict[str, object]:
        """Counts of requests, and the trouble codes that are confirmed now."""
        records, troubles = self.controller.state.memory.records, self.controller.table.troubles
        confirmed = [troubles[number].code for number, record in records.items() if record.status & DtcStatus.CONFIRMED]
        over_ip = {} if self.doip is None else {"doip": self.doip.counts}
        adapter = {} if self.elm327 is None else {"elm327": asdict(self.elm327.counts)}
        disbelieved = {"disbelieved_frames": self._sent.disbelieved_count}
        return {**asdict(self.link.counts), **disbelieved, **over_ip, **adapter, "confirmed": confirmed}

    @property
    def faults_of_code(self) -> FaultsOfCode:
        """The faults that lead to each trouble code, as far as the table names them."""
        return {trouble.code: trouble.faults for trouble in self.controller.table.troubles.values() if trouble.faults}

    @property
    def places(self) -> list[str]:
        """Places other than the bus, for people; with a warning if other machines can reach them."""
        lines = []
        if self.doip is not None:
            lines.append(place_text("DoIP on", str(self.doip.place), is_exposed=self.doip.is_exposed))
        if self.elm327 is not None:
            lines.append(place_text("ELM327 adapter at", self.elm327.place, is_exposed=self.elm327.is_exposed))
        return lines

    @property
    def summary(self) -> str:
        """Counts of requests and the confirmed codes, for people."""
        confirmed = self.outcome["confirmed"]
        codes = ", ".join(confirmed) if isinstance(confirmed, list) and confirmed else "none"
        unkept = self._monitoring.problem or (self._adaptation.problem if self._adaptation is not None else None)
        problem = f"\nwarning: trouble codes could not be kept: {unkept}" if unkept else ""
        asked = f"{self.link.counts.requests} requests, {self.link.counts.responses} responses"
        if self.doip is not None:
            over_ip = self.doip.counts
            asked += f"; DoIP: {over_ip['requests']} requests, {over_ip['responses']} responses"
        if self.elm327 is not None:
            asked += f"; ELM327: {self.elm327.counts.lines} lines of {self.elm327.counts.clients} clients"
        if self._sent.disbelieved_count:
            problem += f"\n{self._sent.disbelieved_count} frames of others were not believed: wrong checksum or length"
        return f"diagnostics: {asked}; confirmed trouble codes: {codes}{problem}"

    def watch(self) -> None:
        """Run the monitors once all of their values were sent; ten times a second while entered."""
        if self._is_restarted:
            self._is_restarted, is_new_cycle, self._is_new_cycle = False, self._is_new_cycle, False
            self._engine_ran_s, self._looked_s = 0.0, -math.inf
            self._monitoring.restart(is_new_cycle=is_new_cycle)
        if self._sent.has_all(self._sensed) and not self.controller.is_asleep:
            self._look()
            self._monitoring.judge_adaptation()

    def _look(self) -> None:
        """Judge the newest frames in time of the drive: late sending lengthens neither shift nor failure."""
        driven_s, looked_s = self._driven_s, self._looked_s
        if driven_s - looked_s >= LEAST_LOOK_S:
            self._looked_s = driven_s
            values = self._values()
            if values.get("engine_speed_rad_s", 0.0) >= RUNNING_RAD_S and math.isfinite(looked_s):
                self._engine_ran_s += driven_s - looked_s
            self._monitoring.judge(values, driven_s)

    def _watch(self) -> None:
        """Run monitors and routines."""
        self.watch()
        if self._routine is not None:
            self._routine.step(self._driven)
        if self._adaptation is not None:
            self._adaptation.step(self._values())
            clear_if_requested(self.controller, self._monitoring, self._adaptation)

    def _note_reset(self) -> None:
        """Begin anew once a tester has reset the controller, alive counters included."""
        reset_s = self.controller.state.asleep_until_s
        if reset_s != self._reset_s:
            self._reset_s = reset_s
            self._restart({})

    def _note_ignition(self, t_s: float) -> None:
        """Begin anew with the first frame after the ignition was switched on."""
        if self._epoch_s is None:
            self._epoch_s = t_s - (self._ignition.popleft() if self._ignition else 0.0)
        if math.isinf(self._switched_on_s) and self._ignition:
            self._switched_on_s = self._epoch_s + self._ignition.popleft()
        if t_s >= self._switched_on_s:
            self._switched_on_s = math.inf
            self._is_new_cycle = True
            self._restart(None)

    def _restart(self, counted_from: dict[int, int] | None) -> None:
        """Reset sent values, clock and monitors."""
        self._sent.restart()
        self._began_s = max(self._clock(), self._reset_s)
        self._counted_from = counted_from
        self._is_restarted = True

    def _count_shift(self) -> None:
        driven = self._driven
        gear = self._sent.now({}).get("current_gear", driven.gear)
        if gear and driven.gear and gear != driven.gear:
            driven = replace(driven, shift_count=driven.shift_count + 1)
        self._driven = replace(driven, gear=gear or driven.gear)  # neutral between two gears is a part of their shift

    def _values(self) -> Mapping[str, float]:
        more = {
            "time_s": self._clock() - self._began_s,
            "shift_count": float(self._driven.shift_count),
            "engine_run_time_s": self._engine_ran_s,
            STARTING: float(not self._sent.has_begun),
            "revs_possible": float(self._routine is not None and self._routine.is_possible),
            "clearing_possible": float(self._adaptation is not None),
            "adaptation_possible": float(self._adaptation is not None and self._adaptation.is_possible),
            **(self._adaptation.values if self._adaptation is not None else {}),
            **self._monitoring.temperatures,
            **(self._sent.silences if self.controller.state.communication.receives_normal else {}),
        }
        return self._sent.now(more)


def place_text(what: str, place: str, *, is_exposed: bool) -> str:
    """Return a line about a server for testers, with a warning if other machines can reach it."""
    warning = f"\nwarning: anyone who can reach {place} can ask this controller and change what testers can change"
    return f"{what} {place}{warning if is_exposed else ''}"


AnyPath = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """How the emulated controller answers testers; each member is the option of that name.

    Attributes
    ----------
    table : path, optional
        A TOML file that describes a controller of your own.
    like : str, optional
        A controller of a real car whose data it has besides, and whose times to answer: ``vw_dsg``, ``bmw_dkg``, or
        ``gm_t87a`` with a converter. The engine's controller answers beside it.
    memory : path, optional
        A file that keeps trouble codes over restarts.
    doip, elm327 : str, optional
        ``[HOST:]PORT`` at which it answers over IP, and as an ELM327 adapter.

    Raises
    ------
    ConfigError
        If an address is none.
    """

    table: AnyPath | None = None
    like: str | None = None
    memory: AnyPath | None = None
    doip: str | None = None
    elm327: str | None = None

    def __post_init__(self) -> None:
        if self.table is not None and self.like is not None:
            raise EmulatorConfigError("a controller answers by a table of its own, or like another one, not both")
        if self.like is not None:
            check_personality(self.like)
        _ = self.doip_address

    def opened(self, bus: can.BusABC, choice: BusChoice, drive: Drive) -> Answering:
        """Return the controller that answers while it is entered.

        Raises
        ------
        ConfigError, RecordError, BusError, ExtraMissingError
            If the table, the memory, the bus or an address cannot be used, or can-isotp is not installed.
        """
        return Answering(
            bus, self, is_fd=choice.is_fd, bitrate=choice.bitrate, performer=drive, ignition=drive.ignition,
            inquiry=inquiry_of(bus),
        )  # fmt: skip

    @property
    def doip_address(self) -> DoipAddress | None:
        """Where it answers on an IP network, None if it does not."""
        return None if self.doip is None else parse_place(self.doip)


def chosen(words: Mapping[str, Any]) -> Answers | None:
    """Return how a command line has testers answered, None if nobody answers.

    Raises ConfigError if there is a memory or an address and nobody who uses it, or the address is none.
    """
    table, like = words["diagnostics"], words["answers_like"]
    if table is None and like is None:
        for name in ("diagnostic_memory", "doip", "elm327"):
            if words[name] is not None:
                raise EmulatorConfigError(f"--{name.replace('_', '-')} needs --diagnostics")
        return None
    return Answers(
        table=table or None, like=like, memory=words["diagnostic_memory"], doip=words["doip"], elm327=words["elm327"]
    )
