"""What is measured with which errors, and the faults that a scenario scripts: records that check their own ranges."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from types import MappingProxyType
from typing import ClassVar, Final, TypeVar
from zlib import crc32

import numpy as np

from canlog.e2e.profile1 import COUNTER_PERIOD
from clutch_model.units import m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from ecu_emulator.errors import EmulatorConfigError

MAX_DELAY_S: Final = 0.5  # the longest latency or lag a measuring chain may have
UNITS: Final = ("rad_s", "m_s", "nm", "pa", "ratio", "k", "m")  # longest first: the unit ends a quantity's name

RangedT = TypeVar("RangedT", int, float, None)


def ranged(default: RangedT, low: float, high: float) -> RangedT:
    """Declare a number of a record with its default and its inclusive range; None stays None."""
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedRecord:
    """A record that checks the numbers it declares with ``ranged``, in the order in which it does."""

    error: ClassVar[type[Exception]] = EmulatorConfigError

    def __post_init__(self) -> None:
        for member in fields(self):
            if "low" in member.metadata and (value := getattr(self, member.name)) is not None:
                low, high = member.metadata["low"], member.metadata["high"]
                if not (math.isfinite(value) and low <= value <= high):
                    raise self.error(f"{member.name} must be {low:g}..{high:g}, got {value}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor(CheckedRecord):
    """One measuring chain: ``reading(t) = gain * lag(quantity)(t - latency) + offset + noise``.

    ``offset`` and ``noise_std`` are in the unit that ends the quantity's name. Resolution is the wire contract's:
    readings are rounded where frames are built.
    """

    gain_ratio: float = ranged(1.0, 0.1, 10.0)
    offset: float = ranged(0.0, -math.inf, math.inf)
    noise_std: float = ranged(0.0, 0.0, math.inf)  # white and Gaussian
    latency_s: float = ranged(0.0, 0.0, MAX_DELAY_S)  # pure delay
    lag_s: float = ranged(0.0, 0.0, MAX_DELAY_S)  # time constant of a first-order low-pass, 0: none


Sensors = Mapping[str, Sensor]

NOMINAL_SENSORS: Final[Sensors] = MappingProxyType({
    quantity: Sensor(noise_std=noise_std)
    for noise_std, quantities in (
        (float(rad_s_from_rpm(2.0)), ("engine_speed_rad_s", "hub_speed_rad_s", "input1_speed_rad_s",
                                      "input2_speed_rad_s", "turbine_speed_rad_s", "output_speed_rad_s")),
        (float(pa_from_bar(0.05)), ("clutch1_pressure_pa", "clutch2_pressure_pa", "lockup_pressure_pa",
                                    "brake_pressure_pa")),
        (float(m_s_from_km_h(0.05)), ("wheel_fl_speed_m_s", "wheel_fr_speed_m_s", "wheel_rl_speed_m_s",
                                      "wheel_rr_speed_m_s", "vehicle_speed_m_s")),
        (0.3, ("sump_temperature_k", "coolant_temperature_k", "ambient_temperature_k")),
        (3.0, ("engine_torque_nm",)),
        (500.0, ("manifold_pressure_pa",)),
        (0.0, ("pedal_ratio", "throttle_ratio", "odometer_m", "clutch1_torque_command_nm", "clutch2_torque_command_nm",
               "clutch1_pressure_command_pa", "clutch2_pressure_command_pa", "lockup_pressure_command_pa")),
    )
    for quantity in quantities
})  # fmt: skip
STATES: Final = frozenset({
    "current_gear", "target_gear", "preselected_gear", "shift_phase", "brake_light",
    "input1_gear", "input2_gear", "drive_state", "engine_state", "lockup_state",
})  # fmt: skip
"""Quantities that a controller knows without measuring: they have no sensor errors and are never interpolated."""
SILENCE: Final = "is_silent_"  # begins the name of what says whether a sender has fallen silent; its node follows


def split_unit(quantity: str) -> tuple[str, str]:
    """Split a quantity into its stem and its unit: ``hub_speed_rad_s`` -> ``("hub_speed", "rad_s")``."""
    for unit in UNITS:
        if quantity.endswith(f"_{unit}"):
            return quantity.removesuffix(f"_{unit}"), unit
    return quantity, ""


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one named purpose; names do not disturb each other, nor does their order."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(crc32(name.encode()),)))


MAX_SHIFT: Final = 1_000_000
MAX_HOLD_S: Final = 10.0  # frames are held in memory that long


class Phase(StrEnum):
    """Phases of a shift, by which a fault can be timed; the shift control numbers them 1, 2, ... and holds in 0."""

    PREFILL = "prefill"
    TORQUE = "torque"
    INERTIA = "inertia"
    LOCK_UP = "lock_up"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheduled(CheckedRecord):
    """Something that begins at a time of the drive, or of one of its shifts, and ends a while later.

    ``start_s`` counts from the beginning of the drive; if ``shift`` names one (1, 2, ...), from the beginning of a
    phase of that shift, by default of the shift itself.
    """

    start_s: float = ranged(0.0, 0.0, math.inf)
    shift: int = ranged(0, 0, MAX_SHIFT)  # 0: none
    phase: Phase = Phase.PREFILL
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        CheckedRecord.__post_init__(self)
        if not self.duration_s > 0.0:
            raise EmulatorConfigError(f"duration_s must be > 0, got {self.duration_s}")


class SensorFaultKind(StrEnum):
    """What a measuring chain can do wrong."""

    FROZEN = "frozen"  # repeats the last reading before the fault
    OFFSET = "offset"  # reads ``size`` more
    DRIFT = "drift"  # reads ``size`` more for every second of the fault
    SPIKE = "spike"  # one reading, the first of the fault, is ``size`` more
    NOT_AVAILABLE = "not_available"  # the controller says that it does not know


_SIZED: Final = frozenset({SensorFaultKind.OFFSET, SensorFaultKind.DRIFT, SensorFaultKind.SPIKE})


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFault(Scheduled):
    """One fault of one measuring chain; ``size`` is in the unit of the quantity, of a drift in that unit per second."""

    quantity: str
    kind: SensorFaultKind
    size: float = 0.0

    def __post_init__(self) -> None:
        """Check that the quantity is measured and that the size fits the kind."""
        Scheduled.__post_init__(self)
        if self.quantity not in NOMINAL_SENSORS:
            raise EmulatorConfigError(
                f"quantity {self.quantity!r} has no sensor; known: {', '.join(sorted(NOMINAL_SENSORS))}"
            )
        if not math.isfinite(self.size) or (self.kind in _SIZED) != (self.size != 0.0):
            needed = "a finite size other than 0" if self.kind in _SIZED else "no size"
            raise EmulatorConfigError(f"a fault of kind {self.kind} needs {needed}, got {self.size}")


class CauseKind(StrEnum):
    """What can be wrong with a transmission for good; what each does: `ecu_emulator.drive.build`."""

    AGED_FLUID = "aged-fluid"
    WATER = "water"
    WRONG_FLUID = "wrong-fluid"
    AIR = "air"
    WEAK_PUMP = "weak-pump"
    TORQUE_SENSOR = "torque-sensor"
    SYNCHRONISER = "synchroniser"
    GLAZED_LINING = "glazed-lining"  # this and what follows: of one clutch
    WORN_LINING = "worn-lining"
    RETURN_SPRING = "return-spring"
    PRESSURE_SENSOR = "pressure-sensor"
    DRAGGING_CLUTCH = "dragging-clutch"

    @property
    def is_of_one_clutch(self) -> bool:
        return list(CauseKind).index(self) >= list(CauseKind).index(CauseKind.GLAZED_LINING)


MAX_STRENGTH: Final = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation(CheckedRecord):
    """Something that is wrong with a car, and grows from drive to drive by the odometer as a drive begins.

    A strength of 1 is the smallest that matters; at ``begins_m`` it is none, ``grows_over_m`` later all of it.
    """

    kind: CauseKind
    strength: float = ranged(1.0, 0.0, MAX_STRENGTH)
    clutch: int = 0  # 1 or 2; 0: drawn with the vehicle
    begins_m: float = ranged(0.0, 0.0, math.inf)
    grows_over_m: float = ranged(0.0, 0.0, math.inf)

    def __post_init__(self) -> None:
        CheckedRecord.__post_init__(self)
        if self.clutch not in ((0, 1, 2) if self.kind.is_of_one_clutch else (0,)):
            raise EmulatorConfigError(f"clutch of {self.kind} must be {'0..2' if self.kind.is_of_one_clutch else 0}")

    def strength_at(self, odometer_m: float) -> float:
        """Return how strong it is in a drive that begins here."""
        if odometer_m < self.begins_m:
            return 0.0
        grown_m = odometer_m - self.begins_m
        return self.strength * (min(grown_m / self.grows_over_m, 1.0) if self.grows_over_m else 1.0)


class BusFaultKind(StrEnum):
    """What can happen to frames between controller and receiver, or inside the controller that sends them."""

    LOSS = "loss"  # never arrives
    SILENCE = "silence"  # nothing arrives, while the controllers go on counting
    RESTART = "restart"  # the sender falls silent and begins to count from zero
    DUPLICATE = "duplicate"  # arrives twice
    REORDER = "reorder"  # arrives behind its successor
    DELAY = "delay"  # arrives later, in order
    BAD_CRC = "bad_crc"
    STUCK_COUNTER = "stuck_counter"
    SKIPPING_COUNTER = "skipping_counter"  # the counter runs ahead by ``skip``
    SHORT = "short"  # four bytes instead of eight
    SPOOF = "spoof"  # a second sender uses the identifier, with a counter of its own and a sound CRC
    ERROR_FRAME = "error_frame"  # an error frame behind it
    OVERLOAD = "overload"  # foreign frames fill what ``share`` of the bit rate leaves free


_WHOLE: Final = frozenset(
    {BusFaultKind.SILENCE, BusFaultKind.RESTART, BusFaultKind.STUCK_COUNTER, BusFaultKind.SKIPPING_COUNTER}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusFault(Scheduled):
    """One fault of the bus or of a sender.

    It strikes the frames of one ``message`` of the wire contract, or of all of them without a name; each with the
    probability ``share``. A restart concerns all messages of the named one's sender.
    """

    kind: BusFaultKind
    message: str = ""
    share: float = 1.0
    delay_s: float = ranged(0.0, 0.0, MAX_HOLD_S)
    jitter_s: float = ranged(0.0, 0.0, MAX_HOLD_S)  # added to the delay, uniform from zero
    skip: int = 0

    def __post_init__(self) -> None:
        Scheduled.__post_init__(self)
        if not 0.0 < self.share <= 1.0:
            raise EmulatorConfigError(f"share must be above 0, up to 1, got {self.share}")
        if self.kind in _WHOLE and self.share != 1.0:
            raise EmulatorConfigError(f"a fault of kind {self.kind} strikes all frames: no share")
        if (self.kind is BusFaultKind.DELAY) != (self.delay_s + self.jitter_s > 0.0):
            raise EmulatorConfigError("delay_s or jitter_s belong to a fault of kind delay, which needs one of them")
        if (self.kind is BusFaultKind.SKIPPING_COUNTER) != (self.skip != 0) or not 0 <= self.skip < COUNTER_PERIOD:
            raise EmulatorConfigError(f"skip, 1..{COUNTER_PERIOD - 1}, belongs to a fault of kind skipping_counter")
        if self.kind is BusFaultKind.OVERLOAD and self.message:
            raise EmulatorConfigError("an overload concerns the whole bus: no message")


Fault = SensorFault | BusFault | Degradation
"""What can go wrong while a car drives."""
