"""What the paper's method must know of the driveline beyond the calibration: inertias, compliances, ratios."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from typing import Self

from clutch_model.errors import CalibrationError
from clutch_model.tables import record_from, require

SixNumbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Positive:
    """A record whose numbers are all finite and above zero."""

    def __post_init__(self) -> None:
        for member in fields(self):
            value = getattr(self, member.name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float | int):
                    require(0.0 < number < math.inf, f"{member.name} must be > 0 and finite, got {number}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance(Positive):
    """A sprung and damped shaft."""

    stiffness_nm_rad: float
    damping_nms_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaft(Positive):
    """One input shaft: its clutch's gearbox side, its compliance, its gears."""

    clutch_inertia_kg_m2: float  # J_L
    clutch_damping_nms_rad: float  # B_L
    gear_inertia_kg_m2: float  # J_G
    gear_damping_nms_rad: float  # B_G
    stiffness_nm_rad: float  # k_si
    damping_nms_rad: float  # c_si


@dataclass(frozen=True, slots=True, kw_only=True)
class Gearbox(Positive):
    """Ratios of gears 1..6."""

    gear_ratios: SixNumbers
    final_drive_ratios: SixNumbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Output(Positive):
    """Differential and half shafts."""

    inertia_kg_m2: float  # J_D
    stiffness_nm_rad: float  # k_OS
    damping_nms_rad: float  # c_OS


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel(Positive):
    """The driven wheels."""

    radius_m: float  # R_w


@dataclass(frozen=True, slots=True, kw_only=True)
class Driveline:
    """One vehicle type from flywheel to wheels."""

    flywheel: Compliance
    shafts: tuple[Shaft, Shaft]
    gearbox: Gearbox
    output: Output
    wheel: Wheel

    @property
    def overall_ratios(self) -> tuple[float, ...]:
        """i(g) of gears 1..6."""
        pairs = zip(self.gearbox.gear_ratios, self.gearbox.final_drive_ratios, strict=True)
        return tuple(ratio * final for ratio, final in pairs)

    @classmethod
    def from_mapping(cls, table: Mapping[str, object]) -> Self:
        """Build a driveline from nested tables.

        Raises
        ------
        CalibrationError
            Naming an unknown, missing or mistyped key or a number that is not positive.
        """
        shafts = table.get("shaft")
        if not isinstance(shafts, list) or len(shafts) != 2:
            raise CalibrationError("driveline needs exactly 2 [[shaft]] tables")
        both = tuple(record_from(Shaft, one, f"shaft {m}.") for m, one in enumerate(shafts, 1))
        return record_from(cls, {key: value for key, value in table.items() if key != "shaft"}, shafts=both)


def nominal_driveline() -> Driveline:
    """Return the driveline that ships with the service."""
    text = files("diag_service").joinpath("diagnosis/friction/paper/driveline.toml").read_text(encoding="utf-8")
    return Driveline.from_mapping(tomllib.loads(text))
