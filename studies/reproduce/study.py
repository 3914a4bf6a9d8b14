"""The paper's method on its own sensor sets: every parameter set, without noise and with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.paper import PaperEstimate, nominal_driveline
from diag_service.diagnosis.friction.paper.driveline import quiet_filter
from diag_service.diagnosis.friction.paper.method import (
    NOISELESS_GATES,
    NOISY_GATES,
    Differentiators,
    FilmTable,
    Gates,
    PaperEstimates,
    PaperSignals,
    analyse,
    fit,
)
from studies.reproduce.differences import NOISELESS, central_difference, matched_filter
from studies.reproduce.drives import (
    PERIOD_S,
    PRESSURE_NOISE_RATIO,
    PaperCase,
    PaperDrive,
    noisy,
    rms,
)

CLUTCHES = (1, 2)
PARAMETERS = ("mu_c", "mu_s")
Key = tuple[PaperCase, int, str]  # parameter set, clutch, parameter
TUNING_SEED = 900  # the filters are matched on noise that no reported run has
RATE_GATE_STD = 4.0  # so quiet that noise alone passes the gate of the pressure rate once in 30,000 samples

CALIBRATION = nominal_calibration()
DRIVELINE = nominal_driveline()


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """One reading of the method: whatever the text leaves open, decided."""

    tables: tuple[FilmTable, FilmTable]
    differentiators: Differentiators = NOISELESS
    gates: Gates = NOISELESS_GATES


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Percent errors of many runs, shape (runs,) per parameter; runs that found nothing are left out."""

    percent: dict[Key, FloatArray]
    slope_right: dict[tuple[PaperCase, int], float]  # share of the runs in which the slope has the sign of the truth

    def mean(self, key: Key) -> float:
        """Return the mean error."""
        return float(np.mean(self.percent[key])) if len(self.percent[key]) else float("nan")

    def std(self, key: Key) -> float:
        """Return the scatter from run to run; 0 of a single run."""
        return float(np.std(self.percent[key], ddof=1)) if len(self.percent[key]) > 1 else 0.0


def matched_differentiators(drive: PaperDrive, gates: Gates = NOISY_GATES) -> Differentiators:
    """Return the filters for noisy signals.

    That of the speeds is matched with the ideal hub acceleration, as in the paper. That of the pressures, of which the
    paper says nothing, is as fast as the gate of the pressure rate allows.
    """
    clean, noise = drive.signals, noisy(drive.signals, TUNING_SEED)
    ideal = central_difference(clean.hub_rad_s, PERIOD_S).rate
    pressure_std_pa = PRESSURE_NOISE_RATIO * max(rms(one) for one in clean.pressure_pa)
    rate_std_pa_s = (gates.pressure_rate_min_pa_s or 0.0) / RATE_GATE_STD
    return Differentiators(
        speed=matched_filter(noise.hub_rad_s, ideal, PERIOD_S),
        pressure=quiet_filter(PERIOD_S, pressure_std_pa, rate_std_pa_s),
    )


def analysed(signals: PaperSignals, setup: Setup) -> PaperEstimates:
    """Return what the method makes of the signals before the fit."""
    return analyse(signals, setup.differentiators, setup.tables, CALIBRATION, DRIVELINE)


def fitted(analysis: PaperEstimates, gates: Gates) -> tuple[PaperEstimate, PaperEstimate]:
    """Return the estimates of both clutches."""
    first, second = (
        fit(clutch.data, gates, believed.friction)
        for clutch, believed in zip(analysis.clutches, CALIBRATION.clutches, strict=True)
    )
    return first, second


def noiseless_errors(drives: Sequence[PaperDrive], setup: Setup) -> Errors:
    """Return the errors on the signals as simulated: one run per parameter set."""
    return errors_of({drive.case: [fitted(analysed(drive.signals, setup), setup.gates)] for drive in drives}, drives)


def noisy_errors(drives: Sequence[PaperDrive], setups: Sequence[Setup], seeds: range) -> list[Errors]:
    """Return the errors of each setup over many draws of the noise; those that differ in gates share an analysis."""
    found: list[dict[PaperCase, list[tuple[PaperEstimate, PaperEstimate]]]] = [{} for _ in setups]
    for drive in drives:
        for seed in seeds:
            signals, known = noisy(drive.signals, seed), list[tuple[Setup, PaperEstimates]]()
            for setup, of_setup in zip(setups, found, strict=True):
                analysis = next((one for like, one in known if is_alike(like, setup)), None)
                if analysis is None:
                    analysis = analysed(signals, setup)
                    known.append((setup, analysis))
                of_setup.setdefault(drive.case, []).append(fitted(analysis, setup.gates))
    return [errors_of(of_setup, drives) for of_setup in found]


def is_alike(one: Setup, other: Setup) -> bool:
    """Return whether both read the signals alike."""
    return one.tables is other.tables and one.differentiators == other.differentiators


def error_percent(estimated: float, true: float) -> float:
    """Return the error as the paper states it."""
    return 100.0 * (estimated / true - 1.0)


def with_gates(setup: Setup, **changes: float | bool | None) -> Setup:
    """Return a setup with other numbers in its gates."""
    return replace(setup, gates=replace(setup.gates, **changes))  # type: ignore[arg-type]  # one dict, several types


def true_value(drive: PaperDrive, clutch: int, parameter: str) -> float:
    """Return what is true in a drive."""
    return float(getattr(drive.truth.clutches[clutch - 1].friction, parameter))


def errors_of(
    found: dict[PaperCase, list[tuple[PaperEstimate, PaperEstimate]]], drives: Sequence[PaperDrive]
) -> Errors:
    """Return the errors of the runs of every parameter set."""
    percent: dict[Key, FloatArray] = {}
    right: dict[tuple[PaperCase, int], float] = {}
    for drive in drives:
        for clutch in CLUTCHES:
            estimates = [pair[clutch - 1] for pair in found[drive.case]]
            for parameter in PARAMETERS:
                values = [getattr(one, parameter) for one in estimates]
                true = true_value(drive, clutch, parameter)
                percent[drive.case, clutch, parameter] = np.array(
                    [error_percent(value, true) for value in values if value is not None]
                )
            rises = true_value(drive, clutch, "mu_c") > true_value(drive, clutch, "mu_s")
            signs = [
                (one.mu_c > one.mu_s) == rises for one in estimates if one.mu_c is not None and one.mu_s is not None
            ]
            right[drive.case, clutch] = float(np.mean(signs)) if signs else 0.0
    return Errors(percent=percent, slope_right=right)
