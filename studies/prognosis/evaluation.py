"""One life after another: what was foretold at some ages, what was said too early, which fills were found."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.condition.verdict import CHANGE_PROBABILITY
from diag_service.diagnosis.prognosis import Passage, prognose
from diag_service.diagnosis.prognosis.changes import fluid_starts
from studies.prognosis.baselines import FARTHEST_KM, PROBABILITIES, fixed_interval, fleet, logistic_index, whole_line
from studies.prognosis.lives import DRIVEN_KM, KM_PER_YEAR, REFERENCE, Life

MARKS: Final = (0.25, 0.5, 0.75)
LATE_MARKS: Final = (0.8, 0.85, 0.9, 0.95)
LOOK_KM: Final = 7_500.0  # every half year somebody asks whether the fluid has to be changed now
LATEST_KM: Final = 10_000.0  # after the limit, when it should have been said
FOUND_WITHIN: Final = 15  # results after a forgotten fill
M_PER_KM: Final = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """What was said at one age of one fluid, and what was true: distances until the change is due [km]."""

    stratum: StrEnum
    mark: float
    life_km: float
    left_km: float
    passed: float  # probability that was given to the truth's side
    methods: tuple[FloatArray, ...]  # quantiles: ours, then the baselines in the order of `METHODS`

    @property
    def median_km(self) -> float:
        """Ours."""
        return float(np.median(self.methods[0]))


METHODS: Final = ("prognosis", "fixed interval", "whole line", "logistic index", "fleet")


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """What one life adds to the counts."""

    forecasts: tuple[Forecast, ...]
    years: float  # driven before the change was due
    early_count: int  # times that "change now" was said in them
    is_told: bool | None  # whether it is said when overdue; None: the life ends before
    found_rows: int | None  # results from a forgotten fill to its finding; None: there was none
    is_lost: bool  # there was one, and it was not found in time
    false_count: int  # fills found that never were
    all_years: float


def account_of(life: Life, lives_km: FloatArray) -> Account:
    """Return the account of a life; the fleet baseline knows the lives of others."""
    forecasts = tuple(_forecasts(life, lives_km))
    overdue_km = life.change_km + LATEST_KM
    found_rows, false_count = found_fills(life)
    return Account(
        forecasts=forecasts,
        years=min(life.change_km, DRIVEN_KM) / KM_PER_YEAR,
        early_count=early_looks(life),
        is_told=_is_due(life, overdue_km) if overdue_km < DRIVEN_KM else None,
        found_rows=found_rows,
        is_lost=life.forgotten_km is not None and found_rows is None,
        false_count=false_count,
        all_years=DRIVEN_KM / KM_PER_YEAR,
    )


def early_looks(life: Life) -> int:
    """Return how often "change now" was said anew before it was due."""
    looks = [km for km in np.arange(LOOK_KM, DRIVEN_KM, LOOK_KM).tolist() if km < life.change_km]
    said = [_is_due(life, km) for km in looks]
    return sum(now and not before for before, now in zip([False, *said], said, strict=False))


def passage_at(life: Life, odometer_km: float) -> Passage | None:
    """Return what is said of the change of the fluid at an odometer."""
    history = life.history.first(life.rows_until(odometer_km))
    found = prognose(1, history, REFERENCE)
    return None if found.change_fluid is None else found.change_fluid.passage


def _is_due(life: Life, odometer_km: float) -> bool:
    when = passage_at(life, odometer_km)
    return when is not None and when.within(0.0) >= CHANGE_PROBABILITY


def _forecasts(life: Life, lives_km: FloatArray) -> list[Forecast]:
    forecasts = []
    for mark in (*MARKS, *LATE_MARKS):
        odometer_km = life.begin_km + mark * life.life_km
        when = passage_at(life, odometer_km) if odometer_km < DRIVEN_KM else None
        if when is None:
            continue
        history = life.history.first(life.rows_until(odometer_km))
        left_km = min(life.change_km - odometer_km, FARTHEST_KM)
        age_km = odometer_km - (0.0 if life.forgotten_km is not None else life.begin_km)
        forecasts.append(
            Forecast(
                stratum=life.stratum,
                mark=mark,
                life_km=life.life_km,
                left_km=left_km,
                passed=when.within(left_km * M_PER_KM),
                methods=(
                    when.quantiles_m(PROBABILITIES) / M_PER_KM,
                    fixed_interval(age_km),
                    whole_line(history),
                    logistic_index(history),
                    fleet(age_km, lives_km),
                ),
            )
        )
    return forecasts


def found_fills(life: Life) -> tuple[int | None, int]:
    """Return with which result after it a forgotten fill is found, if in time, and how many found ones never were."""
    whole = [start for start in fluid_starts(life.history) if not start.is_noted]
    if life.forgotten_km is None:
        return None, len(whole)
    filled = life.rows_until(life.forgotten_km)
    in_time = fluid_starts(life.history.first(filled + FOUND_WITHIN))
    near = [start for start in in_time if not start.is_noted and start.noticed_row >= filled]
    wrong = [start for start in whole if abs(start.row - filled) > FOUND_WITHIN]
    return (near[0].noticed_row - filled + 1 if near else None), len(wrong)
