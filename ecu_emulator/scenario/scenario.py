"""Scenarios: everything that decides what one drive puts on the bus, as records that check their own ranges."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Final

from clutch_model.calibration import CONVERTERS, SHIPPED, nominal_calibration
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.faults import (
    NOMINAL_SENSORS,
    BusFault,
    CheckedRecord,
    Degradation,
    SensorFault,
    Sensors,
    ranged,
)

Overrides = Mapping[str, object]  # dotted key -> TOML value

_VEHICLE_ID: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")  # safe in a file name and in an MQTT topic
_MACHINED: Final = frozenset({"input_shaft_inertia_ratio"})
_LAST_SEED: Final = 2**63 - 1
MAX_CYCLES: Final = 100_000  # fifty days of shift cycles
MAX_REVS: Final = 20  # of the workshop routine, with open and with closed clutches each
_CASTINGS: Final = {"converter_capacity_ratio": 0.05, "converter_shape_ratio": 0.025}  # castings differ
_SCATTER_SHARE: Final = 0.5  # of the belief's standard deviations: a careful production


class FluidCondition(StrEnum):
    """How far the fluid has gone."""

    IDEAL = "ideal"
    CASE_1 = "case1"  # worn: level down, slope still positive
    CASE_2 = "case2"  # aged: slope negative, shudder
    AGEING = "ageing"  # drifts from ideal to case 2 while driving


@dataclass(frozen=True, slots=True, kw_only=True)
class Fluid(CheckedRecord):
    """Condition of the transmission fluid; with ``ageing`` it reaches case 2 after ``ageing_cycles`` cycles."""

    condition: FluidCondition = FluidCondition.IDEAL
    ageing_cycles: int = ranged(20, 1, MAX_CYCLES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver(CheckedRecord):
    """How the car is driven."""

    pedal_ratio: float = ranged(0.45, 0.25, 0.9)
    variation_ratio: float = ranged(0.05, 0.0, 0.1)  # relative, drawn anew for every cycle


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkshopRoutine(CheckedRecord):
    """Workshop routine before the cycles: revs in neutral, the car at rest.

    It is there if there are revs of either kind, or a tester asks for it: then that one says how many.
    """

    open_revs: int = ranged(0, 0, MAX_REVS)  # both clutches open
    closed_revs: int = ranged(0, 0, MAX_REVS)  # then both closed
    on_request: bool = False  # the car waits in neutral until a tester starts the routine (service 31)

    def __post_init__(self) -> None:
        """Check ranges, and that nobody else than the tester says how many revs there are."""
        CheckedRecord.__post_init__(self)
        if self.on_request and self.open_revs + self.closed_revs > 0:
            raise EmulatorConfigError("on request the tester says how many revs: leave out open_revs and closed_revs")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambient(CheckedRecord):
    """Temperatures around and inside the transmission when the drive begins."""

    temperature_k: float = ranged(293.15, 233.15, 323.15)
    oil_temperature_k: float = ranged(363.15, 253.15, 413.15)
    coolant_temperature_k: float = ranged(353.15, 253.15, 393.15)  # constant, it cools the oil


@dataclass(frozen=True, slots=True, kw_only=True)
class Startup(CheckedRecord):
    """How long after the start each controller sends only not-available codes."""

    ecm_s: float = ranged(0.1, 0.0, 60.0)
    tcu_s: float = ranged(0.2, 0.0, 60.0)
    abs_s: float = ranged(0.3, 0.0, 60.0)
    ic_s: float = ranged(0.5, 0.0, 60.0)

    def by_sender(self) -> dict[str, float]:
        """Return the times [s] by the sender's name in the wire contract."""
        return {member.name.removesuffix("_s").upper(): getattr(self, member.name) for member in fields(self)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionScatter(CheckedRecord):
    """Standard deviations of production scatter; the members mean what those of the belief's ``Uncertainty`` mean."""

    torque_gain_ratio: float = ranged(0.0, 0.0, 0.1)
    engine_inertia_ratio: float = ranged(0.0, 0.0, 0.1)
    input_shaft_inertia_ratio: float = ranged(0.0, 0.0, 0.1)
    piston_area_ratio: float = ranged(0.0, 0.0, 0.1)
    viscosity_ratio: float = ranged(0.0, 0.0, 0.2)
    torque_latency_s: float = ranged(0.0, 0.0, 0.02)
    pressure_latency_s: float = ranged(0.0, 0.0, 0.02)
    torque_offset_nm: float = ranged(0.0, 0.0, 20.0)
    touch_pressure_pa: float = ranged(0.0, 0.0, 2.0e4)
    pressure_zero_pa: float = ranged(0.0, 0.0, 2.0e4)
    converter_capacity_ratio: float = ranged(0.0, 0.0, 0.2)
    converter_shape_ratio: float = ranged(0.0, 0.0, 0.1)  # rise of the capacity from stall to coupling, to both sides


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects(CheckedRecord):
    """What is true of this vehicle and unknown to the service's model; by default nothing. Ratios multiply.

    docs/model.md, section "Effects the estimator does not model".
    """

    friction_fade_per_k: float = ranged(0.0, 0.0, 0.005)  # mu_C and mu_S lose this share per kelvin above 80 degC
    stribeck_speed_ratio: float = ranged(1.0, 0.3, 3.0)  # on w_S
    viscosity_ratio: float = ranged(1.0, 0.5, 1.5)  # thicker still, cold oil would hold up the preselection
    contact_stiffness_ratio: float = ranged(1.0, 0.3, 3.0)  # on K_c
    film_mobility_ratio: float = ranged(1.0, 0.25, 4.0)  # grooves let the film yield faster
    open_drag_ratio: float = ranged(1.0, 0.01, 4.0)  # on the drag of open packs
    open_drag_limit_nm: float = ranged(0.0, 0.0, 50.0)  # above 0 open packs obey the film law, up to this drag
    piston_area_ratio: float = ranged(1.0, 0.9, 1.1)  # on A_K
    spring_force_n: float = ranged(0.0, -100.0, 100.0)  # added to the return springs' force
    driveline_damping_ratio: float = ranged(1.0, 0.25, 4.0)  # on flywheel, input shafts and output shafts
    crank_ripple_ratio: float = ranged(0.0, 0.0, 1.0)  # amplitude of the firing torque, three per turn
    engine_speed_is_sampled: bool = False  # broadcast as it is at the instant, not as the mean of a crank segment
    motoring_torque_ratio: float = ranged(1.0, 0.5, 1.5)  # on negative torque as the engine controller reports it
    least_cycle_ms: int = ranged(0, 0, 100)  # no message is sent more often
    frame_loss_ratio: float = ranged(0.0, 0.0, 0.5)  # of all frames, at random

    def switched_on(self) -> dict[str, float]:
        """Return what differs from no effect, by name."""
        return {
            member.name: getattr(self, member.name)
            for member in fields(self)
            if getattr(self, member.name) != member.default
        }


def production_scatter() -> ProductionScatter:
    """Return the scatter of normal production: half of what the service's nominal calibration allows for.

    Machined parts are all alike unless a scenario scatters them.
    """
    believed = nominal_calibration().uncertainty
    scattered = {member.name for member in fields(ProductionScatter)} - _MACHINED - _CASTINGS.keys()
    return ProductionScatter(**{name: _SCATTER_SHARE * getattr(believed, name) for name in scattered}, **_CASTINGS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Dotted keys that make this vehicle differ from the nominal one, e.g. ``clutch1.friction.mu_c``."""

    calibration: Overrides = field(default_factory=dict)
    plant: Overrides = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario(CheckedRecord):
    """Everything that decides what one drive puts on the bus."""

    name: str
    description: str = ""
    vehicle: str = "dct-demo"
    transmission: str = "nominal"  # or another one that ships: clutch_model/calibrations
    seed: int = ranged(1, 0, _LAST_SEED)  # of everything that is drawn, unless one of the next two is given
    vehicle_seed: int | None = ranged(None, 0, _LAST_SEED)  # of what stays with the car: production scatter
    drive_seed: int | None = ranged(None, 0, _LAST_SEED)  # of what changes from drive to drive: driver, noise, losses
    drive: DriveName = DriveName.CYCLE
    cycles: int = ranged(1, 1, MAX_CYCLES)  # how often: shift cycles, public cycles, trips through the city, days
    endless: bool = False  # drive again and again instead
    odometer_m: float = ranged(12_345_000.0, 0.0, 4.0e9)
    fluid: Fluid = field(default_factory=Fluid)
    driver: Driver = field(default_factory=Driver)
    routine: WorkshopRoutine = field(default_factory=WorkshopRoutine)
    adapted: bool = True  # the controller knows its clutches' touch points as it starts; otherwise those of the type
    ambient: Ambient = field(default_factory=Ambient)
    startup: Startup = field(default_factory=Startup)
    scatter: ProductionScatter = field(default_factory=production_scatter)
    sensors: Sensors = field(default_factory=lambda: dict(NOMINAL_SENSORS))
    effects: Effects = field(default_factory=Effects)
    truth: Truth = field(default_factory=Truth)
    sensor_faults: tuple[SensorFault, ...] = ()
    bus_faults: tuple[BusFault, ...] = ()
    causes: tuple[Degradation, ...] = ()  # of what is wrong with the car

    def __post_init__(self) -> None:
        CheckedRecord.__post_init__(self)
        if not _VEHICLE_ID.fullmatch(self.vehicle):
            raise EmulatorConfigError(f"vehicle must be 1..64 letters, digits, '-' or '_', got {self.vehicle!r}")
        if self.transmission not in SHIPPED:
            raise EmulatorConfigError(f"transmission must be one of {', '.join(SHIPPED)}, got {self.transmission!r}")
        if self.transmission in CONVERTERS and not self.is_on_the_road:
            raise EmulatorConfigError("a car with a torque converter is driven on the road: its drive cannot be cycle")
        if self.transmission in CONVERTERS and any(cause.clutch == 2 for cause in self.causes):
            raise EmulatorConfigError("a car with a torque converter has one clutch: that of a cause cannot be 2")
        if self.is_on_the_road and self.routine != WorkshopRoutine():
            raise EmulatorConfigError(
                f"the workshop routine is driven before shift cycles only, not with drive {self.drive}"
            )

    @property
    def is_on_the_road(self) -> bool:
        """Whether a driver follows a speed trace; otherwise the shift cycle is driven."""
        return self.drive is not DriveName.CYCLE

    @property
    def seed_of_vehicle(self) -> int:
        """Seed of what stays with the car."""
        return self.seed if self.vehicle_seed is None else self.vehicle_seed

    @property
    def seed_of_drive(self) -> int:
        """Seed of what changes from drive to drive."""
        return self.seed if self.drive_seed is None else self.drive_seed
