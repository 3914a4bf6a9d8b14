"""One drive from plant to frames: the only file that knows the order of the emulator's stages."""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Final

from canlog.arrays import FloatArray
from canlog.e2e.message_contract import message_contracts
from clutch_model.errors import CalibrationError
from dbc.contract import load_contract
from ecu_emulator.bus.bus_faults import BusFaults, FrameLoss
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder, merge
from ecu_emulator.drive import build
from ecu_emulator.driving.journey import Departure, Journey, PlannedTrip, Trip, trips
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.faults import BusFault, Degradation, Fault
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.sensing import MS_PER_S, SensorSuite
from ecu_emulator.shift_control.touch_points import nominal_touch_pressures_pa
from ecu_emulator.truth import (
    EventTruth,
    EventWatcher,
    FaultTruth,
    Happened,
    RevWatcher,
    ShiftTruth,
    ShiftWatcher,
    ShudderWatcher,
    Totals,
    TripTruth,
    TruthLog,
    known_at_s,
    truth_log,
)

LONG_STRETCH_S: Final = 10.0  # for files
MOST_STARTS: Final = 64  # that nobody has asked for
SHORT_STRETCH_S: Final = 0.25  # live: a stretch must not hold the interpreter for long


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveStretch:
    """What a stretch of driving puts on the bus, and what happened in it, in the order in which it is known."""

    frames: EncodedFrames
    truths: tuple[Happened, ...]
    end_s: float  # scenario time reached


