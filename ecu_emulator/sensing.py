"""Sensors: plant rows, one per millisecond, become readings at the send instants of every message, wrong as scripted.

The result depends on the rows and the seed only, not on how the rows were cut into chunks. Only columns in
``MEASURABLE`` are read: what no production sensor sees (friction, film, clutch torque) cannot reach the bus.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from canlog.jit import kernel
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.faults import (
    NOMINAL_SENSORS,
    STATES,
    Phase,
    Scheduled,
    Sensor,
    SensorFault,
    SensorFaultKind,
    Sensors,
    generator,
    split_unit,
)

MS_PER_S: Final = 1000.0
ScheduledT = TypeVar("ScheduledT", bound=Scheduled)


class Onsets(Generic[ScheduledT]):
    """Scheduled faults, with begin and end of each in milliseconds of scenario time; infinite while not known."""

    def __init__(self) -> None:
        self.faults: list[ScheduledT] = []
        self._start_ms: list[float] = []
        self._last = np.zeros(3)  # current gear, target gear, phase
        self._shift_count = 0  # completed, as the truth counts them

    def add(self, fault: ScheduledT, origin_s: float = 0.0) -> None:
        """Take one more fault; without a shift its start counts from ``origin_s``."""
        self.faults.append(fault)
        self._start_ms.append(math.inf if fault.shift else origin_s * MS_PER_S + math.ceil(fault.start_s * MS_PER_S))

    def feed(self, rows: FloatArray, first_ms: int) -> None:
        """Look for the phases of shifts in the next plant rows, one per millisecond."""
        states = np.vstack((self._last, rows[:, (Col.CURRENT_GEAR, Col.TARGET_GEAR, Col.SHIFT_PHASE)]))
        for row in np.flatnonzero(np.any(np.diff(states, axis=0), axis=1)).tolist():
            (was, wanted, before), (gear, _, phase) = states[row : row + 2].tolist()
            self._shift_count += was != gear == wanted and was > 0.0
            for index, fault in enumerate(self.faults if gear and phase != before else ()):
                if fault.shift == self._shift_count + 1 and phase == 1 + list(Phase).index(fault.phase):
                    self._start_ms[index] = first_ms + row + math.ceil(fault.start_s * MS_PER_S)
        self._last = states[-1]

    def span_ms(self, index: int) -> tuple[float, float]:
        """Return begin and end [ms] of one of them; what is at the end is outside."""
        start_ms = self._start_ms[index]
        return start_ms, start_ms + self.faults[index].duration_s * MS_PER_S

    @property
    def spans_s(self) -> tuple[tuple[float, float], ...]:
        """Begin and end [s] of each."""
        spans_ms = map(self.span_ms, range(len(self.faults)))
        return tuple((start_ms / MS_PER_S, stop_ms / MS_PER_S) for start_ms, stop_ms in spans_ms)


class SensorFaults(Onsets[SensorFault]):
    """All scripted sensor faults of a drive."""

    def __init__(self, faults: Sequence[SensorFault]) -> None:
        super().__init__()
        self._held: dict[int, float] = {}  # by number of the fault, the last reading before it
        self.changed_counts: Final[list[int]] = []  # readings that each fault has touched
        for fault in faults:
            self.add(fault)

    def add(self, fault: SensorFault, origin_s: float = 0.0) -> None:
        super().add(fault, origin_s)
        self.changed_counts.append(0)

    def applied(self, quantity: str, send_ms: npt.NDArray[np.int64], reading: FloatArray) -> FloatArray:
        """Return the readings of one quantity at these instants, shape (n,), as the faults leave them."""
        for index, fault in enumerate(self.faults):
            if fault.quantity == quantity and len(reading):
                reading = self._wrong(index, send_ms, reading)
        return reading

    def _wrong(self, index: int, send_ms: npt.NDArray[np.int64], reading: FloatArray) -> FloatArray:
        fault = self.faults[index]
        start_ms, stop_ms = self.span_ms(index)
        first, stop = np.searchsorted(send_ms, (start_ms, stop_ms)).tolist()
        if first:
            self._held[index] = float(reading[first - 1])
        if fault.kind is SensorFaultKind.SPIKE:
            stop = min(stop, first + (self.changed_counts[index] == 0))
        if first >= stop:
            return reading
        wrong = reading.copy()
        match fault.kind:
            case SensorFaultKind.FROZEN:
                if math.isnan(self._held.get(index, math.nan)):
                    self._held[index] = float(reading[first])
                wrong[first:stop] = self._held[index]
            case SensorFaultKind.OFFSET | SensorFaultKind.SPIKE:
                wrong[first:stop] += fault.size
            case SensorFaultKind.DRIFT:
                wrong[first:stop] += fault.size * (send_ms[first:stop] - start_ms) / MS_PER_S
            case SensorFaultKind.NOT_AVAILABLE:
                wrong[first:stop] = math.nan
        self.changed_counts[index] += stop - first
        return wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """When one message is sent, by whom, and what it carries."""

    message: str
    sender: str
    cycle_ms: int
    phase_ms: int
    quantities: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """Values of one message at its send instants, keyed by quantity (SI); NaN: not available."""

    message: str  # DBC message name
    t_s: FloatArray  # (n,) scenario time
    values: Mapping[str, FloatArray]  # each (n,)


MAX_SEGMENT_MS: Final = 250  # the engine speed of a nearly stalled engine is the mean over this time
BRAKE_PA_PER_M_S2: Final = 1.0e6  # about 10 bar of brake pressure per m/s^2, a passenger car's class of value
CRANK_QUANTITY: Final = "engine_speed_rad_s"
UNSIGNED_UNITS: Final = frozenset({"rad_s", "m_s"})  # tooth wheels do not tell the direction


@dataclass(frozen=True, slots=True, kw_only=True)
class Installation:
    """What the sensors' surroundings contribute: geometry, and the air, whose temperature does not move."""

    crank_segment_rad: float  # engine speed is the mean over this crank angle
    output_ratio: float  # output shaft over differential speed
    wheel_radius_m: float
    ambient_temperature_k: float
    odometer_m: float  # at the start of the drive
    engine_speed_is_sampled: bool = False  # the broadcast speed is instantaneous, not a mean
    motoring_torque_ratio: float = 1.0  # on negative torque, as the engine controller's model gets it


