"""A short fingerprint of every number of a calibration, so that an edited copy is not taken for it.

Running states, keys of results and rows of fleets carry fingerprints, so an unchanged calibration must keep its own
for ever: a vehicle whose fingerprint changes loses its baseline. The text that is digested is therefore made of the
keys of the calibration *file* and of exact numbers, in an order that is written down here and nowhere else, with words
that are part of the form. Nothing of it follows from how the program's records are called, ordered or printed. A key
that files get later comes behind the others of its table, and only where it is not at its default: what a program
learns to be told must not take the baseline from vehicles of which nobody says it.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import StrEnum
from operator import attrgetter
from typing import Any, Final

from clutch_model.calibration import Calibration

_LENGTH: Final = 12
_FRICTION: Final = ("mu_c", "mu_s", "stribeck_speed_rad_s", "stribeck_exponent", "lock_band_rad_s")
_GEOMETRY: Final = ("outer_radius_m", "inner_radius_m", "interface_count", "piston_area_m2")
_PISTON: Final = ("spring_preload_n", "spring_rate_n_m", "fill_stroke_m")
_FILM: Final = (
    *("roughness_m", "contact_stiffness_pa", "permeability_m2", "lining_thickness_m", "slip_coefficient"),
    *("open_gap_m", "separation_time_s", "separation_pressure_pa", "min_film_m"),
)
_INPUT_SIDE: Final = (
    *("engine_inertia_kg_m2", "hub_inertia_kg_m2", "hub_damping_nms_rad", "crank_segment_rad"),
    *("input_shaft_inertias_kg_m2", "input_shaft_dampings_nms_rad"),
)
_UNCERTAINTY: Final = (
    *("torque_gain_ratio", "engine_inertia_ratio", "input_shaft_inertia_ratio", "piston_area_ratio"),
    *("viscosity_ratio", "torque_latency_s", "pressure_latency_s", "torque_offset_nm", "touch_pressure_pa"),
    *("pressure_zero_pa", "motoring_gain_ratio", "stribeck_speed_ratio", "contact_stiffness_ratio"),
)
_NOISE: Final = ("engine_speed_rad_s", "hub_speed_rad_s", "input_speed_rad_s", "engine_torque_nm", "pressure_pa")
_BIAS: Final = (
    *("torque_gain", "motoring_gain", "torque_offset_nm", "torque_latency_s", "pressure_latency_s"),
    *("touch_offsets_pa", "pressure_zeros_pa"),
)
_WHOLE: Final = ("name", "version", "clutches", "viscosity", "input_side", "uncertainty", "noise", "bias", "joint")
# Of each table of a file, ``clutches`` for [[clutch]]: the word of the form for it, its keys in the order of the form.
_FORM: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "calibration": ("Calibration", _WHOLE),
    "clutches": ("ClutchCalibration", ("friction", "geometry", "piston", "film", "thermal")),
    "friction": ("FrictionCurve", _FRICTION),
    "geometry": ("ClutchGeometry", _GEOMETRY),
    "piston": ("Piston", _PISTON),
    "film": ("FilmSurface", _FILM),
    "thermal": ("ClutchThermal", ("heat_capacity_j_k", "convection_w_k")),
    "viscosity": ("Viscosity", ("a_pa_s", "b_k", "pole_k")),
    "input_side": ("InputSide", _INPUT_SIDE),
    "uncertainty": ("Uncertainty", _UNCERTAINTY),
    "noise": ("SensorNoise", _NOISE),
    "bias": ("SensorBias", _BIAS),
    "joint": ("JointUncertainty", ("names", "std", "correlation")),
}
_NO_NUMBERS: Final = frozenset({"made_on", "vehicle"})  # whose it is and since when changes no result


def fingerprint(calibration: Calibration) -> str:
    """Return the fingerprint of a calibration: twelve hexadecimal digits."""
    return hashlib.sha256(canonical_text(calibration).encode()).hexdigest()[:_LENGTH]


def canonical_text(calibration: Calibration) -> str:
    """Return the form of a calibration that is digested."""
    return _table(calibration, "calibration")


def _table(record: Any, name: str) -> str:  # noqa: ANN401 - a record of any kind
    word, keys = _FORM.get(name, (name, ()))
    return f"{word}({', '.join((*_known(record, keys), *_later(record, keys)))})"


def _known(record: object, keys: tuple[str, ...]) -> Iterator[str]:
    for key in keys:
        yield f"{key}={_value(getattr(record, key), key)}"


def _later(record: Any, keys: tuple[str, ...]) -> Iterator[str]:  # noqa: ANN401 - a record of any kind
    others = (member for member in fields(record) if member.name not in _NO_NUMBERS.union(keys))
    for member in sorted(others, key=attrgetter("name")):
        value = getattr(record, member.name)
        if value != _default(member):
            yield f"{member.name}={_value(value, member.name)}"


def _default(member: Field[Any]) -> object:
    return member.default if member.default_factory is MISSING else member.default_factory()


def _value(value: object, key: str) -> str:
    if is_dataclass(value):
        return _table(value, key)
    if isinstance(value, list | tuple):
        parts = [_value(part, key) for part in value]
        return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
    if isinstance(value, float):
        return float.__repr__(value)
    return repr(value.value if isinstance(value, StrEnum) else value)  # None for what the file does not state
