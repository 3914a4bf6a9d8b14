"""The method varied: other readings of the text, the simulated film in place of the table, and CAN frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from diag_service.diagnosis.friction.paper import PaperCollection, PaperEstimate
from diag_service.diagnosis.friction.paper.method import FilmTable, fit, friction_data, viscous_torques_nm
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import FluidCondition
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import new_decoder, to_batch
from studies.reproduce.differences import central_difference, matched_filter
from studies.reproduce.drives import PERIOD_S, PaperCase, PaperDrive, noisy
from studies.reproduce.study import (
    CALIBRATION,
    DRIVELINE,
    TUNING_SEED,
    Errors,
    Setup,
    analysed,
    errors_of,
    noisy_errors,
    with_gates,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One decision changed, all others kept, and what comes of it."""

    name: str
    errors: Errors


def variants(setup: Setup, other_tables: tuple[FilmTable, FilmTable], drive: PaperDrive) -> dict[str, Setup]:
    """Return the setups by name, the one of the tables first."""
    pressure_pa = drive.signals.pressure_pa[0]
    fast = matched_filter(
        noisy(drive.signals, TUNING_SEED).pressure_pa[0],
        central_difference(pressure_pa, PERIOD_S).rate,
        PERIOD_S,
    )
    return {
        "as in the tables above": setup,
        "film table from trajectories instead of equilibria": replace(setup, tables=other_tables),
        "samples of the whole drive, not of shifts only": with_gates(setup, is_shift_required=False),
        "mu_C from |slip| > 1 rad/s, not slip > 1 rad/s": with_gates(setup, is_slip_signed=False),
        "no gate on the pressure rate": with_gates(setup, pressure_rate_min_pa_s=None),
        "pressure rate > 5e5 Pa/s": with_gates(setup, pressure_rate_min_pa_s=5.0e5),
        "pressure rate > 1e6 Pa/s": with_gates(setup, pressure_rate_min_pa_s=1.0e6),
        "pressure filter matched with the ideal pressure rate": replace(
            setup, differentiators=replace(setup.differentiators, pressure=fast)
        ),
        "no 20 % gate around the previous mu_S": with_gates(setup, prior_tolerance_ratio=None),
    }


def readings(
    drives: Sequence[PaperDrive],
    setup: Setup,
    other_tables: tuple[FilmTable, FilmTable],
    seeds: range,
) -> list[Reading]:
    """Return what every decision does to the noisy errors."""
    setups = variants(setup, other_tables, drives[0])
    found = noisy_errors(drives, list(setups.values()), seeds)
    return [Reading(name=name, errors=errors) for name, errors in zip(setups, found, strict=True)]


def known_film_errors(drives: Sequence[PaperDrive], setup: Setup) -> Errors:
    """Return the noiseless errors with the true film thickness and pack temperature."""
    return errors_of({drive.case: [_film_estimates(drive, setup)] for drive in drives}, drives)


def _film_estimates(drive: PaperDrive, setup: Setup) -> tuple[PaperEstimate, PaperEstimate]:
    analysis = analysed(drive.signals, setup)
    found = []
    for m, (believed, clutch) in enumerate(zip(CALIBRATION.clutches, analysis.clutches, strict=True)):
        film_m = drive.rows[:, Col.FILM1 + m].copy()
        clutch_k = drive.rows[:, Col.CLUTCH1_TEMPERATURE + m].copy()
        slip_rad_s = clutch.data.slip_rad_s
        viscous_nm = viscous_torques_nm(slip_rad_s, film_m, clutch_k, believed, CALIBRATION.viscosity)
        contact_nm = clutch.friction_nm - viscous_nm
        data = friction_data(contact_nm, slip_rad_s, film_m, clutch.pressure.rate, clutch.data.is_shifting, believed)
        found.append(fit(data, setup.gates, believed.friction))
    return found[0], found[1]


SCENARIO = "noise_only"
FLUID = {
    PaperCase.IDEAL: FluidCondition.IDEAL,
    PaperCase.CASE_1: FluidCondition.CASE_1,
    PaperCase.CASE_2: FluidCondition.CASE_2,
}


def can_errors(drives: Sequence[PaperDrive], seeds: range, cycles: int) -> Errors:
    """Return the errors on CAN frames of drives with sensor noise only, a new drive for every seed."""
    found: dict[PaperCase, list[tuple[PaperEstimate, PaperEstimate]]] = {case: [] for case in FLUID}
    for case in FLUID:
        for seed in seeds:
            found[case].append(_can_estimates(case, seed, cycles))
    return errors_of(found, drives)


def _can_estimates(case: PaperCase, seed: int, cycles: int) -> tuple[PaperEstimate, PaperEstimate]:
    scenario = load_scenario(SCENARIO)
    fluid = replace(scenario.fluid, condition=FLUID[case])
    frames, _ = frames_of(replace(scenario, seed=seed, cycles=cycles, fluid=fluid))
    decoder, finder = new_decoder(), ShiftFinder()
    collection = PaperCollection(CALIBRATION, DRIVELINE)
    for columns in decoder.whole([to_batch(frames)]):
        for event in finder.feed(columns):
            collection.add(event)
    first, second = (clutch.estimate for clutch in collection.pooled())
    nothing = PaperEstimate(mu_c=None, mu_s=None, static_count=0, coulomb_count=0)
    return first or nothing, second or nothing
