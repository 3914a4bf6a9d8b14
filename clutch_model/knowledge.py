"""What is known of a vehicle beyond its nominal numbers, and how well: biases, noise, uncertainty."""

import math
from dataclasses import dataclass

from clutch_model.errors import CalibrationError
from clutch_model.tables import Pair, Ranged, require

MAX_LATENCY_S = 0.2  # a reading that is later still is no measurement of a shift


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty(Ranged):
    """Standard deviations of the vehicles of one type, before any of them was driven."""

    torque_gain_ratio: float
    engine_inertia_ratio: float
    input_shaft_inertia_ratio: float  # both together
    piston_area_ratio: float
    viscosity_ratio: float
    torque_latency_s: float
    pressure_latency_s: float
    torque_offset_nm: float
    touch_pressure_pa: float
    pressure_zero_pa: float
    motoring_gain_ratio: float = 0.0  # of negative engine torque, on top of the gain of all torque
    stribeck_speed_ratio: float = 0.0  # of both clutches
    contact_stiffness_ratio: float = 0.0  # of both clutches
    film_mobility_log: float = 0.5  # natural logarithm of how much faster the films of both clutches are
    stribeck_exponent_log: float = 0.2  # natural logarithm, both clutches
    friction_temperature_1_k: float = 0.0005  # by how much friction changes per kelvin of the pack, both clutches
    open_drag_log: float = 0.7  # natural logarithm of what open packs drag, both clutches


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise(Ranged):
    """White noise of the readings, quantisation included, as the estimator assumes it."""

    engine_speed_rad_s: float
    hub_speed_rad_s: float
    input_speed_rad_s: float
    engine_torque_nm: float
    pressure_pa: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorBias:
    """Known errors of one vehicle: ``reading(t) = gain * quantity(t - latency) + offset``.

    Latencies count against the speeds: what delays all readings alike does no harm.
    """

    torque_gain: float = 1.0
    motoring_gain: float = 1.0  # of negative engine torque, on top of ``torque_gain``
    torque_offset_nm: float = 0.0
    torque_latency_s: float = 0.0
    pressure_latency_s: float = 0.0
    touch_offsets_pa: Pair = (0.0, 0.0)  # true touch pressures minus those of the springs
    pressure_zeros_pa: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check that the readings still mean something."""
        for name in self.__dataclass_fields__:
            values = getattr(self, name)
            if not all(map(math.isfinite, values if isinstance(values, tuple) else (values,))):
                raise CalibrationError(f"{name} must be finite")
        for name in ("torque_gain", "motoring_gain"):
            if not 0.5 <= (gain := getattr(self, name)) <= 2.0:
                raise CalibrationError(f"{name} must be 0.5..2, got {gain}")
        for name in ("torque_latency_s", "pressure_latency_s"):
            if abs(getattr(self, name)) > MAX_LATENCY_S:
                raise CalibrationError(f"{name} must be within {MAX_LATENCY_S} s")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointUncertainty:
    """What a self-calibration leaves uncertain, with correlations; in place of the single deviations.

    The names are those of the estimator's parameters, see ``docs/model.md``, section "Self-calibration".
    """

    names: tuple[str, ...]
    std: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        """Check that it is a correlation matrix."""
        count = len(self.names)
        require(len(set(self.names)) == count, "names must differ")
        require(len(self.std) == count and len(self.correlation) == count, f"joint needs {count} rows")
        require(all(math.isfinite(value) and value >= 0.0 for value in self.std), "std must be finite and >= 0")
        for row, values in enumerate(self.correlation):
            require(len(values) == count and values[row] == 1.0, "correlation must be square, ones on its diagonal")
            for column, value in enumerate(values):
                require(-1.0 <= value <= 1.0, f"correlation must be within 1, got {value}")
                require(value == self.correlation[column][row], "correlation must be symmetric")
