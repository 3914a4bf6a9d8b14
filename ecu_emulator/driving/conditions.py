"""Under which conditions a car is driven, and which car."""

import math
from dataclasses import dataclass, field

from clutch_model.calibration import Calibration, nominal_calibration
from ecu_emulator.driving.parameters import DrivingParameters, nominal_driving
from ecu_emulator.errors import ConfigError
from ecu_emulator.plant.drive import FrictionFactors
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters

_MS_PER_S = 1000
_MAX_STEP_S = 2.5e-4
_RANGES = {
    "oil_k": (258.15, 403.15),
    "clutch1_k": (258.15, 503.15),
    "clutch2_k": (258.15, 503.15),
    "coolant_k": (243.15, 393.15),
    "ambient_k": (233.15, 328.15),
    "mass_kg": (900.0, 3500.0),
    "dt_s": (1.0e-6, _MAX_STEP_S),
    "whim_ratio": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveConditions:
    """Temperatures and load as the drive begins, and how the driver behaves.

    Raises
    ------
    ConfigError
        On construction, naming the first number outside its range.
    """

    oil_k: float = 363.15
    coolant_k: float = 358.15
    ambient_k: float = 298.15
    clutch1_k: float | None = None  # None: as warm as the oil
    clutch2_k: float | None = None
    mass_kg: float | None = None  # None: that of the type
    friction_factors: FrictionFactors = field(default_factory=FrictionFactors)
    whim_ratio: float = 0.1  # share of the events in which the driver's foot moves without need
    dt_s: float = 2.5e-4  # a whole fraction of a millisecond

    def __post_init__(self) -> None:
        """Check every number against its range."""
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and low <= value <= high):
                raise ConfigError(f"{name} must be {low:g}..{high:g}, got {value}")
        steps = 1.0 / (_MS_PER_S * self.dt_s)
        if abs(steps - round(steps)) > 1.0e-6 * steps:
            raise ConfigError(f"dt_s must divide 1 ms, got {self.dt_s}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Car:
    """One car: its true clutches, what is around them, how it is controlled."""

    truth: Calibration = field(default_factory=nominal_calibration)
    parameters: PlantParameters = field(default_factory=nominal_parameters)
    driving: DrivingParameters = field(default_factory=nominal_driving)
    touch_pressures_pa: tuple[float, float] | None = None  # that the control believes in; None: the true ones