_DIRECT: Final[Mapping[str, Col]] = {
    "pedal_ratio": Col.PEDAL,
    "throttle_ratio": Col.THROTTLE,
    "hub_speed_rad_s": Col.HUB_SPEED,
    "input1_speed_rad_s": Col.INPUT1_SPEED,
    "input2_speed_rad_s": Col.INPUT2_SPEED,
    "clutch1_pressure_pa": Col.PRESSURE1,
    "clutch2_pressure_pa": Col.PRESSURE2,
    "clutch1_pressure_command_pa": Col.PRESSURE1_COMMAND,
    "clutch2_pressure_command_pa": Col.PRESSURE2_COMMAND,
    "clutch1_torque_command_nm": Col.TORQUE1_COMMAND,
    "clutch2_torque_command_nm": Col.TORQUE2_COMMAND,
    "turbine_speed_rad_s": Col.TURBINE_SPEED,
    "lockup_pressure_pa": Col.PRESSURE1,
    "lockup_pressure_command_pa": Col.PRESSURE1_COMMAND,
    "lockup_state": Col.LOCKUP_STATE,
    "current_gear": Col.CURRENT_GEAR,
    "target_gear": Col.TARGET_GEAR,
    "preselected_gear": Col.PRESELECTED_GEAR,
    "shift_phase": Col.SHIFT_PHASE,
    "input1_gear": Col.SHAFT1_GEAR,
    "input2_gear": Col.SHAFT2_GEAR,
    "drive_state": Col.DRIVE_STATE,
    "engine_state": Col.ENGINE_STATE,
    "sump_temperature_k": Col.SUMP_TEMPERATURE,
    "coolant_temperature_k": Col.COOLANT_TEMPERATURE,
    "wheel_rl_speed_m_s": Col.VEHICLE_SPEED,
    "wheel_rr_speed_m_s": Col.VEHICLE_SPEED,
    "vehicle_speed_m_s": Col.VEHICLE_SPEED,
    "manifold_pressure_pa": Col.MANIFOLD_PRESSURE,
}
_DERIVED: Final[Mapping[str, Callable[[FloatArray, Installation], FloatArray]]] = {
    "engine_torque_nm": lambda rows, place: (
        rows[:, Col.ENGINE_TORQUE] * np.where(rows[:, Col.ENGINE_TORQUE] < 0.0, place.motoring_torque_ratio, 1.0)
    ),
    "output_speed_rad_s": lambda rows, place: rows[:, Col.DIFF_SPEED] * place.output_ratio,
    "wheel_fl_speed_m_s": lambda rows, place: rows[:, Col.WHEEL_SPEED] * place.wheel_radius_m,
    "wheel_fr_speed_m_s": lambda rows, place: rows[:, Col.WHEEL_SPEED] * place.wheel_radius_m,
    "brake_pressure_pa": lambda rows, _: rows[:, Col.BRAKE] * BRAKE_PA_PER_M_S2,
    "brake_light": lambda rows, _: (rows[:, Col.BRAKE] > 0.0).astype(np.float64),
    "odometer_m": lambda rows, place: place.odometer_m + rows[:, Col.DISTANCE],
    "ambient_temperature_k": lambda rows, place: np.full(len(rows), place.ambient_temperature_k),
}
QUANTITIES: Final = frozenset({CRANK_QUANTITY, *_DIRECT, *_DERIVED})
MEASURABLE: Final = frozenset(_DIRECT.values()) | {
    Col.T_S, Col.ENGINE_SPEED, Col.ENGINE_TORQUE, Col.CRANK_ANGLE,
    Col.DIFF_SPEED, Col.WHEEL_SPEED, Col.BRAKE, Col.DISTANCE,
}  # fmt: skip


