"""The emulated vehicle from Python: ``Emulator`` drives on a bus or into a log, and prints nothing."""

import math
import os
import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final, Self

import can

from ecu_emulator import scenario as scenarios
from ecu_emulator.bus.sender import open_bus, to_messages
from ecu_emulator.commands import DriveOptions, LogOptions, Recording, choose_scenario, ns_of, save_dbc, write_log
from ecu_emulator.drive.orders import LiveOrders
from ecu_emulator.drive.recording import Drive
from ecu_emulator.drive.stepping import MS_PER_S, StepGrid
from ecu_emulator.driving.journey import STEERED, PlannedTrip, SteeredTrip, Steering
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.live import PROMPT, STEADY, AnswersTesters, BusChoice, SentTruth, answering_of, send
from ecu_emulator.log_formats import DEFAULT_START_NS, RecordFormat
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.faults import BusFault, Degradation, Fault, SensorFault
from ecu_emulator.scenario.scenario import FluidCondition, Scenario
from ecu_emulator.scenario.scenario_file import parse_fault
from ecu_emulator.truth import TruthLog, TruthWriter

AnyPath = str | os.PathLike[str]
AnyFault = Fault | Mapping[str, object]
MAX_TRUTHS: Final = 100_000  # of an endless drive the last ones, half a kilobyte each
VIRTUAL: Final = "virtual"
POLL_S: Final = 0.01
LONGEST_STEP_S: Final = 600.0  # whose rows, half a kilobyte a millisecond, are held in memory
FASTEST_M_S: Final = 100.0


def fault_of(fault: AnyFault) -> Fault:
    """Return a fault, from its table perhaps; raises ConfigError if it cannot be."""
    return fault if isinstance(fault, Fault) else parse_fault(fault)


def check_number(name: str, number: float, low: float, high: float) -> None:
    """Raise ConfigError unless a number is within its range; what is no number is not."""
    if not low <= number <= high:
        raise EmulatorConfigError(f"{name} must be {low:g}..{high:g}, got {number:g}")


def check_is_number(name: str, number: float | None) -> None:
    """Raise ConfigError for a number that is none (NaN); without end and not given are allowed."""
    if number is not None and math.isnan(number):
        raise EmulatorConfigError(f"{name} must be a number, got nan")


def check_word(name: str, word: str | None, words: Sequence[str]) -> None:
    """Raise ConfigError unless a word, if it is given, is one of these."""
    if word is not None and word not in words:
        raise EmulatorConfigError(f"{name} must be {', '.join(words[:-1])} or {words[-1]}, got {word!r}")


