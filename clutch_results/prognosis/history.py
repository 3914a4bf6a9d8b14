"""The past of one clutch as columns: a row per event of which the friction is known."""

from collections.abc import Iterable, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from math import isfinite
from typing import Any, Final, Self

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_results.event_kinds import DATED_NS
from clutch_results.prognosis.assumptions import NEW_WITHIN_M
from clutch_results.records import FluidFill, ShiftEstimate, ShiftResult, Status, utc_from_bus_ns

NS_PER_S: Final = 1e9
MAX_CORRELATION: Final = 0.999
TAKEN_UP_AFTER: Final = 5  # readings of another odometer that agree with each other
FASTEST_M_S: Final = 70.0  # 250 km/h, all day
UNSEEN_M: Final = 1.0e8  # 100,000 km: driven while a clock stood still or was wrong


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
    fluid_number: Int64Array  # of the fluid, counted by the fills that are known; never falls
    new_fluids: tuple[int, ...] = ()  # numbers of the fluids that were new when first seen
    left_out_count: int = 0  # used events that miss something or whose odometer cannot be true
    is_stale: bool = False  # some results came after the last row, and none of them can be used
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
        return len(self.odometer_m)

    def first(self, count: int) -> Self:
        """Return the history as it was after so many rows."""
        columns = {name: getattr(self, name) for name in _COLUMNS}
        known: dict[str, Any] = {name: column[:count] for name, column in columns.items() if column is not None}
        return replace(self, **known, is_fluid_newer=False, is_stale=False)


_COLUMNS: Final = tuple(column.name for column in fields(History) if column.default is MISSING)


def history_of(results: Iterable[ShiftResult], fills: Sequence[FluidFill], clutch: int) -> History:
    """Return the past of clutch 1 or 2 from stored results, in whatever order those with a date are.

    Events of which the friction is not known are no rows. Known ones without odometer or oil temperature, and those
    whose odometer cannot be true, are left out and counted.
    """
    return history_of_estimates((result.estimate for result in results), fills, clutch)


def history_of_estimates(estimates: Iterable[ShiftEstimate], fills: Sequence[FluidFill], clutch: int) -> History:
    """Return the same from the estimates alone, which is all that a past is made of."""
    of_clutch = [estimate for estimate in estimates if estimate.clutch == clutch]
    of_clutch.sort(key=lambda estimate: max(estimate.end_ns, DATED_NS))
    usable: list[dict[str, float]] = []
    valid_count = unused_count = 0  # the latter since the last event that is used
    for number, estimate in enumerate(of_clutch, start=1):
        if estimate.status is not Status.VALID:
            continue
        valid_count += 1
        row = _row(estimate)
        if row is not None:
            fluid_number = sum(fill.filled_at <= utc_from_bus_ns(estimate.start_ns) for fill in fills)
            usable.append(row | {"number": float(number), "fluid_number": fluid_number})
        unused_count = 0 if row is not None else unused_count + 1
    rows, dropped_count = _plausible(usable)
    unused_count += dropped_count
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows], np.float64) for name in _COLUMNS}
    columns["fluid_number"] = columns["fluid_number"].astype(np.int64)
    energy_j = _energies(columns.pop("slip_energy_j"))
    history = History(
        **columns,
        slip_energy_j=energy_j,
        left_out_count=valid_count - len(rows),
        is_stale=len(rows) > 0 and unused_count >= TAKEN_UP_AFTER,
    )
    is_newer = len(fills) > (history.fluid_number[-1] if len(history) else 0)
    return replace(history, new_fluids=_new_fluids(history, fills), is_fluid_newer=bool(is_newer))


