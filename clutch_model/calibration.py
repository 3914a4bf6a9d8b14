"""Calibrations: frozen parameter records, range-checked once, loaded from TOML.

Symbols in the comments are those of ``docs/model.md``. Clutch 1 carries the odd gears, clutch 2 the even ones.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Self

import tomli_w

from clutch_model.clutch import ClutchCalibration
from clutch_model.errors import CalibrationError
from clutch_model.knowledge import JointUncertainty, SensorBias, SensorNoise, Uncertainty
from clutch_model.tables import Pair, Ranged, read_table, record_from, require

CLUTCH_COUNT: Final = 2
_TEXTS: Final = ("name", "version")  # a number will do


@dataclass(frozen=True, slots=True, kw_only=True)
class Viscosity:
    """Vogel law ``nu = a * exp(b / (T - T0))`` of the transmission fluid."""

    a_pa_s: float
    b_k: float
    pole_k: float  # T0 = 273.15 K - c

    def __post_init__(self) -> None:
        """Check that the law is a decreasing viscosity."""
        require(self.a_pa_s > 0.0 and self.b_k > 0.0, "a_pa_s and b_k must be > 0")
        require(0.0 < self.pole_k < 233.15, "pole_k must be 0..233.15 K (below any oil temperature)")


@dataclass(frozen=True, slots=True, kw_only=True)
class InputSide(Ranged):
    """Engine side of the clutches: what the torque impulse balance needs."""

    engine_inertia_kg_m2: float  # J_E, engine and primary flywheel
    hub_inertia_kg_m2: float  # J_H
    hub_damping_nms_rad: float  # B_H
    crank_segment_rad: float  # engine speed is broadcast as the mean over this crank angle
    input_shaft_inertias_kg_m2: Pair  # J_L + J_G of each input shaft in neutral
    input_shaft_dampings_nms_rad: Pair  # B_L + B_G

    def __post_init__(self) -> None:
        """Check that the engine has an inertia."""
        Ranged.__post_init__(self)
        require(self.engine_inertia_kg_m2 > 0.0, "engine_inertia_kg_m2 must be > 0")
        require(self.hub_inertia_kg_m2 > 0.0, "hub_inertia_kg_m2 must be > 0")
        require(min(self.input_shaft_inertias_kg_m2) > 0.0, "input_shaft_inertias_kg_m2 must be > 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """One vehicle type, as believed by the service or as true in the emulator; or one vehicle, self-calibrated."""

    name: str
    version: str
    clutches: tuple[ClutchCalibration, ClutchCalibration]
    viscosity: Viscosity
    input_side: InputSide
    uncertainty: Uncertainty
    noise: SensorNoise
    made_on: date | None = field(default=None, repr=False)  # when it was made for one vehicle; no number of the model
    bias: SensorBias = field(default_factory=SensorBias)
    joint: JointUncertainty | None = None
    vehicle: str | None = field(default=None, repr=False)  # whose it is; None: of every vehicle of the type

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> Self:
        """Build a calibration from nested tables; an unknown, missing or mistyped key is an error.

        Raises
        ------
        CalibrationError
            Naming the first offending key.
        """
        made_on, vehicle, clutches = table.get("made_on"), table.get("vehicle"), table.get("clutch")
        require(made_on is None or type(made_on) is date, f"made_on must be a day (2026-01-31), got {made_on!r}")
        is_name = isinstance(vehicle, str) and vehicle.isprintable() and vehicle != ""
        require(vehicle is None or is_name, f"vehicle must be a text that can be printed, got {vehicle!r}")
        if not isinstance(clutches, list) or len(clutches) != CLUTCH_COUNT:
            raise CalibrationError(f"calibration needs exactly {CLUTCH_COUNT} [[clutch]] tables")
        both = tuple(record_from(ClutchCalibration, one, f"clutch {m} ") for m, one in enumerate(clutches, 1))
        rest = {key: str(value) if key in _TEXTS else value for key, value in table.items() if key != "clutch"}
        return record_from(cls, rest, clutches=both)


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    CalibrationError
        If the file is missing, not TOML, or holds a value outside its range.
    """
    table = read_table(path, "calibration")
    try:
        return Calibration.from_mapping(table)
    except CalibrationError as exc:
        raise CalibrationError(f"{path}: {exc}") from exc


def calibration_toml(calibration: Calibration) -> str:
    """Return a calibration as the text of a file that `read_calibration` reads back to the same numbers."""
    table = asdict(calibration)
    table["clutch"] = table.pop("clutches")
    return tomli_w.dumps({key: value for key, value in table.items() if value is not None})


def nominal_table() -> dict[str, Any]:
    """Return the shipped nominal calibration as nested tables, for callers that override some keys."""
    text = files("clutch_model").joinpath("calibrations/nominal.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def nominal_calibration() -> Calibration:
    """Return the calibration that ships with the package."""
    return Calibration.from_mapping(nominal_table())