class Emulator:
    """An emulated vehicle with a wet dual clutch; what is not named is as the scenario has it.

    ``with Emulator("case2", seed=7) as car:`` drives in real time on a bus, in threads of its own, from the beginning
    of the block to its end; ``Emulator("case2").record("drive.log")`` writes a log faster than real time. The same
    arguments give the same frames.

    Parameters
    ----------
    scenario : str, path or Scenario
        The name of one that ships (``ecu-emulator scenarios`` lists them), a TOML file, or the value itself.
    interface, channel, bitrate, is_fd
        The bus, as python-can names it. By default a ``virtual`` one in this process, with a name of its own.
    options : Mapping, optional
        More arguments of python-can's driver, such as ``{"port": 43113}``.
    fluid : {"ideal", "case1", "case2", "ageing"}, optional
        How far the fluid has gone.
    cause : str, optional
        What is wrong with the car, such as ``"glazed-lining:2"``, commas between several.
    seed, vehicle_seed, drive_seed : int, optional
        From which car and drive are drawn; of both, or of one.
    drive : {"cycle", "wltc", "udds", "hwfet", "us06", "city", "day"}, optional
        What is driven.
    cycles : int, optional
        How often.
    is_endless : bool
        Whether it is driven again and again.
    oil_degc, mass_kg : float, optional
        Oil temperature when the drive begins, -15..130 degC; mass of the car, 900..3500 kg.
    odometer_m : float, optional
        Odometer when the drive begins; ``truth.totals.odometer_m`` tells where it ended.
    routine : tuple of int, optional
        Revs in neutral before the drive, with open and with closed clutches.
    is_in_workshop : bool
        Whether the car stands in neutral until a tester starts that routine; needs ``answers``.
    faults : iterable of SensorFault, BusFault, Degradation or Mapping
        What goes wrong, besides what the scenario scripts; a mapping has the keys of a scenario's table, such as
        ``{"kind": "loss", "share": 0.2, "start_s": 5}``.
    truth : path, optional
        File for the truth about every shift; ``.truth`` has it in any case. Of a log: by default beside it.
    answers : Answers, optional
        Whether the controller answers testers.
    is_prompt : bool
        Whether an order, such as ``add_fault``, is on the bus within a tenth of a second, not after two seconds: frames
        are made less far ahead, and a busy machine may send them late.
    parked_s : float, optional
        For how long at most a parked car is shown [s]; by default 10 on a bus, all of it in a log.

    Raises
    ------
    ConfigError
        If an argument or the scenario cannot be used.
    """

    def __init__(
        self,
        scenario: str | AnyPath | Scenario = "ideal",
        *,
        interface: str = VIRTUAL,
        channel: str | None = None,
        bitrate: int | None = None,
        is_fd: bool = False,
        options: Mapping[str, Any] | None = None,
        fluid: str | None = None,
        cause: str | None = None,
        seed: int | None = None,
        vehicle_seed: int | None = None,
        drive_seed: int | None = None,
        drive: str | None = None,
        cycles: int | None = None,
        is_endless: bool = False,
        oil_degc: float | None = None,
        mass_kg: float | None = None,
        odometer_m: float | None = None,
        routine: tuple[int, int] | None = None,
        is_in_workshop: bool = False,
        faults: Iterable[AnyFault] = (),
        truth: AnyPath | None = None,
        answers: AnswersTesters | None = None,
        is_prompt: bool = False,
        parked_s: float | None = None,
    ) -> None:
        if parked_s is not None:
            check_number("parked_s", parked_s, 0.0, scenarios.MOST_PARKED_S)
        check_word("fluid", fluid, list(FluidCondition))
        check_word("drive", drive, list(DriveName))
        driven = DriveOptions(
            scenario=scenario if isinstance(scenario, Scenario) else os.fspath(scenario),
            fluid=fluid, cause=cause, seed=seed, vehicle_seed=vehicle_seed, drive_seed=drive_seed, drive=drive,
            cycles=cycles, is_endless=is_endless, oil_degc=oil_degc, mass_kg=mass_kg, odometer_m=odometer_m,
            routine=routine, is_in_workshop=is_in_workshop,
        )  # fmt: skip
        chosen, more = choose_scenario(driven), [fault_of(fault) for fault in faults]
        self.scenario: Final = replace(
            chosen,
            sensor_faults=(*chosen.sensor_faults, *(fault for fault in more if isinstance(fault, SensorFault))),
            bus_faults=(*chosen.bus_faults, *(fault for fault in more if isinstance(fault, BusFault))),
            causes=(*chosen.causes, *(fault for fault in more if isinstance(fault, Degradation))),
        )
        is_unnamed = interface == VIRTUAL and channel is None
        self._choice = BusChoice(
            interface=interface,
            channel=f"vehicle-{uuid.uuid4().hex[:8]}" if is_unnamed else channel,
            bitrate=bitrate,
            is_fd=is_fd,
        )
        # On a virtual bus frames have the times of the car, however busy the machine is.
        defaults = {"preserve_timestamps": True} if interface == VIRTUAL else {}
        self._options = {**defaults, **(options or {})}
        self._truth_path = None if truth is None else Path(truth)
        self._answers = answers
        self._pace = PROMPT if is_prompt else STEADY
        self._parked_s = parked_s
        self._steering: Steering | None = None  # of a car that is stepped and steered
        self._grid = StepGrid()
        self._stop = Event()
        self._thread: Thread | None = None
        self._drive: Drive | None = None
        self._sent: SentTruth | None = None
        self._file: TruthWriter | None = None
        self._result: Mapping[str, Any] | None = None
        self._error: BaseException | None = None
        self._notices: list[str] = []

    def record(
        self,
        path: AnyPath,
        *,
        log_format: str | None = None,
        start_time: datetime | None = None,
        channel: str = "vcan0",
    ) -> Recording:
        """Write the drive to a log, faster than real time, and the truth beside it, as ``ecu-emulator record`` does.

        Parameters
        ----------
        path
            The log.
        log_format : {"candump", "blf", "mf4"}, optional
            By default what the suffix says.
        start_time
            Of the first frame, UTC unless it says otherwise; by default the beginning of 2026.
        channel
            Name in the log, for formats that have one.

        Raises
        ------
        ConfigError, RecordError
            If an argument or the scenario's truth cannot be used, or a file cannot be written. ExtraMissingError, a
            RecordError, if asammdf is not installed for MF4.
        """
        check_word("log_format", log_format, list(RecordFormat))
        log = LogOptions(
            path=Path(path),
            log_format=log_format,
            start_ns=DEFAULT_START_NS if start_time is None else ns_of(start_time),
            channel=channel,
            truth=self._truth_path,
            longest_stay_s=scenarios.MOST_PARKED_S if self._parked_s is None else self._parked_s,
        )
        return write_log(self.scenario, log, Event())  # that of the bus is set when the drive there is over

    def step(
        self, duration_s: float, speed_m_s: float | None = None, pedal_ratio: float | None = None
    ) -> list[can.Message]:
        """Drive on for this time, at the caller's pace, and return the frames of it; none once the drive is over.

        Without speed and pedal the car drives what its scenario says, and its frames are those of ``record`` to the
        bit; a step ends where a trip does. With both somebody else moves the car, a driving simulator for one: gears,
        clutches and engine follow. What the first step does, all do. A car that is moved or stopped at once, as games
        do, opens its clutches and finds its gear anew.

        Parameters
        ----------
        duration_s
            Any time up to ten minutes, such as 1/60. The car is driven in whole milliseconds; what is left of one is
            added to the next step.
        speed_m_s, pedal_ratio
            Speed of the car at the end of the step, 0..100, and its accelerator pedal, 0..1.

        Raises
        ------
        ConfigError
            If a number cannot be, or the car drives on a bus or otherwise already.
        """
        if (speed_m_s is None) != (pedal_ratio is None):
            raise EmulatorConfigError("speed_m_s and pedal_ratio belong together")
        if not 0.0 < duration_s <= LONGEST_STEP_S:
            raise EmulatorConfigError(f"duration_s must be above 0, up to {LONGEST_STEP_S:g}, got {duration_s:g}")
        if speed_m_s is not None and pedal_ratio is not None:
            check_number("speed_m_s", speed_m_s, 0.0, FASTEST_M_S)
            check_number("pedal_ratio", pedal_ratio, 0.0, 1.0)
        if self._drive is None:
            self._be_stepped(is_steered=speed_m_s is not None)
        if self._drive is None or self._sent is None or self._thread is not None:
            raise EmulatorConfigError("the car drives on a bus: it cannot be stepped")
        if (self._steering is None) != (speed_m_s is None):
            raise EmulatorConfigError("a car is steered in each of its steps, or in none")
        if self._steering is not None and speed_m_s is not None and pedal_ratio is not None:
            self._steering.speed_m_s, self._steering.pedal_ratio = float(speed_m_s), float(pedal_ratio)
        step_s = self._grid.whole_ms(duration_s) / MS_PER_S
        stretch = None if self._drive.finished or step_s == 0.0 else self._drive.advance(step_s)
        if stretch is None:
            return []
        self._sent.take(stretch)
        return to_messages(stretch.frames)

    def _be_stepped(self, *, is_steered: bool) -> None:
        if self._answers is not None:
            raise EmulatorConfigError("testers are answered in real time: a car that is stepped has no `answers`")
        if is_steered:
            self._steering = steering = Steering()
            scenario, trip = replace(self.scenario, drive=DriveName.CITY), PlannedTrip(trace=STEERED, parked_s=0.0)
            self._drive = Drive(scenario, planned=iter([trip]), make_trip=partial(SteeredTrip, steering))
        else:
            self._drive = Drive(self.scenario, scenarios.MOST_PARKED_S if self._parked_s is None else self._parked_s)
        self._sent = SentTruth(self._drive, None, MAX_TRUTHS)

    def __enter__(self) -> Self:
        if self._drive is not None:
            raise EmulatorConfigError("an emulator drives only once; make another one")
        self._drive = Drive(self.scenario, scenarios.LIVE_PARKED_S if self._parked_s is None else self._parked_s)
        bus = self._choice.opened(self._notices.append, self._options)
        try:
            if self._truth_path is not None:
                self._file = TruthWriter(self._truth_path)
            self._sent = SentTruth(self._drive, self._file, MAX_TRUTHS, pace=self._pace)
        except BaseException:
            bus.shutdown()
            raise
        self._thread = Thread(target=self._work, args=(bus, self._sent), name="emulator", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._stop.set()
        self._running().join()
        if error is None:
            self._raise()

    @property
    def bus_arguments(self) -> dict[str, Any]:
        """What ``can.Bus`` is to be given for another end of the bus: ``can.Bus(**car.bus_arguments)``."""
        return {"interface": self._choice.interface, "channel": self._choice.channel, **self._options}

    def open_bus(self) -> can.BusABC:
        """Return another end of the bus, for the caller to close; raises BusError if it cannot be opened."""
        return open_bus(
            self._choice.interface, self._choice.channel, self._choice.bitrate, fd=self._choice.is_fd,
            options=self._options,
        )  # fmt: skip

    @property
    def truth(self) -> TruthLog:
        """What was true of the shifts whose frames have been sent until now."""
        if self._sent is None:
            raise EmulatorConfigError("the car is not driving yet: there is no truth")
        return self._sent.log

    @property
    def sent_s(self) -> float:
        """How far the drive has come on the bus [s], as of a fifth of a second ago."""
        return 0.0 if self._sent is None else self._sent.sent_s

    @property
    def is_driving(self) -> bool:
        """Whether frames are still going out."""
        if self._thread is None:
            return self._drive is not None and not self._drive.finished
        return self._thread.is_alive()

    @property
    def notices(self) -> tuple[str, ...]:
        """What the program says while it drives: where testers may ask, who else is on the bus, how punctual it was."""
        return tuple(self._notices)

    @property
    def result(self) -> Mapping[str, Any]:
        """How the drive went, as ``ecu-emulator run --json`` prints it; raises ConfigError while it goes on."""
        if self._result is None:
            raise EmulatorConfigError("the drive is not over: stop() or wait() first")
        return self._result

    def add_fault(self, fault: AnyFault) -> None:
        """Have something go wrong from now on; ``start_s`` counts from now.

        Frames are made two seconds ahead, unless the car ``is_prompt``: so long it may take until it is on the bus.
        Raises ConfigError if it cannot happen.
        """
        self._orders().add_fault(fault_of(fault))

    def switch_engine(self, *, is_on: bool) -> None:
        """End the trip and be silent from now on, or begin the next trip; raises ConfigError if there are no trips."""
        self._orders().switch_engine(is_on=is_on)

    def end_trip(self) -> None:
        """Park now, and begin the next trip as it is planned; raises ConfigError if there are no trips."""
        self._orders().end_trip()

    def request_gear(self, gear: int) -> None:
        """Have a gear engaged, unless the engine would be too fast or too slow; raises ConfigError if there is none."""
        self._orders().request_gear(gear)

    def wait_until(self, t_s: float, timeout_s: float) -> None:
        """Return when the frames up to a time of the drive [s] are sent; raises TimeoutError, or what ended it."""
        check_is_number("t_s", t_s)
        check_is_number("timeout_s", timeout_s)
        deadline_s = time.monotonic() + timeout_s
        while True:
            is_driving = self.is_driving  # asked first: what is sent after that is seen by the next look
            if self.sent_s >= t_s:
                return
            if not is_driving:
                self._raise()
                raise TimeoutError(f"the drive has ended after {self.sent_s:g} s")
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s the drive is at {self.sent_s:g} s")
            time.sleep(POLL_S)

    def wait(self, timeout_s: float | None = None) -> Mapping[str, Any]:
        """Return ``result`` when all has been driven; raises TimeoutError if it has not by then, or what ended it."""
        check_is_number("timeout_s", timeout_s)
        thread = self._running()
        thread.join(timeout_s)
        if thread.is_alive():
            raise TimeoutError(f"after {timeout_s:g} s the drive is at {self.sent_s:g} s")
        self._raise()
        return self.result

    def stop(self) -> Mapping[str, Any]:
        """End the drive now and return ``result``; raises what ended it before."""
        self._stop.set()
        return self.wait()

    def _work(self, bus: can.BusABC, sent: SentTruth) -> None:
        try:
            with (
                bus,
                self._file or nullcontext(),
                answering_of(self._answers, bus, self._choice, self.scenario, sent.drive) as answering,
            ):
                self._result = send(
                    self.scenario, sent, bus, choice=self._choice, answering=answering,
                    stop=self._stop, say=self._notices.append, show=lambda *_: None,
                )  # fmt: skip
        except BaseException as exc:  # noqa: BLE001 - carried to the thread that waits
            self._error = exc

    def _orders(self) -> LiveOrders:
        if self._sent is None:
            raise EmulatorConfigError("the car is not driving yet: name the fault among `faults`")
        return self._sent.orders

    def _running(self) -> Thread:
        if self._thread is None:
            raise EmulatorConfigError("the car is not driving: use it in a with block")
        return self._thread

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error


def write_dbc(output: AnyPath, *, transmission: str = "nominal") -> int:
    """Write the DBC file of the vehicle with a transmission, as ``ecu-emulator dbc``; one there is replaced.

    Returns its size [bytes]. Raises RecordError if it cannot be written.
    """
    return save_dbc(Path(output), is_forced=True, transmission=transmission)
