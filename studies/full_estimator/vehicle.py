"""What lies between differential and road, beyond the paper's driveline: losses, wheels, tyres, mass."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from typing import Self

from clutch_model.tables import record_from, require


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """One vehicle type from gears to road, docs/model.md eqs. (3b) and (3e) to (3i)."""

    efficiency_ratio: float  # eta of an engaged gear
    output_damping_nms_rad: float  # B_D
    mass_kg: float  # m
    wheel_inertia_kg_m2: float  # J_W, both driven wheels
    wheel_damping_nms_rad: float  # B_W
    tyre_stiffness_n: float  # C_kappa
    tyre_grip_n: float  # mu_t*F_z

    def __post_init__(self) -> None:
        for member in fields(self):
            value = getattr(self, member.name)
            require(0.0 < value < math.inf, f"{member.name} must be > 0 and finite, got {value}")
        require(self.efficiency_ratio <= 1.0, f"efficiency_ratio must be <= 1, got {self.efficiency_ratio}")

    @classmethod
    def from_mapping(cls, table: Mapping[str, object]) -> Self:
        """Build a vehicle from a table.

        Raises
        ------
        CalibrationError
            Naming an unknown, missing or mistyped key, a number that is not positive or an efficiency above 1.
        """
        return record_from(cls, table, "vehicle.")


def nominal_vehicle() -> Vehicle:
    """Return the vehicle that ships with the service."""
    text = files("studies").joinpath("full_estimator/vehicle.toml").read_text(encoding="utf-8")
    return Vehicle.from_mapping(tomllib.loads(text))
