"""The past of one clutch as columns: a row per event of which the friction is known."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any, Final, Self

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from diag_service.diagnosis.prognosis.assumptions import NEW_WITHIN_M
from diag_service.diagnosis.records import FluidFill, ShiftEstimate, ShiftResult, Status, utc_from_bus_ns

NS_PER_S: Final = 1e9
MAX_CORRELATION: Final = 0.999


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Results of single events of one clutch, the oldest first; all columns have shape (n,).

    The random part of an error differs from row to row, the common part is that of all rows: torque gain, piston area
    and whatever else the vehicle has of its own.
    """

    end_s: FloatArray  # since the epoch, UTC
    odometer_m: FloatArray  # never falls
    mu_c: FloatArray
    mu_s: FloatArray
    random_std_mu_c: FloatArray
    random_std_mu_s: FloatArray
    random_correlation: FloatArray
    common_std_mu_c: FloatArray
    common_std_mu_s: FloatArray
    common_correlation: FloatArray
    sump_temperature_k: FloatArray
    slip_energy_j: FloatArray | None  # of the row's event; None: not known of all
    event_count: FloatArray  # events of the clutch since the row before, this one included
    fluid_number: Int64Array  # of the fluid, counted by the fills that are known; never falls
    new_fluids: tuple[int, ...] = ()  # numbers of the fluids that were new when first seen
    left_out_count: int = 0  # used events that miss something or go back in odometer
    is_fluid_newer: bool = False  # than every row: of the fluid that is in nothing is known

    def __post_init__(self) -> None:
        """Check that the columns are a past."""
        for name in _COLUMNS:
            column = getattr(self, name)
            if column is not None and (column.shape != self.odometer_m.shape or not np.all(np.isfinite(column))):
                raise ValueError(f"{name} must have {len(self.odometer_m)} finite values")
        if np.any(np.diff(self.odometer_m) < 0.0) or np.any(np.diff(self.fluid_number) < 0):
            raise ValueError("odometer and number of the fluid must not fall")
        if np.any(np.minimum(self.random_std_mu_c, self.random_std_mu_s) <= 0.0):
            raise ValueError("random deviations must be > 0")

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.odometer_m)

    def first(self, count: int) -> Self:
        """Return the history as it was after so many rows."""
        return replace(self._rows(slice(None, count)), is_fluid_newer=False)

    def since(self, row: int) -> Self:
        return self._rows(slice(row, None))

    def _rows(self, which: slice) -> Self:
        columns: dict[str, Any] = {name: getattr(self, name) for name in _COLUMNS}
        chosen: dict[str, Any] = {name: one if one is None else one[which] for name, one in columns.items()}
        return replace(self, **chosen)


_COLUMNS: Final = tuple(one.name for one in fields(History) if not one.name.startswith(("new_", "left_", "is_")))


def history_of(results: Iterable[ShiftResult], fills: Sequence[FluidFill], clutch: int) -> History:
    """Return the past of clutch 1 or 2 from stored results, in whatever order they are.

    Events of which the friction is not known only count as events. Known ones without odometer or oil temperature, and
    those whose odometer goes back, are left out and counted.
    """
    return history_of_estimates((one.estimate for one in results), fills, clutch)


def history_of_estimates(estimates: Iterable[ShiftEstimate], fills: Sequence[FluidFill], clutch: int) -> History:
    """Return the same from the estimates alone, which is all that a past is made of."""
    own = sorted((one for one in estimates if one.clutch == clutch), key=lambda one: one.end_ns)
    rows: list[dict[str, float]] = []
    waiting = left_out = 0
    highest_m = -np.inf
    for estimate in own:
        waiting += 1
        if estimate.status is not Status.VALID:
            continue
        row = _row(estimate)
        if row is None or row["odometer_m"] < highest_m:
            left_out += 1
            continue
        rows.append(row | {"event_count": float(waiting), "fluid_number": _fluid_of(estimate, fills)})
        highest_m, waiting = row["odometer_m"], 0
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows], np.float64) for name in _COLUMNS}
    columns["fluid_number"] = columns["fluid_number"].astype(np.int64)
    energy_j = _energies(columns.pop("slip_energy_j"))
    history = History(**columns, slip_energy_j=energy_j, left_out_count=left_out)
    is_newer = len(fills) > (history.fluid_number[-1] if len(history) else 0)
    return replace(history, new_fluids=_new_fluids(history, fills), is_fluid_newer=bool(is_newer))


def _row(estimate: ShiftEstimate) -> dict[str, float] | None:
    """Return what is known of one event, the parts of its errors apart; None if something is missing."""
    known, free = estimate.friction, estimate.scale_free
    if known is None or free is None or estimate.odometer_m is None or estimate.sump_temperature_k is None:
        return None
    random_c, random_s = known.random_std_mu_c, known.random_std_mu_s
    common_c = max(known.std_mu_c**2 - random_c**2, 0.0) ** 0.5
    common_s = max(known.std_mu_s**2 - random_s**2, 0.0) ** 0.5
    shared = known.correlation * known.std_mu_c * known.std_mu_s - free.correlation * random_c * random_s
    both = common_c * common_s
    energy_j = estimate.slip_energy_j
    row = {
        "end_s": estimate.end_ns / NS_PER_S,
        "odometer_m": estimate.odometer_m,
        "mu_c": known.mu_c,
        "mu_s": known.mu_s,
        "random_std_mu_c": random_c,
        "random_std_mu_s": random_s,
        "random_correlation": free.correlation,
        "common_std_mu_c": common_c,
        "common_std_mu_s": common_s,
        "common_correlation": min(max(shared / both, -MAX_CORRELATION), MAX_CORRELATION) if both else 0.0,
        "sump_temperature_k": estimate.sump_temperature_k,
    }
    if not all(map(isfinite, row.values())) or min(random_c, random_s) <= 0.0:
        return None
    return row | {"slip_energy_j": -1.0 if energy_j is None else energy_j}


def _fluid_of(estimate: ShiftEstimate, fills: Sequence[FluidFill]) -> int:
    if not fills:
        return 0
    start = utc_from_bus_ns(estimate.start_ns)
    return sum(fill.filled_at <= start for fill in fills)


def _energies(energy_j: FloatArray) -> FloatArray | None:
    """Return the energies with the mean in place of the few that are not known, or None if most are not."""
    is_known = energy_j > 0.0
    if np.count_nonzero(is_known) * 2 <= len(energy_j):
        return None
    return np.where(is_known, energy_j, np.mean(energy_j[is_known]))


def _new_fluids(history: History, fills: Sequence[FluidFill]) -> tuple[int, ...]:
    """Return the numbers of the fluids that were new when they were first seen."""
    filled_m = [fill.odometer_m for fill in sorted(fills, key=lambda fill: fill.filled_at)]
    new = []
    for number in np.unique(history.fluid_number).tolist():
        first = int(np.searchsorted(history.fluid_number, number))
        since_m = 0.0 if not number else filled_m[number - 1]
        if since_m is None and first:  # nobody noted the odometer: it was filled after the row before
            since_m = float(history.odometer_m[first - 1])
        if since_m is not None and history.odometer_m[first] - since_m <= NEW_WITHIN_M:
            new.append(number)
    return tuple(new)
