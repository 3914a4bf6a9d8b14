"""Drives along the public speed traces: tolerance, energy, step, speed, events.

python -m studies.drives [TRACE ...]
python -m studies.drives --transmission lockup    # an automatic behind a torque converter
"""

import argparse
import time
from collections import Counter
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from studies.tolerance import share_within_tolerance
from canlog.arrays import FloatArray
from clutch_model.calibration import SHIPPED, shipped_calibration
from clutch_model.units import k_from_degc
from ecu_emulator.driving.indices import EventKind
from ecu_emulator.driving.trace import PUBLIC_TRACES, SpeedTrace, public_trace
from ecu_emulator.driving.trip import Car, DriveConditions, Trip
from ecu_emulator.plant import Col, nominal_parameters

WARM: Final = DriveConditions()
COLD_K: Final = k_from_degc(-10.0)
COLD: Final = DriveConditions(oil_k=COLD_K, coolant_k=COLD_K, ambient_k=COLD_K)
CONDITIONS: Final = {"warm": WARM, "-10 degC": COLD}
COMPARED_S: Final = 120.0
SEED: Final = 2016


def driven(
    car: Car, trace: SpeedTrace, conditions: DriveConditions, *, is_audited: bool
) -> tuple[Trip, FloatArray, float]:
    """Return the trip, all its rows and the processor time they took [s]."""
    trip = Trip(car, trace, conditions, np.random.default_rng(SEED), is_audited=is_audited)
    start_s = time.process_time()
    rows = trip.advance(trace.duration_s)
    return trip, rows, time.process_time() - start_s


def event_counts(rows: FloatArray) -> tuple[Counter[EventKind], Counter[EventKind]]:
    """Return how many events of each kind there were, and how many of them were broken off."""
    starts = np.flatnonzero(np.diff(rows[:, Col.EVENT_NUMBER], prepend=0.0))
    starts = starts[rows[starts, Col.EVENT_NUMBER] > 0.0]
    broken = set(rows[rows[:, Col.IS_ABORTED] > 0.0, Col.EVENT_NUMBER])
    kinds = [EventKind(int(kind)) for kind in rows[starts, Col.EVENT_KIND]]
    numbers = rows[starts, Col.EVENT_NUMBER]
    return Counter(kinds), Counter(kind for kind, number in zip(kinds, numbers, strict=True) if number in broken)


def drive_tables(car: Car, names: list[str], console: Console) -> None:
    """Print one row per trace and temperature: how it was driven, and what happened on the way."""
    driving = Table("trace", "oil", "in tolerance", "energy residual", "x real time", "oil at the end", title="Drives")
    kinds = [kind for kind in EventKind if kind is not EventKind.NONE]
    happening = Table("event", title="Events (of these broken off)")
    columns = []
    for name in names:
        trace = public_trace(name)
        for label, conditions in CONDITIONS.items():
            trip, rows, _ = driven(car, trace, conditions, is_audited=True)
            _, _, took_s = driven(car, trace, conditions, is_audited=False)
            share = share_within_tolerance(trace, rows[:, Col.T_S], rows[:, Col.VEHICLE_SPEED])
            driving.add_row(
                name,
                label,
                f"{share:.2%}",
                f"{trip.power_balance.residual_ratio:.1e}",
                f"{trace.duration_s / took_s:.0f}",
                f"{rows[-1, Col.SUMP_TEMPERATURE] - k_from_degc(0.0):.0f} degC",
            )
            happening.add_column(f"{name} {label}", justify="right")
            columns.append(event_counts(rows))
    for kind in (one for one in kinds if any(all_of[one] for all_of, _ in columns)):
        cells = [f"{all_of[kind]}" + (f" ({broken[kind]})" if broken[kind] else "") for all_of, broken in columns]
        happening.add_row(kind.name.lower().replace("_", " "), *cells)
    console.print(driving)
    if happening.rows:
        console.print(happening)


def step_halving(car: Car, names: list[str], console: Console) -> None:
    """Print what half the step changes: the speed of the car, the slip energy of every clutch."""
    table = Table("trace", "oil", "dv [m/s]", "clutch heat", title=f"Halving the step, {COMPARED_S:g} s")
    for name in names:
        whole = public_trace(name)
        begin = whole.t_s <= COMPARED_S
        trace = SpeedTrace(
            name=name, t_s=whole.t_s[begin], speed_m_s=whole.speed_m_s[begin], grade_ratio=whole.grade_ratio[begin]
        )
        for label, coarse in CONDITIONS.items():
            fine = DriveConditions(
                oil_k=coarse.oil_k, coolant_k=coarse.coolant_k, ambient_k=coarse.ambient_k, dt_s=0.5 * coarse.dt_s
            )
            runs = [driven(car, trace, conditions, is_audited=True) for conditions in (coarse, fine)]
            change_m_s = np.abs(runs[0][1][:, Col.VEHICLE_SPEED] - runs[1][1][:, Col.VEHICLE_SPEED]).max()
            heats_j = [trip.power_balance.clutch_j for trip, _, _ in runs]
            table.add_row(name, label, f"{change_m_s:.1e}", f"{heats_j[1] / heats_j[0] - 1.0:+.1e}")
    console.print(table)


def main() -> None:
    """Drive the traces named on the command line, or all of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("traces", nargs="*", default=list(PUBLIC_TRACES), metavar="TRACE")
    parser.add_argument("--transmission", choices=SHIPPED, default="nominal")
    options = parser.parse_args()
    car = Car(truth=shipped_calibration(options.transmission), parameters=nominal_parameters(options.transmission))
    console = Console(markup=False, width=160)
    Trip(car, public_trace("us06"), WARM, np.random.default_rng(SEED), is_audited=True).advance(0.01)  # compiles
    drive_tables(car, options.traces, console)
    step_halving(car, options.traces, console)


if __name__ == "__main__":
    main()
