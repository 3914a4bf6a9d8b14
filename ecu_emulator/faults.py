"""Faults that a scenario scripts: when each begins and what it does. Records that check their own ranges."""

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Final

from ecu_emulator.errors import ConfigError
from ecu_emulator.signals import NOMINAL_SENSORS

MAX_SHIFT: Final = 1_000_000


class Phase(StrEnum):
    """Phases of a shift, by which a fault can be timed."""

    PREFILL = "prefill"
    TORQUE = "torque"
    INERTIA = "inertia"
    LOCK_UP = "lock_up"


class PhaseCode(IntEnum):
    """The same phases, and none, as the shift control numbers them on the bus."""

    HOLD = 0
    PREFILL = 1
    TORQUE = 2
    INERTIA = 3
    LOCK_UP = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheduled:
    """Something that begins at a time of the drive, or of one of its shifts, and ends a while later.

    ``start_s`` counts from the beginning of the drive; if ``shift`` names one (1, 2, ...), from the beginning of a
    phase of that shift, by default of the shift itself.
    """

    start_s: float = 0.0
    shift: int = 0
    phase: Phase = Phase.PREFILL
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        """Check that it can happen."""
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0):
            raise ConfigError(f"start_s must be >= 0, got {self.start_s}")
        if not 0 <= self.shift <= MAX_SHIFT:
            raise ConfigError(f"shift must be 1..{MAX_SHIFT}, or 0 for none, got {self.shift}")
        if not self.duration_s > 0.0:
            raise ConfigError(f"duration_s must be > 0, got {self.duration_s}")


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
            raise ConfigError(f"quantity {self.quantity!r} has no sensor; known: {', '.join(sorted(NOMINAL_SENSORS))}")
        if not math.isfinite(self.size) or (self.kind in _SIZED) != (self.size != 0.0):
            needed = "a finite size other than 0" if self.kind in _SIZED else "no size"
            raise ConfigError(f"a fault of kind {self.kind} needs {needed}, got {self.size}")
