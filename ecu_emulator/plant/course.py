"""How a drive is set, and what shift cycles and trips have in common: laws, a step, a machine, its energy."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from clutch_model.calibration import clutch_of_gear
from clutch_model.errors import CalibrationError, DomainError
from clutch_model.tables import require
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import ACCOUNT_COUNT
from ecu_emulator.plant.clutch import refresh_contact
from ecu_emulator.plant.driveline import throttle_flow_kg_s
from ecu_emulator.plant.integration import Machine, workspace
from ecu_emulator.plant.loop import DriveLaw
from ecu_emulator.plant.rates import PlantLaw
from ecu_emulator.scenario.faults import CheckedRecord, ranged
from ecu_emulator.scenario.scenario import MAX_REVS
from ecu_emulator.shift_control import tcu_data
from ecu_emulator.shift_control.tcu_data import ControlParameters

_VARIATION_LIMIT = 2.5  # standard deviations; the driver never leaves the range in which the cycle makes sense
_MIN_PEDAL_RATIO = 0.25  # a little less and the car does not reach the last upshift
# Colder oil drags the idle shaft harder than the synchroniser can hold it: preselection would take for ever.
_COLDEST_OIL_K = 313.15


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionFactors(CheckedRecord):
    """Factors on the true friction coefficients during one cycle; raises CalibrationError on construction."""

    error = CalibrationError

    mu_c1: float = ranged(1.0, 0.3, 2.0)
    mu_s1: float = ranged(1.0, 0.3, 2.0)
    mu_c2: float = ranged(1.0, 0.3, 2.0)
    mu_s2: float = ranged(1.0, 0.3, 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveSettings(CheckedRecord):
    """One drive on level ground of ``cycles`` shift cycles, up through all gears and down again.

    Raises
    ------
    CalibrationError
        On construction, naming the first number outside its range.
    """

    error = CalibrationError

    cycles: int = ranged(1, 1, math.inf)
    seed: int = ranged(0, 0, math.inf)
    pedal_ratio: float = ranged(0.45, _MIN_PEDAL_RATIO, 0.9)
    brake_m_s2: float = ranged(0.7, 0.0, 1.0)
    vary_ratio: float = ranged(0.0, 0.0, 0.1)  # relative deviation from cycle to cycle: pedal, brake, shift speeds
    initial_oil_k: float = ranged(363.15, _COLDEST_OIL_K, 403.15)
    coolant_k: float = ranged(353.15, _COLDEST_OIL_K, 393.15)
    ambient_k: float = ranged(298.15, 233.15, 328.15)  # also the temperature of the intake air
    initial_engine_rad_s: float = ranged(150.0, 80.0, 300.0)  # rolling in 1st gear
    dt_s: float = ranged(2.5e-4, 1.0e-6, 5.0e-4)  # a whole fraction of a millisecond
    open_revs: int = ranged(0, 0, MAX_REVS)  # of the workshop routine before: in neutral, at rest, clutches open
    closed_revs: int = ranged(0, 0, MAX_REVS)  # then both closed
    waits: bool = False  # the routine waits until somebody asks for it, and says how many revs
    friction_factors: tuple[FrictionFactors, ...] = ()  # per cycle, the last one goes on; none: 1

    def __post_init__(self) -> None:
        """Check every number against the range in which the cycle can be driven."""
        CheckedRecord.__post_init__(self)
        steps = 1.0e-3 / self.dt_s
        require(abs(steps - round(steps)) < 1.0e-6 * steps, f"dt_s must divide 1 ms, got {self.dt_s}")

    @property
    def has_routine(self) -> bool:
        """Whether the drive begins at rest with the workshop routine, at once or when it is asked for."""
        return self.waits or self.open_revs + self.closed_revs > 0

    @property
    def steps_per_millisecond(self) -> int:
        """Integration steps in one row of the record."""
        return round(1.0e-3 / self.dt_s)


def cycle_table(drive: DriveSettings, control: ControlParameters) -> npt.NDArray[np.float64]:
    """Return the table of cycles, shape (cycles, `tcu_data.CYCLE_COLUMN_COUNT`); the same for the same seed.

    A longer drive begins with the cycles of a shorter one.
    """
    generator = np.random.default_rng(np.random.SeedSequence(drive.seed))
    table = np.zeros((drive.cycles, tcu_data.CYCLE_COLUMN_COUNT))
    driver = np.array(
        [drive.pedal_ratio, drive.brake_m_s2, *control.upshift_speeds_rad_s, *control.downshift_speeds_rad_s]
    )
    draws = generator.standard_normal((drive.cycles, driver.size)).clip(-_VARIATION_LIMIT, _VARIATION_LIMIT)
    count = len(control.upshift_speeds_rad_s)
    up, down = tcu_data.CYCLE_UP + np.arange(count), tcu_data.CYCLE_DOWN + np.arange(count)
    columns = [tcu_data.CYCLE_PEDAL, tcu_data.CYCLE_BRAKE, *up, *down]
    table[:, columns] = driver * (1.0 + drive.vary_ratio * draws)
    table[:, tcu_data.CYCLE_PEDAL] = table[:, tcu_data.CYCLE_PEDAL].clip(_MIN_PEDAL_RATIO, 1.0)
    factors = np.array([astuple(factors) for factors in drive.friction_factors or (FrictionFactors(),)])
    table[:, tcu_data.CYCLE_MU : tcu_data.CYCLE_UP] = factors[np.minimum(np.arange(drive.cycles), len(factors) - 1)]
    return table


LawT = TypeVar("LawT", bound=tuple[object, ...])
# Classic Runge-Kutta is stable to 2.79 on the real and to 2.83 on the imaginary axis.
_STABILITY_LIMIT = 2.5
ROWS_PER_S = 1000
_IDLE_MANIFOLD_RATIO = 0.35  # of ambient pressure, when a drive begins


def as_record(law: LawT) -> LawT:
    """Return the numpy record with the members of a nested named tuple of numbers.

    It reads like the tuple it was made of, hence the type. A kernel that gets the tuple itself copies every number at
    every call; the record costs one pointer, and equal members can be indexed (``law.shafts[k]``). Raises DomainError
    if a member is neither a number nor a tuple of members of one type.
    """
    record = np.array([_plain(law)], dtype=_dtype_of(law)).view(np.recarray)[0]
    return cast("LawT", record)


def _dtype_of(value: object) -> npt.DTypeLike:
    if isinstance(value, float):
        return np.dtype(np.float64)
    if isinstance(value, int):
        return np.dtype(np.int64)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        members = [(name, _dtype_of(member)) for name, member in zip(value._fields, value, strict=True)]
        return np.dtype(members, align=True)
    if isinstance(value, tuple) and value and len({str(_dtype_of(member)) for member in value}) == 1:
        return np.dtype((_dtype_of(value[0]), (len(value),)))
    raise DomainError(f"not part of a record: {value!r}")


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        members = [_plain(member) for member in value]
        return tuple(members) if hasattr(value, "_fields") else members
    return value


def check_step(dt_s: float, law: PlantLaw, overall_ratios: Sequence[float], *, starts_in_neutral: bool = False) -> None:
    """Check that ``dt_s`` resolves the largest eigenvalue of each stiff part of the linearised plant.

    Raises
    ------
    CalibrationError
        Naming the motion that is too fast and the longest step it allows.
    """
    flywheel, output, vehicle = law.flywheel, law.output, law.vehicle
    valve = law.clutches[0].valve
    rates = {
        "flywheel": _shaft_rate(
            flywheel.stiffness_nm_rad, flywheel.damping_nms_rad, law.engine_inertia_kg_m2, law.hub_inertia_kg_m2
        ),
        "output shaft": _shaft_rate(
            output.stiffness_nm_rad, output.shaft_damping_nms_rad, output.inertia_kg_m2, vehicle.wheel_inertia_kg_m2
        ),
        "tyre": vehicle.tyre_stiffness_n * vehicle.wheel_radius_m**2 / vehicle.wheel_inertia_kg_m2,
        "cavity": valve.orifice_m3_s_sqrt_pa / math.sqrt(valve.laminar_pressure_pa) / valve.pack_compliance_m3_pa,
    }
    for number, shaft in enumerate((law.shafts[0], law.shafts[1]), start=1):
        rates[f"input shaft {number}"] = _shaft_rate(
            shaft.stiffness_nm_rad, shaft.damping_nms_rad, shaft.clutch_inertia_kg_m2, shaft.gear_inertia_kg_m2
        )
    for gear in range(1, 0 if law.converter.is_there else len(overall_ratios)):
        neighbours = [current for current in (gear - 1, gear + 1) if 1 <= current < len(overall_ratios)]
        rates[f"synchroniser of gear {gear}"] = max(
            _synchroniser_rate(law, overall_ratios, gear, current) for current in neighbours
        )
    if starts_in_neutral and not law.converter.is_there:
        rates["synchroniser of gear 2 from neutral"] = _synchroniser_rate(law, overall_ratios, 2, 0)
    name = max(rates, key=lambda key: rates[key])
    longest_s = _STABILITY_LIMIT / rates[name]
    require(dt_s <= longest_s, f"dt_s must be <= {longest_s:.2e} s for this plant ({name}), got {dt_s:g}")


def _shaft_rate(stiffness_nm_rad: float, damping_nms_rad: float, first_kg_m2: float, second_kg_m2: float) -> float:
    mobility = 1.0 / first_kg_m2 + 1.0 / second_kg_m2
    return float(np.abs(np.roots((1.0, damping_nms_rad * mobility, stiffness_nm_rad * mobility))).max())


def _synchroniser_rate(law: PlantLaw, overall_ratios: Sequence[float], gear: int, current: int) -> float:
    turned, turning = (law.shafts[clutch_of_gear(number) - 1].gear_inertia_kg_m2 for number in (current, gear))
    load_kg_m2 = law.output.inertia_kg_m2 + overall_ratios[current] ** 2 * turned
    mobility = 1.0 / turning + overall_ratios[gear] ** 2 / load_kg_m2
    return law.synchroniser.torque_nm / law.synchroniser.full_torque_slip_rad_s * mobility


def idle_machine(
    cycles: FloatArray, law: PlantLaw, oil_k: float, *, memory_count: int, sense_count: int, command_count: int
) -> Machine:
    """Return a machine at time 0: the manifold as at idle, oil and clutches warm, both clutches open, all else 0.

    Controllers have the counts of places they need.
    """
    machine = Machine(
        y=np.zeros(at.STATE_COUNT),
        u=np.zeros(at.INPUT_COUNT),
        modes=np.zeros(at.MODE_COUNT, np.int64),
        work=workspace(),
        memory=np.zeros(memory_count),
        sense=np.zeros(sense_count),
        commands=np.zeros(command_count),
        clock=np.zeros(1, np.int64),
        cycles=cycles,
    )
    y = machine.y
    y[at.P_M] = _IDLE_MANIFOLD_RATIO * law.engine.ambient_pressure_pa
    y[at.SPARK] = machine.commands[tcu_data.SPARK] = 1.0
    y[[at.T_C, at.T_C + 1, at.T_OIL]] = oil_k
    for index, clutch in enumerate((law.clutches[0], law.clutches[1])):
        y[at.FILM + index] = clutch.film.open_gap_m
        refresh_contact(y, index, clutch)
    machine.u[at.AIR_FLOW] = throttle_flow_kg_s(0.0, law.engine)
    machine.u[at.DIRECTION : at.DIRECTION + 2] = 1.0
    return machine


class MachineCourse:
    """A machine from its start on; what it starts as depends on the touch points that the control believes in.

    Parameters
    ----------
    law : DriveLaw
        What it obeys, as a record that kernels take.
    touch_pressures_pa : tuple of two, or None
        Touch points that the control believes in; None: those of the clutches.
    """

    _machine: Machine
    _start: FloatArray  # state as the audit began

    def __init__(self, law: DriveLaw, touch_pressures_pa: tuple[float, float] | None) -> None:
        self._drive_law = law
        if touch_pressures_pa is not None:
            self.believe(touch_pressures_pa)

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control take these for its clutches' touch points from the next row on."""
        np.asarray(self._drive_law.actuation.touch_pressure_pa)[:] = touch_pressures_pa

    def _obey(self, law: DriveLaw) -> None:
        """Let the plant be another one from the next row on; the control goes on as it was."""
        law.actuation = self._drive_law.actuation  # type: ignore[misc]  # a record, which is mutable: see `as_record`
        self._drive_law = law

    def audit(self) -> None:
        """Keep an account of the energies from now on, which costs a few percent of speed."""
        work = self._machine.work._replace(account=np.zeros(3 * ACCOUNT_COUNT))
        self._machine = self._machine._replace(work=work)
        self._start = self._machine.y.copy()

    @property
    def account(self) -> tuple[FloatArray, FloatArray, FloatArray, PlantLaw]:
        """The account since `audit` was called, the state then and now, and the law."""
        return self._machine.work.account, self._start, self._machine.y, self._drive_law.plant
