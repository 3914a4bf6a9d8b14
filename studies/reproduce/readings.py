"""What the text leaves open, varied: how far each decision moves the noisy result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from diag_service.diagnosis.friction.paper.friction_data import FilmTable
from studies.reproduce.differences import central_difference, matched_filter
from studies.reproduce.drives import PERIOD_S, PaperDrive, noisy
from studies.reproduce.study import TUNING_SEED, Errors, Setup, noisy_errors, with_gates


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
    advance: Callable[[], None],
) -> list[Reading]:
    """Return what every decision does to the noisy errors."""
    return [
        Reading(name=name, errors=noisy_errors(drives, one, seeds, advance))
        for name, one in variants(setup, other_tables, drives[0]).items()
    ]