def _plausible(rows: Sequence[dict[str, float]]) -> tuple[list[dict[str, float]], int]:
    """Return the rows whose odometer can be true, as one distance that never falls, and how many were left out last.

    A reading that goes back, or ahead faster than any vehicle, is left out. `TAKEN_UP_AFTER` of them that agree with
    each other are another instrument cluster: the distance goes on from where it was. Fewer before them that they
    contradict are dropped.
    """
    kept: list[dict[str, float]] = []
    run: list[dict[str, float]] = []  # of one instrument, as it was read
    other: list[dict[str, float]] = []  # what contradicts it
    offset_m = 0.0
    for row in rows:
        if not run or _follows(run[-1], row):
            run.append(row)
            kept.append(row | {"odometer_m": row["odometer_m"] + offset_m})
            other = []
            continue
        other = [*other, row] if other and _follows(other[-1], row) else [row]
        if len(other) == TAKEN_UP_AFTER:
            wrong_count = _wrong_at_the_end(run, other[0])
            del kept[len(kept) - wrong_count :]
            if wrong_count == len(run) or not _follows(run[-1 - wrong_count], other[0]):
                offset_m = kept[-1]["odometer_m"] - other[0]["odometer_m"] if kept else 0.0
            kept += [row | {"odometer_m": row["odometer_m"] + offset_m} for row in other]
            run, other = other, []
    last = kept[-1]["number"] if kept else 0.0
    return kept, sum(row["number"] > last for row in rows)


def _wrong_at_the_end(run: Sequence[dict[str, float]], later: dict[str, float]) -> int:
    """Return how many readings, the last of a run, have to go for another to follow; 0 where these are a run, too."""
    most = min(len(run), TAKEN_UP_AFTER - 1)
    fitting = (count for count in range(1, most + 1) if count == len(run) or _follows(run[-1 - count], later))
    return next(fitting, 0)


def _follows(earlier: dict[str, float], later: dict[str, float]) -> bool:
    """Return whether a vehicle can have gone from one reading of its odometer to another."""
    distance_m = later["odometer_m"] - earlier["odometer_m"]
    return 0.0 <= distance_m <= UNSEEN_M + FASTEST_M_S * (later["end_s"] - earlier["end_s"])


def _row(estimate: ShiftEstimate) -> dict[str, float] | None:
    """Return what is known of one event, the parts of its errors apart; None if something is missing."""
    known, free, at = estimate.friction, estimate.scale_free, estimate.conditions
    if known is None or free is None or at.odometer_m is None or at.sump_temperature_k is None:
        return None
    random_c, random_s = known.random_std_mu_c, known.random_std_mu_s
    common_c = max(known.std_mu_c**2 - random_c**2, 0.0) ** 0.5
    common_s = max(known.std_mu_s**2 - random_s**2, 0.0) ** 0.5
    shared = known.correlation * known.std_mu_c * known.std_mu_s - free.correlation * random_c * random_s
    both = common_c * common_s
    energy_j = at.slip_energy_j
    row = {
        "end_s": estimate.end_ns / NS_PER_S,
        "odometer_m": at.odometer_m,
        "mu_c": known.mu_c,
        "mu_s": known.mu_s,
        "random_std_mu_c": random_c,
        "random_std_mu_s": random_s,
        "random_correlation": free.correlation,
        "common_std_mu_c": common_c,
        "common_std_mu_s": common_s,
        "common_correlation": min(max(shared / both, -MAX_CORRELATION), MAX_CORRELATION) if both else 0.0,
        "sump_temperature_k": at.sump_temperature_k,
    }
    if not all(map(isfinite, row.values())) or min(random_c, random_s) <= 0.0:
        return None
    return row | {"slip_energy_j": -1.0 if energy_j is None else energy_j}


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
        if first:  # it was filled after the row before, also where nobody noted the odometer or it was another one
            since_m = max(since_m or 0.0, float(history.odometer_m[first - 1]))
        if since_m is not None and history.odometer_m[first] - since_m <= NEW_WITHIN_M:
            new.append(number)
    return tuple(new)


def robust_noise_ratio(value: FloatArray, std: FloatArray) -> float:
    """Return how much larger the noise is than stated, at least 1; outliers and trends do not count."""
    if len(value) < 8:
        return 1.0
    steps = np.diff(value) / np.hypot(std[1:], std[:-1])
    return max(1.0, 1.4826 * float(np.median(np.abs(steps))))
