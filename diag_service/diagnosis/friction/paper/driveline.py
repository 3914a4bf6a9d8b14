"""What the paper's method must know of the driveline beyond the calibration: inertias, compliances, ratios."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from typing import Self, TypeVar

from clutch_model.errors import CalibrationError
from clutch_model.tables import check_keys, number, numbers, require, subtable

GEAR_COUNT = 6
RecordT = TypeVar("RecordT")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """A sprung and damped shaft."""

    stiffness_nm_rad: float
    damping_nms_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaft:
    """One input shaft: its clutch's gearbox side, its compliance, its gears."""

    clutch_inertia_kg_m2: float  # J_L
    clutch_damping_nms_rad: float  # B_L
    gear_inertia_kg_m2: float  # J_G
    gear_damping_nms_rad: float  # B_G
    stiffness_nm_rad: float  # k_si
    damping_nms_rad: float  # c_si


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Differential and half shafts."""

    inertia_kg_m2: float  # J_D
    stiffness_nm_rad: float  # k_OS
    damping_nms_rad: float  # c_OS


@dataclass(frozen=True, slots=True, kw_only=True)
class Driveline:
    """One vehicle type from flywheel to wheels."""

    flywheel: Compliance
    shafts: tuple[Shaft, Shaft]
    overall_ratios: tuple[float, ...]  # i(g) of gears 1..6
    output: Output
    wheel_radius_m: float  # R_w

    @classmethod
    def from_mapping(cls, table: Mapping[str, object]) -> Self:
        """Build a driveline from nested tables.

        Raises
        ------
        CalibrationError
            Naming an unknown, missing or mistyped key or a number that is not positive.
        """
        check_keys("driveline", table, {"flywheel", "shaft", "gearbox", "output", "wheel"})
        shafts = table["shaft"]
        if not isinstance(shafts, list) or len(shafts) != 2:
            raise CalibrationError("driveline needs exactly 2 [[shaft]] tables")
        gearbox, wheel = subtable(table["gearbox"], "gearbox"), subtable(table["wheel"], "wheel")
        check_keys("gearbox", gearbox, {"gear_ratios", "final_drive_ratios"})
        check_keys("wheel", wheel, {"radius_m"})
        ratios = numbers(gearbox["gear_ratios"], "gear_ratios", GEAR_COUNT)
        finals = numbers(gearbox["final_drive_ratios"], "final_drive_ratios", GEAR_COUNT)
        radius_m = number(wheel["radius_m"], "wheel.radius_m")
        require(radius_m > 0.0, f"wheel.radius_m must be > 0, got {radius_m}")
        return cls(
            flywheel=_record(Compliance, table["flywheel"], "flywheel"),
            shafts=(_record(Shaft, shafts[0], "shaft 1"), _record(Shaft, shafts[1], "shaft 2")),
            overall_ratios=tuple(ratio * final for ratio, final in zip(ratios, finals, strict=True)),
            output=_record(Output, table["output"], "output"),
            wheel_radius_m=radius_m,
        )


def nominal_driveline() -> Driveline:
    """Return the driveline that ships with the service."""
    text = files("diag_service").joinpath("diagnosis/friction/paper/driveline.toml").read_text(encoding="utf-8")
    return Driveline.from_mapping(tomllib.loads(text))


def _record(record: type[RecordT], entry: object, where: str) -> RecordT:
    table = subtable(entry, where)
    names = [field.name for field in fields(record)]  # type: ignore[arg-type]  # every record here is a dataclass
    check_keys(where, table, names)
    values = {name: number(table[name], f"{where}.{name}") for name in names}
    for name, value in values.items():
        require(value > 0.0, f"{where}.{name} must be > 0, got {value}")
    return record(**values)
