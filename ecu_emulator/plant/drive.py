"""What a drive is: how often and how the cycle is driven, and how driver and friction vary from cycle to cycle."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clutch_model.errors import CalibrationError
from clutch_model.tables import require
from ecu_emulator.scenario.scenario import MAX_REVS, Ranged, check_range, ranged
from ecu_emulator.shift_control import tcu_data
from ecu_emulator.shift_control.tcu_data import ControlParameters

_VARIATION_LIMIT = 2.5  # standard deviations; the driver never leaves the range in which the cycle makes sense
_MIN_PEDAL_RATIO = 0.25  # a little less and the car does not reach the last upshift
# Colder oil drags the idle shaft harder than the synchroniser can hold it: preselection would take for ever.
_COLDEST_OIL_K = 313.15


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionFactors:
    """Factors on the true friction coefficients during one cycle."""

    mu_c1: float = 1.0
    mu_s1: float = 1.0
    mu_c2: float = 1.0
    mu_s2: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveSettings(Ranged):
    """One drive on level ground of ``cycles`` shift cycles, up through all gears and down again.

    Raises
    ------
    CalibrationError
        On construction, naming the first number outside its range.
    """

    error = CalibrationError

    cycles: int = 1
    seed: int = 0
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
        require(self.cycles >= 1, f"cycles must be >= 1, got {self.cycles}")
        require(self.seed >= 0, f"seed must be >= 0, got {self.seed}")
        Ranged.__post_init__(self)
        steps = 1.0e-3 / self.dt_s
        require(abs(steps - round(steps)) < 1.0e-6 * steps, f"dt_s must divide 1 ms, got {self.dt_s}")
        for factors in self.friction_factors:
            for name in ("mu_c1", "mu_s1", "mu_c2", "mu_s2"):
                check_range(f"friction_factors {name}", getattr(factors, name), 0.3, 2.0, CalibrationError)

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
    factors = drive.friction_factors or (FrictionFactors(),)
    for cycle in range(drive.cycles):
        now = factors[min(cycle, len(factors) - 1)]
        table[cycle, tcu_data.CYCLE_MU : tcu_data.CYCLE_UP] = (now.mu_c1, now.mu_s1, now.mu_c2, now.mu_s2)
    return table