@kernel
def fill_first_order_lag(signal: FloatArray, state: float, weight: float, filtered: FloatArray) -> None:
    """Fill in ``y[k] = y[k-1] + weight * (signal[k] - y[k-1])``, shape (n,), starting from ``state``."""
    for k in range(signal.size):
        state += weight * (signal[k] - state)
        filtered[k] = state


class CrankSpeed:
    """Engine speed as engine controllers broadcast it: the mean over the last crank segment."""

    def __init__(self, segment_rad: float) -> None:
        self._segment_rad = segment_rad
        self._past_rad = np.empty(0)  # crank angle of the last MAX_SEGMENT_MS rows

    def restart(self) -> None:
        """Forget the past: what comes next is the beginning of a drive."""
        self._past_rad = np.empty(0)

    def feed(self, angle_rad: FloatArray, speed_rad_s: FloatArray, first_ms: int) -> FloatArray:
        """Return the mean speed [rad/s] at every new row, shape (n,); before the drive the engine ran steadily."""
        if not self._past_rad.size:
            past_s = np.arange(-MAX_SEGMENT_MS, 0) / MS_PER_S
            self._past_rad = angle_rad[0] + past_s * speed_rad_s[0]
        angles_rad = np.concatenate((self._past_rad, angle_rad))
        grid_ms = np.arange(first_ms - MAX_SEGMENT_MS, first_ms + angle_rad.size, dtype=np.float64)
        now_ms = grid_ms[MAX_SEGMENT_MS:]
        since_ms = np.maximum(np.interp(angle_rad - self._segment_rad, angles_rad, grid_ms), now_ms - MAX_SEGMENT_MS)
        turned_rad = angle_rad - np.interp(since_ms, grid_ms, angles_rad)
        self._past_rad = angles_rad[-MAX_SEGMENT_MS:]
        return turned_rad / (now_ms - since_ms) * MS_PER_S


class Chain:
    """One measuring chain: from the millisecond trace of a quantity to its readings; errors as in ``Sensor``."""

    def __init__(self, quantity: str, sensor: Sensor, seed: int) -> None:
        self._sensor = sensor
        self._is_unsigned = split_unit(quantity)[1] in UNSIGNED_UNITS
        self._random = generator(seed, quantity)
        latency_ms = round(sensor.latency_s * MS_PER_S, 6)
        self._delay = math.ceil(latency_ms)
        self._ahead = 0.0 if quantity in STATES else self._delay - latency_ms
        self._lag_weight = -math.expm1(-1.0 / (sensor.lag_s * MS_PER_S)) if sensor.lag_s > 0.0 else 1.0
        self._lag_state = math.nan
        self._trace = np.empty(0)
        self._first_ms = 0

    def drift(self, sensor: Sensor) -> None:
        """Err in gain and offset as this sensor does, from the next reading on; delay and noise stay."""
        self._sensor = replace(self._sensor, gain_ratio=sensor.gain_ratio, offset=sensor.offset)

    def restart(self) -> None:
        """Forget the past: what comes next is the beginning of a drive."""
        self._trace = np.empty(0)

    def feed(self, trace: FloatArray, first_ms: int) -> None:
        """Append the true quantity at ``first_ms, first_ms + 1, ...``; before the drive it was steady."""
        if not self._trace.size:
            self._trace = np.full(self._delay, trace[0])
            self._lag_state = float(trace[0])
        if self._lag_weight < 1.0:
            signal, trace = np.ascontiguousarray(trace), np.empty(len(trace))
            fill_first_order_lag(signal, self._lag_state, self._lag_weight, trace)
            self._lag_state = float(trace[-1])
        past = self._trace[self._trace.size - self._delay :]
        self._trace = np.concatenate((past, trace))
        self._first_ms = first_ms

    def read(self, send_ms: npt.NDArray[np.int64]) -> FloatArray:
        """Return the readings at the send instants, shape (n,), which lie within the rows fed last."""
        rows = send_ms - self._first_ms
        reading = self._trace[rows]
        if self._ahead > 0.0:
            reading = (1.0 - self._ahead) * reading + self._ahead * self._trace[rows + 1]
        reading = self._sensor.gain_ratio * reading + self._sensor.offset
        if self._sensor.noise_std > 0.0:
            reading = reading + self._sensor.noise_std * self._random.standard_normal(send_ms.size)
        return np.abs(reading) if self._is_unsigned else reading


