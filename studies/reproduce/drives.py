"""The drives of the paper: three shift cycles with each of its three parameter sets, and what its sensors say."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, clutch_of_gear, nominal_calibration
from clutch_model.pack import FilmLaw, film_law
from diag_service.diagnosis.friction.paper.method import TABLE_END_PA, FilmTable, PaperSignals, static_table
from ecu_emulator.plant.course import DriveSettings
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import INERTIA, PREFILL, TORQUE

BoolArray = npt.NDArray[np.bool_]

PERIOD_S = 1e-3  # the paper gives none
BIN_PA = 1.0e4  # of the table of films that engaging clutches passed
MIN_BIN_COUNT = 10
CYCLE_COUNT = 3
DRIVE_SEED = 20150414
CALIBRATION_SEED = DRIVE_SEED + 1
VARY_RATIO = 0.05
LONGEST_CYCLE_S = 80.0
SPEED_NOISE_RATIO, PRESSURE_NOISE_RATIO = 0.10, 0.05  # the paper's; of the root mean square


class PaperCase(StrEnum):
    """The parameter sets of the paper's Table 4."""

    IDEAL = "ideal"
    CASE_1 = "case 1"
    CASE_2 = "case 2"


FACTORS = {PaperCase.IDEAL: (1.0, 1.0), PaperCase.CASE_1: (0.95, 1.05), PaperCase.CASE_2: (0.85, 1.15)}
"""Factors on mu_C and mu_S; clutch_model/calibrations/nominal.toml."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperDrive:
    """One drive: what is true, every row of it, and the noiseless sensor set."""

    case: PaperCase
    truth: Calibration
    rows: FloatArray
    signals: PaperSignals

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the true slip of a clutch."""
        slip_rad_s: FloatArray = self.rows[:, Col.HUB_SPEED] - self.rows[:, Col.INPUT1_SPEED + clutch - 1]
        return slip_rad_s

    def is_locked(self, clutch: int) -> BoolArray:
        """Tell where a clutch is truly locked."""
        locked: BoolArray = self.rows[:, Col.STICK1 + clutch - 1] > 0.0
        return locked


def true_calibration(case: PaperCase) -> Calibration:
    """Return the nominal calibration with the friction of a parameter set."""
    nominal = nominal_calibration()
    factor_c, factor_s = FACTORS[case]
    first, second = (
        replace(
            clutch,
            friction=replace(
                clutch.friction, mu_c=clutch.friction.mu_c * factor_c, mu_s=clutch.friction.mu_s * factor_s
            ),
        )
        for clutch in nominal.clutches
    )
    return replace(nominal, clutches=(first, second))


def drive(case: PaperCase, *, cycles: int = CYCLE_COUNT, seed: int = DRIVE_SEED) -> PaperDrive:
    """Drive the shift cycles of a parameter set."""
    truth = true_calibration(case)
    settings = DriveSettings(cycles=cycles, seed=seed, vary_ratio=VARY_RATIO)
    rows = Powertrain(truth, nominal_parameters(), settings).advance(cycles * LONGEST_CYCLE_S)
    return PaperDrive(case=case, truth=truth, rows=rows, signals=_signals(rows))


def noisy(signals: PaperSignals, seed: int) -> PaperSignals:
    """Return the signals with the paper's noise: white, Gaussian, on speeds and pressures."""
    rng = np.random.default_rng(seed)

    def disturbed(values: FloatArray, ratio: float) -> FloatArray:
        return values + rng.normal(0.0, ratio * rms(values), values.shape)

    return replace(
        signals,
        hub_rad_s=disturbed(signals.hub_rad_s, SPEED_NOISE_RATIO),
        input_rad_s=np.stack([disturbed(one, SPEED_NOISE_RATIO) for one in signals.input_rad_s]),
        pressure_pa=np.stack([disturbed(one, PRESSURE_NOISE_RATIO) for one in signals.pressure_pa]),
    )


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def static_tables() -> tuple[FilmTable, FilmTable]:
    """Return the film tables of both clutches, equilibrium reading."""
    first, second = (static_table(film_law(clutch)) for clutch in nominal_calibration().clutches)
    return first, second


def trajectory_tables() -> tuple[FilmTable, FilmTable]:
    """Return the film tables of both clutches as one calibration cycle with fresh fluid shows them."""
    cycle = drive(PaperCase.IDEAL, cycles=1, seed=CALIBRATION_SEED)
    phase, clutch = cycle.rows[:, Col.SHIFT_PHASE], clutch_of_gear(cycle.rows[:, Col.TARGET_GEAR])
    engaging = (phase == TORQUE) | (phase == INERTIA)
    first, second = (
        trajectory_table(
            cycle.rows[mine, Col.PRESSURE1 + m],
            cycle.rows[mine, Col.FILM1 + m],
            film_law(cycle.truth.clutches[m]),
        )
        for m, mine in enumerate((engaging & (clutch == 1), engaging & (clutch == 2)))
    )
    return first, second


def _signals(rows: FloatArray) -> PaperSignals:
    def pair(first: Col) -> FloatArray:
        return np.ascontiguousarray(rows[:, first : first + 2].T)

    phase = rows[:, Col.SHIFT_PHASE]
    return PaperSignals(
        period_s=PERIOD_S,
        hub_rad_s=rows[:, Col.HUB_SPEED].copy(),
        input_rad_s=pair(Col.INPUT1_SPEED),
        pressure_pa=pair(Col.PRESSURE1),
        flywheel_nm=rows[:, Col.FLYWHEEL_TORQUE].copy(),
        shaft_nm=pair(Col.SHAFT1_TORQUE),
        oil_k=rows[:, Col.SUMP_TEMPERATURE].copy(),
        is_shifting=(phase >= PREFILL) & (phase <= INERTIA),
    )


def trajectory_table(pressure_pa: FloatArray, film_m: FloatArray, law: FilmLaw) -> FilmTable:
    """Return the median film at each pressure that engaging clutches passed; the static table where none did.

    Parameters
    ----------
    pressure_pa, film_m : (n,) array
        Pressure and film of on-coming clutches in one calibration cycle.
    """
    fallback = static_table(law)
    edges_pa = np.arange(0.0, TABLE_END_PA + BIN_PA, BIN_PA)
    centres_pa = edges_pa[:-1] + 0.5 * BIN_PA
    bins = np.digitize(pressure_pa, edges_pa) - 1
    medians_m = fallback.film_at(centres_pa)
    for row in np.flatnonzero(np.bincount(bins[bins >= 0], minlength=len(centres_pa)) >= MIN_BIN_COUNT):
        medians_m[row] = np.median(film_m[bins == row])
    return FilmTable(pressure_pa=centres_pa, film_m=medians_m)
