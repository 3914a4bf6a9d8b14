"""Parameters of the plant beyond the clutch calibration: frozen, range-checked once, loaded from TOML."""

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from importlib.resources import files
from typing import Final, NamedTuple, Self

from clutch_model.calibration import overlaid
from clutch_model.errors import CalibrationError
from clutch_model.tables import record_from, require
from ecu_emulator.plant import driveline
from ecu_emulator.plant.clutch import HydraulicsParameters, LiningParameters
from ecu_emulator.plant.driveline import EngineParameters
from ecu_emulator.shift_control.tcu_data import MOST_GEARS, ControlParameters, WorkshopParameters

_MAY_BE_ZERO = frozenset(
    {
        "friction_nm",
        "friction_nms_rad",
        "ripple_ratio",
        "fade_per_k",
        "erratic_ratio",
        "open_drag_limit_nm",
        "damping_nms_rad",
        "clutch_damping_nms_rad",
        "gear_damping_nms_rad",
        "shaft_damping_nms_rad",
        "wheel_damping_nms_rad",
        "rolling_resistance_ratio",
        "drag_area_m2",
        "convection_w_k",
        "spark_reduction_ratio",
        "flare_gain_nms_rad",
        "slip_integral_gain_nm_rad",
    }
)
_UP_TO_ONE = frozenset(
    {
        "volumetric_efficiency_ratio",
        "efficiency_ratio",
        "driven_load_ratio",
        "driven_brake_ratio",
        "ripple_ratio",
        "preselect_fill_ratio",
        "prefill_ratio",
        "dump_ratio",
        "spark_reduction_ratio",
        "rev_pedal_ratio",
        "launch_pedal_ratio",
    }
)


LEAST_GEARS: Final = 6  # touch points are looked for in 5th and 6th gear


class GearboxParameters(NamedTuple):
    """Ratios of gears 1, 2, ..."""

    gear_ratios: tuple[float, ...]
    final_drive_ratios: tuple[float, ...]

    @property
    def input_output_ratios(self) -> tuple[float, ...]:
        """Speed of an input shaft over that of the first output shaft, in each gear."""
        pairs = zip(self.gear_ratios, self.final_drive_ratios, strict=True)
        return tuple(ratio * final / self.final_drive_ratios[0] for ratio, final in pairs)


class OpenDrags(NamedTuple):
    """Factors on the drag of each open pack, beside that of both."""

    first_ratio: float = 1.0
    second_ratio: float = 1.0


class SumpParameters(NamedTuple):
    """Lumped oil in the sump."""

    heat_capacity_j_k: float  # C_oil
    convection_w_k: float  # hA_oil


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParameters:
    """One vehicle type around its clutches; every member is in the form the kernels take.

    Raises
    ------
    CalibrationError
        On construction, naming the first number outside its range.
    """

    engine: EngineParameters
    hydraulics: HydraulicsParameters
    flywheel: driveline.FlywheelParameters
    shafts: tuple[driveline.ShaftParameters, driveline.ShaftParameters]
    gearbox: GearboxParameters
    synchroniser: driveline.SynchroniserParameters
    output: driveline.OutputParameters
    vehicle: driveline.VehicleParameters
    sump: SumpParameters
    lining: LiningParameters
    control: ControlParameters
    workshop: WorkshopParameters
    open_drags: OpenDrags = field(default_factory=OpenDrags)

    def __post_init__(self) -> None:
        for name, value in self._numbers():
            key = name.rpartition(".")[2]
            is_positive = value > 0.0 or (value == 0.0 and key in _MAY_BE_ZERO)
            require(math.isfinite(value), f"{name} must be finite, got {value}")
            require(is_positive, f"{name} must be > 0, got {value}")
            require(value <= 1.0 or key not in _UP_TO_ONE, f"{name} must be <= 1, got {value}")
        count = len(self.gearbox.gear_ratios)
        require(LEAST_GEARS <= count <= MOST_GEARS, f"gearbox.gear_ratios: {LEAST_GEARS} to {MOST_GEARS} numbers")
        for name, values, length in (
            ("gearbox.final_drive_ratios", self.gearbox.final_drive_ratios, count),
            ("control.upshift_speeds_rad_s", self.control.upshift_speeds_rad_s, count - 1),
            ("control.downshift_speeds_rad_s", self.control.downshift_speeds_rad_s, count - 1),
        ):
            require(len(values) == length, f"{name} must be a list of {length} numbers, got {list(values)}")
        require(self.engine.closed_throttle_rad < 0.5 * math.pi, "engine.closed_throttle_rad must be < pi/2")

    def _numbers(self) -> Iterator[tuple[str, float]]:
        for part in fields(self):
            member = getattr(self, part.name)
            for record in member if part.name == "shafts" else (member,):
                for key, value in record._asdict().items():
                    for single in value if isinstance(value, tuple) else (value,):
                        yield f"{part.name}.{key}", single

    @classmethod
    def from_mapping(cls, table: Mapping[str, object]) -> Self:
        """Build the parameters from nested tables; an unknown, missing or mistyped key is an error.

        Raises
        ------
        CalibrationError
            Naming the first offending key.
        """
        shafts = table.get("shaft")
        if not isinstance(shafts, list) or len(shafts) != 2:
            raise CalibrationError("plant needs exactly 2 [[shaft]] tables")
        both = tuple(
            record_from(driveline.ShaftParameters, shaft, f"shaft {number}.") for number, shaft in enumerate(shafts, 1)
        )
        return record_from(cls, {key: value for key, value in table.items() if key != "shaft"}, shafts=both)


def plant_table(transmission: str = "nominal") -> dict[str, object]:
    """Return the shipped plant parameters with a transmission as nested tables, for callers that override some keys."""
    table = _shipped("parameters")
    return table if transmission == "nominal" else overlaid(table, _shipped(transmission))


def _shipped(name: str) -> dict[str, object]:
    return tomllib.loads(files("ecu_emulator").joinpath(f"plant/{name}.toml").read_text(encoding="utf-8"))


def nominal_parameters(transmission: str = "nominal") -> PlantParameters:
    """Return the plant parameters that ship with the package, with a transmission."""
    return PlantParameters.from_mapping(plant_table(transmission))