class SensorSuite:
    """All sensors of the vehicle.

    Parameters
    ----------
    schedules
        The messages to fill; every quantity belongs to one of them.
    sensors
        Errors by quantity; a quantity that is absent is read without error.
    startup_s
        By sender: until then, from the ignition on, every value of its messages is not available.
    seed
        Of the noise; every quantity has a generator of its own.
    faults
        What goes wrong on the way; a fault changes no other reading, nor the noise.

    Raises
    ------
    ConfigError
        If a fault names a quantity that no schedule does.
    """

    def __init__(
        self,
        *,
        schedules: Sequence[Schedule],
        sensors: Sensors,
        installation: Installation,
        startup_s: Mapping[str, float],
        seed: int,
        faults: Sequence[SensorFault] = (),
    ) -> None:
        self._schedules = tuple(schedules)
        self._installation = installation
        self._startup_s = startup_s
        self._switched_on_s = 0.0
        self.faults: Final = SensorFaults(faults)
        self._crank = CrankSpeed(installation.crank_segment_rad)
        self._chains = {
            quantity: Chain(quantity, sensors.get(quantity, Sensor()), seed)
            for schedule in self._schedules
            for quantity in schedule.quantities
        }
        for fault in faults:
            self.check(fault)

    def check(self, fault: SensorFault) -> None:
        """Raise ConfigError if a fault is one of a quantity that this car does not send."""
        if fault.quantity not in self._chains:
            known = ", ".join(sorted(NOMINAL_SENSORS.keys() & self._chains.keys()))
            raise EmulatorConfigError(f"quantity {fault.quantity!r} is not on the bus; known: {known}")

    def drift(self, sensors: Sensors) -> None:
        """Let the chains err in gain and offset as these sensors do, from the next rows on."""
        for quantity, chain in self._chains.items():
            chain.drift(sensors.get(quantity, Sensor()))

    def switch_on(self, t_s: float) -> None:
        """Let the controllers start at this scenario time [s], as when the ignition is switched on."""
        self._switched_on_s = t_s

    def restart(self) -> None:
        """Forget the past: the next rows are the beginning of another trip."""
        self._crank.restart()
        for chain in self._chains.values():
            chain.restart()

    def read(self, rows: FloatArray) -> list[Readings]:
        """Return what is sent during these rows, one entry for each message that is sent at all.

        Parameters
        ----------
        rows : (n, len(Col)) array
            The next plant rows, one per millisecond, following those of the call before.
        """
        if not len(rows):
            return []
        first_ms = round(float(rows[0, Col.T_S]) * MS_PER_S)
        self.faults.feed(rows, first_ms)
        for quantity, chain in self._chains.items():
            chain.feed(self._trace(quantity, rows, first_ms), first_ms)
        due = ((schedule, _send_instants_ms(schedule, first_ms, len(rows))) for schedule in self._schedules)
        return [self._readings(schedule, send_ms) for schedule, send_ms in due if send_ms.size]

    def _readings(self, schedule: Schedule, send_ms: npt.NDArray[np.int64]) -> Readings:
        t_s = send_ms / MS_PER_S
        is_starting = t_s < self._switched_on_s + self._startup_s.get(schedule.sender, 0.0)
        values = {
            quantity: np.where(
                is_starting, np.nan, self.faults.applied(quantity, send_ms, self._chains[quantity].read(send_ms))
            )
            for quantity in schedule.quantities
        }
        return Readings(message=schedule.message, t_s=t_s, values=values)

    def _trace(self, quantity: str, rows: FloatArray, first_ms: int) -> FloatArray:
        if quantity == CRANK_QUANTITY and self._installation.engine_speed_is_sampled:
            return rows[:, Col.ENGINE_SPEED]
        if quantity == CRANK_QUANTITY:
            return self._crank.feed(rows[:, Col.CRANK_ANGLE], rows[:, Col.ENGINE_SPEED], first_ms)
        if quantity in _DIRECT:
            return rows[:, _DIRECT[quantity]]
        return _DERIVED[quantity](rows, self._installation)


def _send_instants_ms(schedule: Schedule, first_ms: int, count: int) -> npt.NDArray[np.int64]:
    earliest = first_ms + (schedule.phase_ms - first_ms) % schedule.cycle_ms
    return np.arange(earliest, first_ms + count, schedule.cycle_ms, dtype=np.int64)