class Drive:
    """One drive of one built vehicle: plant, sensors and frame builder in step.

    The frames depend on the scenario only, not on the length of the stretches; memory does not grow with the drive.
    On the road a drive is made of trips, each of which begins as the ignition is switched on.

    Parameters
    ----------
    longest_stay_s
        Of the time for which the car is parked between two trips at most this much [s] is shown.
    planned
        Trips in place of those that the scenario names.
    make_trip
        Sets a car in motion on a trip.

    Raises
    ------
    ConfigError
        If the scenario's truth is not possible.
    """

    def __init__(
        self,
        scenario: Scenario,
        longest_stay_s: float = build.WHOLE_STAY_S,
        planned: Iterator[PlannedTrip] | None = None,
        make_trip: build.MakeTrip = Trip,
    ) -> None:
        self._make_trip = make_trip
        self._scenario = scenario
        self._vehicle = vehicle = build.build_vehicle(scenario)
        database = load_contract(scenario.transmission)
        self._encoder = FrameEncoder(database)
        self._touch_pa = None if scenario.adapted else nominal_touch_pressures_pa(scenario.transmission)
        self._plant = self._made_plant(longest_stay_s, planned)
        self._departure: Departure | None = None
        has_converter = vehicle.calibration.converter is not None  # where changes of gear tell nothing
        self._shudder = ShudderWatcher()
        self._watchers = (self._shudder,) if has_converter else (ShiftWatcher(), RevWatcher(), EventWatcher())
        self._sensors = SensorSuite(
            schedules=build.schedules(scenario, message_contracts(database), self._encoder),
            sensors=vehicle.sensors,
            installation=build.installation(scenario, vehicle),
            startup_s=scenario.startup.by_sender(),
            seed=scenario.seed_of_drive,
            faults=scenario.sensor_faults,
        )
        self._loss = FrameLoss(scenario.effects.frame_loss_ratio, scenario.seed_of_drive)
        self._bus_faults = BusFaults(scenario.bus_faults, scenario.seed_of_drive, message_contracts(database))
        self.ignition: Final[deque[float]] = deque(maxlen=MOST_STARTS)  # see Answering
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()  # filled by other threads
        self._causes: list[FaultTruth] = []  # that have come about meanwhile
        self._counts: Counter[type[Happened]] = Counter()
        self._frame_count = 0
        self._end_s = 0.0
        self._driven_ms = 0
        self._odometer_m = scenario.odometer_m
        self.truth: Final = build.drive_truth(scenario, vehicle)

    @property
    def totals(self) -> Totals:
        return Totals(
            shifts=self._counts[ShiftTruth],
            events=self._counts[EventTruth],
            duration_s=self._end_s,
            slipping_s=self._shudder.slipping_s,
            driven_s=self._driven_ms / MS_PER_S,
            frames=self._frame_count,
            faults=self._fault_truths(),
            odometer_m=self._odometer_m,
        )

    @property
    def finished(self) -> bool:
        return self._plant.finished

    @property
    def endless_shift(self) -> str:
        """What is to be said of a shift that does not end, and so ends the drive; empty: there is none."""
        return self._plant.endless_shift if isinstance(self._plant, Powertrain) else ""

    def add_fault(self, fault: Fault) -> None:
        """Have a fault happen; its time counts from the next stretch on. Any thread may call.

        Raises ConfigError if it names a message or quantity that is not on the bus, or the car cannot be so bad.
        """
        if isinstance(fault, BusFault):
            self._bus_faults.check(fault)
            self._asked.put(lambda: self._bus_faults.add(fault, self._end_s))
        elif isinstance(fault, Degradation):
            build.build_vehicle(self._with_cause(fault))
            self._asked.put(lambda: self._degrade(fault))
        else:
            self._sensors.check(fault)
            self._asked.put(lambda: self._sensors.faults.add(fault, self._end_s))

    @property
    def is_waiting(self) -> bool:
        """Whether the car waits for somebody to ask for the workshop routine."""
        return isinstance(self._plant, Powertrain) and self._plant.is_waiting

    def order(self, action: Callable[[Powertrain], None]) -> None:
        """Have a car on its shift cycles do something before the next stretch. Any thread may call."""
        if isinstance(plant := self._plant, Powertrain):
            self._asked.put(lambda: action(plant))

    def switch_engine(self, *, is_on: bool, stay_s: float = 0.0) -> None:
        """End the trip, or begin the next one after a stay of this length [s]. Any thread may call.

        Raises ConfigError if the car drives no trips.
        """
        journey = self._journey()
        self._asked.put((lambda: journey.switch_on(stay_s)) if is_on else journey.switch_off)

    def end_trip(self) -> None:
        """End the trip; the next one begins as it is planned. Any thread may call; raises as ``switch_engine``."""
        journey = self._journey()
        self._asked.put(journey.end_trip)

    def request_gear(self, gear: int) -> None:
        """Ask for a gear; what the engine speed forbids is not done. Threads and errors as of ``switch_engine``."""
        journey = self._journey()
        gears = range(1, len(self._vehicle.parameters.gearbox.gear_ratios) + 1)
        if gear not in gears:
            raise EmulatorConfigError(f"gear must be a whole number, 1..{gears[-1]}, got {gear}")
        self._asked.put(lambda: journey.request_gear(gear))

    @property
    def is_off(self) -> bool:
        """Whether the car is parked until the engine is switched on."""
        return isinstance(self._plant, Journey) and self._plant.is_off

    @property
    def transmission(self) -> str:
        return self._scenario.transmission

    @property
    def is_adapted(self) -> bool:
        """Whether the control knew its clutches' touch points as the drive began."""
        return self._scenario.adapted

    @property
    def touch_pressures_pa(self) -> tuple[float, float]:
        """Touch points that the control works with [Pa]."""
        first, second = self._vehicle.calibration.clutches
        return self._touch_pa or (first.touch_pressure_pa, second.touch_pressure_pa)

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control take these for its clutches' touch points from the next stretch on. Any thread may call."""
        self._touch_pa = touch_pressures_pa
        self._asked.put(lambda: self._plant.believe(touch_pressures_pa))

    def stretches(self, duration_s: float) -> Iterator[DriveStretch]:
        """Yield the rest of the drive in stretches of this length [s]."""
        while not self.finished:
            if stretch := self.advance(duration_s):
                yield stretch

    def advance(self, duration_s: float) -> DriveStretch | None:
        """Drive on for this time [s], less where a trip ends; None: the car is parked, or there is nothing left."""
        self.obey()
        rows = self._plant.advance(duration_s)
        return self._stretch(rows) if len(rows) else None

    def obey(self) -> None:
        """Do what was asked for since the last stretch; for the thread that drives.

        What was asked for behind the end of a trip, or its beginning, waits until that has come.
        """
        while not (self._asked.empty() or self._is_at_turn):
            self._asked.get()()

    @property
    def _is_at_turn(self) -> bool:
        return isinstance(self._plant, Journey) and self._plant.is_at_turn

    def _journey(self) -> Journey:
        if isinstance(self._plant, Journey):
            return self._plant
        raise EmulatorConfigError("the car drives its shift cycles, not on the road (--drive city)")

    def _with_cause(self, cause: Degradation) -> Scenario:
        return replace(self._scenario, causes=(*self._scenario.causes, cause))

    def _degrade(self, cause: Degradation) -> None:
        """Let something be wrong with the car from the next row on."""
        self._scenario = self._with_cause(cause)
        vehicle = self._vehicle = build.build_vehicle(self._scenario)
        plant = self._plant.car if isinstance(self._plant, Journey) else self._plant
        if plant is not None:  # a parked car sets off with what is wrong by then
            plant.become(vehicle.calibration, vehicle.parameters)
        self._sensors.drift(vehicle.sensors)
        truth = vehicle.causes[-1]
        self._causes.append(
            FaultTruth(
                what="transmission" if truth.clutch is None else f"clutch{truth.clutch}",
                kind=truth.kind,
                size=truth.strength,
                t_start_s=self._end_s,
                t_end_s=None,
                count=0,
            )
        )

    def _made_plant(self, longest_stay_s: float, planned: Iterator[PlannedTrip] | None) -> Powertrain | Journey:
        scenario, vehicle = self._scenario, self._vehicle
        try:
            if scenario.is_on_the_road:
                rounds = None if scenario.endless else scenario.cycles
                planned = planned or trips(scenario.drive, scenario.seed_of_drive, rounds)
                return build.journey(
                    scenario, lambda: self._vehicle, longest_stay_s, planned, lambda: self._touch_pa, self._make_trip
                )
            settings = build.drive_settings(scenario)
            touch_pa = self._touch_pa
            return Powertrain(vehicle.calibration, vehicle.parameters, settings, touch_pressures_pa=touch_pa)
        except CalibrationError as exc:
            raise EmulatorConfigError(
                f"scenario {scenario.name}: drive {scenario.drive} is not possible: {exc}"
            ) from exc

    def _fault_truths(self) -> tuple[FaultTruth, ...]:
        sensors, bus = self._sensors.faults, self._bus_faults
        described = [(fault.quantity, fault.kind.value, fault.size) for fault in sensors.faults]
        described += [(fault.message or "bus", fault.kind.value, fault.share) for fault in bus.onsets.faults]
        spans_s, counts = (*sensors.spans_s, *bus.onsets.spans_s), (*sensors.changed_counts, *bus.counts)
        return *self._causes, *(
            FaultTruth(
                what=what,
                kind=kind,
                size=size,
                t_start_s=start_s,
                t_end_s=stop_s if math.isfinite(stop_s) else None,
                count=count,
            )
            for (what, kind, size), (start_s, stop_s), count in zip(described, spans_s, counts, strict=True)
            if start_s <= self._end_s
        )

    def _stretch(self, rows: FloatArray) -> DriveStretch:
        is_last = self.finished or (isinstance(self._plant, Journey) and self._plant.is_parked)
        truths = sorted([*self._begun_trip(), *self._watched(rows, is_last=is_last)], key=known_at_s)
        frames = self._loss.surviving(self._encoder.encode_all(self._sensors.read(rows)))
        first_s, self._end_s = (round(float(rows[row, Col.T_S]), 3) for row in (0, -1))
        frames = self._bus_faults.feed(frames, rows, round(first_s * MS_PER_S), self._end_s, is_last=self.finished)
        if len(frames) and not self._frame_count:
            self.ignition.appendleft(float(frames.t_s[0]))
        self._counts.update(map(type, truths))
        self._frame_count += len(frames)
        self._driven_ms += len(rows)
        self._odometer_m = self._scenario.odometer_m + float(rows[-1, Col.DISTANCE])
        return DriveStretch(frames=frames, truths=tuple(truths), end_s=self._end_s)

    def _begun_trip(self) -> list[TripTruth]:
        """Return the trip that the rows driven last begin, if they do; a car that was parked is switched on."""
        departure = self._plant.departure if isinstance(self._plant, Journey) else None
        if departure is None or departure is self._departure:
            return []
        self._departure = departure
        self._sensors.restart()
        if departure.trip.parked_s > 0.0:
            self._sensors.switch_on(departure.t_start_s)
            self._encoder.restart()
            self.ignition.append(departure.t_start_s)
        return [build.trip_truth(departure, self._scenario, self._vehicle.calibration)]

    def _watched(self, rows: FloatArray, *, is_last: bool) -> list[Happened]:
        truths: list[Happened] = [truth for watcher in self._watchers for truth in watcher.feed(rows)]
        return [*truths, *(truth for watcher in self._watchers for truth in watcher.finish())] if is_last else truths


def frames_of(scenario: Scenario) -> tuple[EncodedFrames, TruthLog]:
    """Return all frames of a drive and its truth, without files; for tests and studies of short drives."""
    drive = Drive(scenario)
    stretches = list(drive.stretches(LONG_STRETCH_S))
    truths = [truth for stretch in stretches for truth in stretch.truths]
    return merge([stretch.frames for stretch in stretches]), truth_log(drive.truth, truths, drive.totals)
