"""Calibrations: frozen parameter records, range-checked once, loaded from TOML.

A calibration holds its clutches (lining, geometry, piston, film, heat), its fluid, its input side, and how well all of
that is known. Symbols in the comments are those of ``docs/model.md``. Clutch 1 carries the odd gears, clutch 2 the even
ones.
"""

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from enum import StrEnum
from functools import lru_cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt
import tomli_w

from clutch_model.errors import CalibrationError
from clutch_model.tables import read_table, record_from, require

Gear = TypeVar("Gear", int, npt.NDArray[np.int64], npt.NDArray[np.float64])
T = TypeVar("T")


def clutch_of_gear(gear: Gear) -> Gear:
    """Return the clutch that carries a gear: 1 the odd ones, 2 the even ones; a number, or an array of them.

    Neutral (0) counts as even: something has to be said of it, and nothing that matters depends on it.
    """
    return 1 + (gear - 1) % 2


def both_clutches(values: Iterable[T]) -> tuple[T, T]:
    """Return what clutch 1 and what clutch 2 has; raises ValueError unless there are two."""
    first, second = values
    return first, second


def with_clutch(both: tuple[T, T], clutch: int, value: T) -> tuple[T, T]:
    """Return what both clutches have, with another value for clutch 1 or 2."""
    return (value, both[1]) if clutch == 1 else (both[0], value)


Pair = tuple[float, float]  # clutch 1 first


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranged:
    """A record whose every number is finite and, unless a subclass says otherwise, not negative."""

    ABOVE_ZERO: ClassVar[tuple[str, ...]] = ()  # names of those that are not zero either
    BOUNDS: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})  # of those that have others

    def __post_init__(self) -> None:
        names: tuple[str, ...] = self.__slots__  # its own fields only: no such record is derived from another
        for name in names:
            value = getattr(self, name)
            if type(value) is float and 0.0 <= value < math.inf:  # as nearly all are
                continue
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, int | float) and not (math.isfinite(number) and number >= 0.0):
                    raise CalibrationError(f"{name} must be finite and >= 0, got {number}")
        for name in self.ABOVE_ZERO:
            value = getattr(self, name)
            if not (min(value) if isinstance(value, tuple) else value) > 0.0:
                raise CalibrationError(f"{name} must be > 0")
        for name, (least, most) in self.BOUNDS.items():
            if not least <= (value := getattr(self, name)) <= most:
                raise CalibrationError(f"{name} must be {least:g}..{most:g}, got {value}")


ENGINE_FRICTION_NMS_RAD: Final = 0.1  # Cho and Hedrick 1989: .1056 of a V6
MODELLED_GAIN_RATIO: Final = 0.5  # a profile's scale may be off by half
MODELLED_OFFSET_NM: Final = 60.0  # friction and pumping of the engine
MODELLED_LATENCY_S: Final = 0.05  # an engine turns once or twice until the fuel is torque
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

    ABOVE_ZERO = ("pressure_pa",)

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


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionCurve(Ranged):
    """Stribeck curve of one clutch, eq. (8)."""

    ABOVE_ZERO = ("stribeck_speed_rad_s", "stribeck_exponent")
    BOUNDS = MappingProxyType(dict.fromkeys(("mu_c", "mu_s"), (0.02, 0.5)))  # of lubricated friction linings

    mu_c: float  # Coulomb coefficient, reached at high slip
    mu_s: float  # static coefficient, reached at zero slip
    stribeck_speed_rad_s: float  # w_S
    stribeck_exponent: float  # lambda_S
    lock_band_rad_s: float  # w_rel


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchGeometry(Ranged):
    """Fixed geometry of one clutch pack."""

    ABOVE_ZERO = ("piston_area_m2",)

    outer_radius_m: float  # Ro
    inner_radius_m: float  # Ri
    interface_count: int  # Np
    piston_area_m2: float  # A_K

    def __post_init__(self) -> None:
        """Check that the ring exists and the piston pushes."""
        Ranged.__post_init__(self)
        if not 0.0 < self.inner_radius_m < self.outer_radius_m:
            raise CalibrationError("inner_radius_m must lie between 0 and outer_radius_m")
        if not self.interface_count >= 1:
            raise CalibrationError("interface_count must be >= 1")

    @property
    def faces(self) -> "Faces":
        """What the rings of its friction faces amount to."""
        return faces(self.outer_radius_m, self.inner_radius_m, self.interface_count)


class Faces(NamedTuple):
    """Factors of the friction faces of one pack."""

    lining_area_m2: float  # A_lining, of one face
    contact_factor_m3: float  # C of eq. (6): torque per friction coefficient and contact pressure
    viscous_factor_m4: float  # Vg of eq. (5): torque per shear rate and viscosity
    squeeze_factor_m2: float  # Q of eq. (7), of the annular squeeze film


@lru_cache(maxsize=64)
def faces(outer_radius_m: float, inner_radius_m: float, interface_count: int) -> Faces:
    """Return the factors of rings, which a vehicle has the same for ever."""
    outer2, inner2 = outer_radius_m**2, inner_radius_m**2
    return Faces(
        lining_area_m2=math.pi * (outer_radius_m**2 - inner_radius_m**2),
        contact_factor_m3=interface_count * 2.0 * math.pi / 3.0 * (outer_radius_m**3 - inner_radius_m**3),
        viscous_factor_m4=interface_count * math.pi / 2.0 * (outer_radius_m**4 - inner_radius_m**4),
        squeeze_factor_m2=1.5 * ((outer2 + inner2) - (outer2 - inner2) / math.log(outer_radius_m / inner_radius_m)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Piston(Ranged):
    """Return spring and stroke of one clutch piston."""

    spring_preload_n: float  # F_pre
    spring_rate_n_m: float  # K_K
    fill_stroke_m: float  # x_fill

    @property
    def closed_spring_force_n(self) -> float:
        """Spring force with the pack closed [N], F_s."""
        return self.spring_preload_n + self.spring_rate_n_m * self.fill_stroke_m


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSurface(Ranged):
    """Rough, permeable lining surface and the oil film on it, eq. (7)."""

    ABOVE_ZERO = (
        "roughness_m",
        "contact_stiffness_pa",
        "permeability_m2",
        "open_gap_m",
        "separation_time_s",
        "mobility_ratio",
    )

    roughness_m: float  # sigma, combined rms roughness
    contact_stiffness_pa: float  # K_c = K'E'
    permeability_m2: float  # Phi
    lining_thickness_m: float  # d
    slip_coefficient: float  # a_BJ, Beavers-Joseph
    open_gap_m: float  # h0
    separation_time_s: float  # tau_sep
    separation_pressure_pa: float  # p_sep
    min_film_m: float  # h_min
    mobility_ratio: float = 1.0  # of the film's rate to what the rest says


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchThermal(Ranged):
    """Lumped thermal mass of one clutch pack."""

    ABOVE_ZERO = ("heat_capacity_j_k", "convection_w_k")

    heat_capacity_j_k: float  # C_th
    convection_w_k: float  # hA


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchCalibration:
    """Everything about one clutch that plant and estimator both use."""

    friction: FrictionCurve
    geometry: ClutchGeometry
    piston: Piston
    film: FilmSurface
    thermal: ClutchThermal

    @property
    def touch_pressure_pa(self) -> float:
        """Piston pressure at which the pack just closes [Pa], F_s / A_K."""
        return self.piston.closed_spring_force_n / self.geometry.piston_area_m2


@dataclass(frozen=True, slots=True, kw_only=True)
class Converter(Ranged):
    """A torque converter by its characteristic over the speed ratio, turbine over engine; its lock-up is clutch 1."""

    ABOVE_ZERO = ("capacity_ratio",)

    speed_ratios: tuple[float, ...]  # rising from 0 to 1
    capacities_nm_s2: tuple[float, ...]  # torque of the impeller over the square of its speed [N m s2/rad2], there
    torque_ratios: tuple[float, ...]  # turbine over impeller, there
    impeller_inertia_kg_m2: float
    turbine_inertia_kg_m2: float
    capacity_ratio: float  # one standard deviation of production scatter of the capacities

    def __post_init__(self) -> None:
        """Check that it is a curve from stall to coupling."""
        Ranged.__post_init__(self)
        sizes = {len(self.speed_ratios), len(self.capacities_nm_s2), len(self.torque_ratios)}
        require(len(sizes) == 1, "a converter needs as many capacities and torque ratios as speed ratios")
        rises = all(low < high for low, high in pairwise(self.speed_ratios))
        ends = (self.speed_ratios[0], self.speed_ratios[-1]) if self.speed_ratios else ()
        require(rises and ends == (0.0, 1.0), "speed_ratios must rise from 0 to 1")


CLUTCH_COUNT: Final = 2
ELEMENTS: Final = ("clutch 1", "clutch 2")
_TEXTS: Final = ("name", "version")  # a number will do
_ELSEWHERE: Final = ("clutch", "transmission")  # read above; of older files, whose elements name the clutches


@dataclass(frozen=True, slots=True, kw_only=True)
class Viscosity(Ranged):
    """Vogel law ``nu = a * exp(b / (T - T0))`` of the transmission fluid: it falls as the oil becomes warmer."""

    ABOVE_ZERO = ("a_pa_s", "b_k", "pole_k")
    BOUNDS = MappingProxyType({"pole_k": (0.0, 233.0)})  # below any oil temperature

    a_pa_s: float
    b_k: float
    pole_k: float  # T0 = 273.15 K - c


@dataclass(frozen=True, slots=True, kw_only=True)
class InputSide(Ranged):
    """Engine side of the clutches: what the torque impulse balance needs."""

    ABOVE_ZERO = ("engine_inertia_kg_m2", "hub_inertia_kg_m2", "input_shaft_inertias_kg_m2")

    engine_inertia_kg_m2: float  # J_E, engine and primary flywheel
    hub_inertia_kg_m2: float  # J_H
    hub_damping_nms_rad: float  # B_H
    crank_segment_rad: float  # engine speed is broadcast as the mean over this crank angle
    input_shaft_inertias_kg_m2: Pair  # J_L + J_G of each input shaft in neutral
    input_shaft_dampings_nms_rad: Pair  # B_L + B_G


class TorqueSource(StrEnum):
    """Where the engine's torque comes from."""

    MEASURED = "measured"  # the engine's controller states it
    MODELLED = "modelled"  # from injected fuel or pressure in the manifold, up to a gain and an offset
    WITHOUT_CUT = "without_cut"  # likewise, but what takes it away for a shift, such as late sparks, is not in it
    UNKNOWN = "unknown"

    @property
    def is_modelled(self) -> bool:
        return self in {TorqueSource.MODELLED, TorqueSource.WITHOUT_CUT}


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
    torque: TorqueSource = TorqueSource.MEASURED
    converter: Converter | None = None  # its lock-up clutch is clutch 1, and there is no other
    elements: tuple[str, ...] = ELEMENTS  # names of the clutches

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> Self:
        """Build a calibration from nested tables; an unknown, missing or mistyped key is an error.

        Raises
        ------
        CalibrationError
            Naming the first offending key.
        """
        table = completed(table)
        made_on, vehicle, clutches = table.get("made_on"), table.get("vehicle"), table.get("clutch")
        require(made_on is None or type(made_on) is date, f"made_on must be a day (2026-01-31), got {made_on!r}")
        is_name = isinstance(vehicle, str) and vehicle.isprintable() and vehicle != ""
        require(vehicle is None or is_name, f"vehicle must be a text that can be printed, got {vehicle!r}")
        if isinstance(clutches, list) and len(clutches) == 1 and "converter" in table:
            clutches = clutches * CLUTCH_COUNT  # nobody asks for the second
        if not isinstance(clutches, list) or len(clutches) != CLUTCH_COUNT:
            raise CalibrationError(f"calibration needs exactly {CLUTCH_COUNT} [[clutch]] tables")
        both = tuple(record_from(ClutchCalibration, clutch, f"clutch {m} ") for m, clutch in enumerate(clutches, 1))
        rest = {key: str(value) if key in _TEXTS else value for key, value in table.items() if key not in _ELSEWHERE}
        if named := table.get("transmission", {}).get("elements"):
            count = 1 if "converter" in table else CLUTCH_COUNT
            rest["elements"] = [str(element.get("name")) for element in named[:count]]
        return record_from(cls, rest, clutches=both)

    def with_torque(self, source: TorqueSource) -> Self:
        """Return what is believed of a vehicle with this torque.

        Of a modelled one neither gain nor offset is known; what the engine loses with its speed no fuel tells.
        """
        if not source.is_modelled:
            return replace(self, torque=source)
        scatter = replace(
            self.uncertainty,
            torque_gain_ratio=MODELLED_GAIN_RATIO,
            torque_offset_nm=MODELLED_OFFSET_NM,
            torque_latency_s=MODELLED_LATENCY_S,
            motoring_gain_ratio=0.0,
        )
        bias = replace(self.bias, torque_gain=1.0, motoring_gain=1.0, torque_offset_nm=0.0, torque_latency_s=0.0)
        damping_nms_rad = self.input_side.hub_damping_nms_rad + ENGINE_FRICTION_NMS_RAD
        side = replace(self.input_side, hub_damping_nms_rad=damping_nms_rad)
        return replace(self, torque=source, uncertainty=scatter, bias=bias, input_side=side, joint=None)


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file, or a shipped calibration that is named.

    Raises
    ------
    CalibrationError
        If the file is missing, not TOML, or holds a value outside its range.
    """
    table = calibration_table(path)
    try:
        return believed_calibration(table)
    except CalibrationError as exc:
        raise CalibrationError(f"{path}: {exc}") from exc


def believed_calibration(table: Mapping[str, Any]) -> Calibration:
    """Return the calibration that friction is held against: that of new fluid; raises CalibrationError."""
    calibration = Calibration.from_mapping(table)
    for number, clutch in enumerate(calibration.clutches, 1):
        message = f"clutch {number} friction.mu_s must be below mu_c: these are of new fluid, which does not shudder"
        require(clutch.friction.mu_s < clutch.friction.mu_c, message)
    return calibration


def calibration_toml(calibration: Calibration) -> str:
    """Return a calibration as the text of a file that `read_calibration` reads back to the same numbers."""
    table = asdict(calibration)
    table["clutch"] = table.pop("clutches")
    if calibration.torque is TorqueSource.MEASURED:
        del table["torque"]
    if calibration.elements == ELEMENTS:
        del table["elements"]
    return tomli_w.dumps({key: value for key, value in table.items() if value is not None})


SHIPPED: Final = ("nominal", "gs7", "lockup")  # types of transmissions that can be driven and diagnosed
CONVERTERS: Final = frozenset({"lockup"})  # of them, with a torque converter


def shipped_table(name: str = "nominal") -> dict[str, Any]:
    """Return a shipped calibration as nested tables, for callers that override some keys."""
    require(name in SHIPPED, f"no transmission {name!r}; known: {', '.join(SHIPPED)}")
    text = files("clutch_model").joinpath(f"calibrations/{name}.toml").read_text(encoding="utf-8")
    return completed(tomllib.loads(text))


def completed(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with all that it does not tell as the shipped one has it that it is ``like``, if any."""
    overlay = dict(table)
    like = overlay.pop("like", None)
    whole: dict[str, Any] = overlay if like is None else overlaid(shipped_table(str(like)), overlay)
    return whole


def overlaid(base: Any, overlay: Any) -> Any:  # noqa: ANN401 - parsed TOML
    """Return nested tables with others laid over them; of a list as long the first over the first, and so on."""
    if isinstance(base, Mapping) and isinstance(overlay, Mapping):
        return {**base, **{key: overlaid(base.get(key), value) for key, value in overlay.items()}}
    if isinstance(base, list) and isinstance(overlay, list) and len(base) == len(overlay):
        return list(map(overlaid, base, overlay))
    return overlay


def calibration_table(path: Path) -> dict[str, Any]:
    """Return the tables of a calibration file, or of a shipped calibration that is named; raises CalibrationError."""
    name = str(path)
    return shipped_table(name) if name in SHIPPED and not path.exists() else read_table(path, "calibration")


def shipped_calibration(name: str) -> Calibration:
    """Return the calibration of a type of transmission that ships with the package."""
    return Calibration.from_mapping(shipped_table(name))


def nominal_calibration() -> Calibration:
    """Return the calibration of the six-speed transmission, which is believed where none is named."""
    return shipped_calibration("nominal")
