"""Prognoses of vehicles: rows of the database become results again, and those a prognosis and the days it is due."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any, Final

from sqlalchemy import Engine

from clutch_model.calibration import FrictionCurve
from clutch_results.event_kinds import EventKind
from clutch_results.pictures import MOST_POINTS, UNFORETOLD, Fan, fan_of
from clutch_results.prognosis import (
    Common,
    History,
    Population,
    Prognosis,
    history_of_estimates,
    prognose,
    without,
)
from clutch_results.prognosis.prognosis import Reach
from clutch_results.prognosis.sentence import least_left_m, outlook_line, soonest
from clutch_results.records import (
    ClutchVerdict,
    Condition,
    EventConditions,
    EventFit,
    FluidFill,
    FrictionEstimate,
    ScaleFreeFriction,
    ShiftEstimate,
    ShiftResult,
    Status,
    Tier,
    from_plain,
    iso_utc,
)
from clutchdiag_io.people import is_dated
from fleet_backend.ageing.calibrations import reference_of, type_of
from fleet_backend.ageing.records import ClutchNow, Due, Fill
from fleet_backend.ageing.results import fills_of, friction_in, in_order, indices_in, quality_in, results_of, words_in
from fleet_backend.queries import Row, distances_of
from fleet_backend.schema import RUNNING, SCALE_FREE, SCALE_FREE_COLUMNS
from fleet_contract.orders import Action

SERVICE_M: Final = 1.5e7  # to the next service, if nobody says
LOOKED_BACK: Final = timedelta(days=90)  # over which it is counted how much a vehicle is driven
LEAST: Final = timedelta(days=1)
_HORIZON: Final = timedelta(days=3653)
_KINDS: Final = frozenset(EventKind)
_TIERS: Final = frozenset(Tier)
_SAME_IN_ROWS: Final = ("number", "from_gear", "to_gear", "clutch")  # of an estimate
NO_PROGNOSIS: Final = (
    "No prognosis: its service has not told what calibration these results are of, or their numbers are of no clutch."
)
NOT_YET: Final = "Not foretold yet: fleet-backend watch does so."
UNTOLD_OUTLOOK: Final = "Nothing is foretold of it."
_NOTHING: Final = dict.fromkeys(("half_by", "most_by", "distance_a_day_m", "least_left_m")) | {"outlook": NOT_YET}
# What calculations raise of numbers that keep the contract and are of no clutch; a LinAlgError is a ValueError.
BEYOND_NUMBERS: Final = (ArithmeticError, ValueError)


def estimate_of(row: Row) -> ShiftEstimate:
    """Return what one event said of the friction; what no prognosis asks for is left out."""
    return ShiftEstimate(
        **{name: row[name] for name in _SAME_IN_ROWS},
        conditions=from_plain(row, EventConditions),
        fit=from_plain(row, EventFit),
        start_ns=row["start_bus_ns"],
        end_ns=row["end_bus_ns"],
        status=Status(row["status"]),
        reasons=(),
        friction=_friction(row, ""),
        scale_free=_scale_free(row),
        kind=EventKind(row["kind"]) if row["kind"] in _KINDS else EventKind.SHIFT,  # newer programs may know more
        shift_quality=quality_in(row),
        tier=Tier(row["tier"]) if row["tier"] in _TIERS else Tier.FRICTION,
        indices=indices_in(row),
    )


def _scale_free(row: Row) -> ScaleFreeFriction | None:
    """Return what driving alone tells of the friction; of rows that do not know it, their random part stands for it."""
    if row["mu_c"] is None:
        return None
    if row[f"{SCALE_FREE}correlation"] is not None:
        return ScaleFreeFriction(**{name: row[SCALE_FREE + name] for name in SCALE_FREE_COLUMNS})
    return ScaleFreeFriction(
        mu_c=row["mu_c"],
        mu_s=row["mu_s"],
        std_mu_c=row["random_std_mu_c"],
        std_mu_s=row["random_std_mu_s"],
        correlation=row["correlation"],
    )


def _friction(row: Row, prefix: str) -> FrictionEstimate | None:
    friction = friction_in(row, prefix)
    return None if friction is None else FrictionEstimate(**friction)


def result_in(row: Row, estimate: ShiftEstimate) -> ShiftResult:
    """Return a row as the service had it, as far as charts and tables of shifting ask for it."""
    verdict = ClutchVerdict(
        clutch=row["clutch"],
        condition=Condition[row["condition"].upper()],
        reason="",
        level_ratio=row["level_ratio"],
        friction=_friction(row, RUNNING),
        shift_count=0,
        element=row["element"],
    )
    names = ("vehicle", "stream", "seq", "algorithm_version", "calibration_version")
    origin = {name: row[name] for name in names}
    return ShiftResult(estimate=estimate, verdict=verdict, produced_at="", **origin)


def known_history(
    clutch: int,
    rows: Sequence[Row],
    estimates: Sequence[ShiftEstimate],
    fills: Sequence[Fill],
    common: Mapping[str, Common],
) -> tuple[History, FrictionCurve, str] | None:
    """Return what a prognosis rests on: history, friction with new fluid, and vehicle type.

    ``rows`` are the results of the clutch, the oldest first, and ``estimates`` the same as records; what clutches of
    one type have in ``common`` is taken out of the history. None: the calibration is not known, or the numbers are of
    no clutch.
    """
    if not rows:
        return None
    vehicle, calibration = rows[-1]["vehicle"], rows[-1]["calibration_version"]
    reference, vehicle_type = reference_of(vehicle, calibration, clutch), type_of(vehicle, calibration)
    if reference is None:
        return None
    same = [
        estimate for row, estimate in zip(rows, estimates, strict=True) if row["calibration_version"] == calibration
    ]
    try:
        history = history_of_estimates(same, [fluid_fill(vehicle, fill) for fill in fills], clutch)
        return without(history, common.get(vehicle_type)), reference, vehicle_type
    except BEYOND_NUMBERS:
        return None


def fluid_fill(vehicle: str, fill: Fill) -> FluidFill:
    """Return a fill of the database as the diagnosis knows it."""
    return FluidFill(
        vehicle=vehicle,
        filled_at=iso_utc(fill.filled_at),
        odometer_m=fill.odometer_m,
        product=fill.product,
        note=fill.note,
    )


def outlook_text(prognoses: Iterable[Prognosis | None], first: ClutchNow) -> str:
    """Return how far the fluid of a vehicle will go, for pages and alarms."""
    known = [prognosis for prognosis in prognoses if prognosis is not None]
    return outlook_line(known, Action(first.action), first.element) if known else NO_PROGNOSIS


def chance_of(prognosis: Prognosis) -> float | None:
    """Return how likely an ageing fluid reaches its limit before the next service; None: it shows no trend."""
    reach = soonest([prognosis])
    return None if reach is None else reach.probability_before_service


_POINT_COLUMNS: Final = (  # of a row
    *("vehicle", "clutch", "end_at", "odometer_m", "kind", "status", "mu_c", "std_mu_c", "random_std_mu_c", "mu_s"),
    *("std_mu_s", "running_mu_c", "running_std_mu_c", "running_mu_s", "running_std_mu_s", "running_correlation"),
    *("level_ratio", "condition", "stream", "seq", "algorithm_version", "calibration_version"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchPast:
    """The past of a clutch, the oldest event first, and how far its fluid will go; None: that cannot be told."""

    rows: Sequence[Row]
    estimates: tuple[ShiftEstimate, ...]
    prognosis: Prognosis | None

    def trend(self, most: int | None = None) -> list[Row]:
        """Return the newest events and the running estimate after each, the oldest first; by default all."""
        first = 0 if most is None else max(len(self.rows) - most, 0)
        return list(map(_point_of, self.rows[first:], self.estimates[first:]))


def read_past(
    engine: Engine, now: ClutchNow, fills: Sequence[Fill], service_distance_m: float, population: Population | None
) -> ClutchPast:
    """Read the past of a clutch, and work out how far its fluid will go; the population says what is usual."""
    rows = results_of(engine, now.vehicle, now.clutch)
    estimates, prognosis = tuple(map(estimate_of, rows)), None
    known = known_history(now.clutch, rows, estimates, fills, {} if population is None else population.common)
    if known is not None:
        history, reference, vehicle_type = known
        fluid = fills[-1].product if fills else None
        peers = None if population is None else population.of(vehicle_type, fluid)
        with suppress(*BEYOND_NUMBERS):
            prognosis = prognose(now.clutch, history, reference, service_distance_m=service_distance_m, peers=peers)
    return ClutchPast(rows=rows, estimates=estimates, prognosis=prognosis)


def _point_of(row: Row, estimate: ShiftEstimate) -> Row:
    quality = estimate.shift_quality
    point = {name: row[name] for name in _POINT_COLUMNS}
    return point | {"reasons": words_in(row), "score": None if quality is None else quality.score}


def outlook_answer(past: ClutchPast) -> dict[str, Any] | None:
    """Return the prognosis of a clutch as pages and programs read it; of all its results, those of no use included."""
    prognosis = past.prognosis
    if prognosis is None:
        return None
    names = ("clutch", "outlook", "row_count", "left_out_count", "service_distance_m")
    return {name: getattr(prognosis, name) for name in names} | {
        "watch": _reach(prognosis.watch),
        "change_fluid": _reach(prognosis.change_fluid),
        "assumptions": [*prognosis.assumptions, *_left_out(past.rows)],
    }


def _reach(reach: Reach | None) -> dict[str, float | None] | None:
    names = ("p10_m", "p50_m", "p90_m", "probability_before_service")
    return None if reach is None else {name: getattr(reach, name) for name in names}


def _drawn(past: ClutchPast, calibration: str) -> list[tuple[Row, ShiftEstimate]]:
    """Return the results of one calibration that a chart shows: at most about `MOST_POINTS` of a clutch, evenly spread.

    The last one is among them, and each whose verdict differs from the one before.
    """
    results = zip(past.rows, past.estimates, strict=True)
    same = [(row, estimate) for row, estimate in results if row["calibration_version"] == calibration]
    step = 1 + (len(same) - 1) // MOST_POINTS
    before = [row["condition"] for row, _ in same[:1] + same]
    return [
        (row, estimate)
        for place, (row, estimate) in enumerate(same, 1)
        if (len(same) - place) % step == 0 or row["condition"] != before[place - 1]
    ]


def fan_of_vehicle(
    clutches: Sequence[ClutchNow], pasts: Sequence[ClutchPast], fills: Sequence[Fill], alarms: Sequence[Row]
) -> Fan | None:
    """Return the fan chart of a vehicle as its report has it; None where no margin is known."""
    now = clutches[0]
    drawn = [result for past in pasts for result in _drawn(past, now.calibration_version)]
    estimates, rows = {id(row): estimate for row, estimate in drawn}, [row for row, _ in drawn]
    numbers = range(1, 1 + max(clutch.clutch for clutch in clutches))
    new = [reference_of(now.vehicle, now.calibration_version, clutch) for clutch in numbers]
    if not rows or None in new:
        return None
    try:
        return fan_of(
            [result_in(row, estimates[id(row)]) for row in in_order(rows)],
            [fluid_fill(now.vehicle, fill) for fill in fills],
            [curve for curve in new if curve is not None],
            [past.prognosis for past in pasts if past.prognosis is not None],
            is_foretold=now.action not in UNFORETOLD,
            alarms=[(iso_utc(alarm["raised_at"]), f"alarm: {alarm['rule']}") for alarm in alarms],
        )
    except BEYOND_NUMBERS:
        return None


def _left_out(rows: Sequence[Row]) -> Iterator[str]:
    same_count = sum(row["calibration_version"] == rows[-1]["calibration_version"] for row in rows)
    if same_count < len(rows):
        yield f"{len(rows) - same_count} results of other calibrations are left out"
    assumed = sum(row["mu_c"] is not None and row[f"{SCALE_FREE}correlation"] is None for row in rows)
    if assumed:
        yield f"in {assumed} results of older programs random errors of mu_C and mu_S correlate as the whole ones do"


def foretold_now(engine: Engine, clutches: Sequence[ClutchNow], population: Population | None) -> list[Row]:
    """Read the past of a vehicle, and return when its fluids are due, a row per clutch."""
    fills = fills_of(engine, clutches[0].vehicle)
    return foretold(clutches, [read_past(engine, now, fills, SERVICE_M, population) for now in clutches])


def foretold(clutches: Sequence[ClutchNow], pasts: Sequence[ClutchPast]) -> list[Row]:
    """Return when the fluid of a vehicle is due, a row per clutch; by both prognoses, as both slip in one oil."""
    prognoses = [past.prognosis for past in pasts]
    known = [prognosis for prognosis in prognoses if prognosis is not None]
    reach = soonest(known)
    tells_friction = all(now.tells_friction for now in clutches)
    if clutches[0].action == Action.FIND_CAUSE or not tells_friction:
        reach = None
    quantiles = (None, None, None) if reach is None else (reach.p10_m, reach.p50_m, reach.p90_m)
    rows = list[Row]()
    for now, past in zip(clutches, pasts, strict=True):
        a_day_m = driven_a_day_m((row["end_at"], row["odometer_m"]) for row in past.rows)
        due_from, half_by, most_by = (_day(now, distance_m, a_day_m) for distance_m in quantiles)
        rows.append(
            {
                "vehicle": now.vehicle,
                "clutch": now.clutch,
                "action": now.action,
                "fluid_since": now.fluid_since,
                "due_from": due_from,
                "half_by": half_by,
                "most_by": most_by,
                "distance_a_day_m": a_day_m,
                "least_left_m": least_left_m(known, Action(now.action)) if tells_friction else None,
                "outlook": outlook_text(prognoses, now) if tells_friction else UNTOLD_OUTLOOK,
            }
        )
    return rows


def days_of(now: ClutchNow, row: Row | None, today: date) -> tuple[bool, date | None]:
    """Return whether a fluid is overdue, more probably than not, and from which day it is due."""
    if now.action == Action.CHANGE_NOW:
        return True, today
    return (False, None) if row is None else (row["half_by"] is not None and row["half_by"] < today, row["due_from"])


def due_of(now: ClutchNow, row: Row | None, today: date) -> Due:
    """Return when a fluid is due by its row of the table; None: it is not foretold yet."""
    due_row, is_now = _NOTHING if row is None else row, now.action == Action.CHANGE_NOW
    is_overdue, first = days_of(now, row, today)
    half, most = (today if is_now else due_row[name] for name in ("half_by", "most_by"))
    left_m, least_left_m = distances_of(now.action, now.end_at, row)
    return Due(
        vehicle=now.vehicle,
        clutch=now.clutch,
        element=now.element,
        condition=now.condition,
        is_overdue=is_overdue,
        due_from=first,
        half_by=half,
        most_by=most,
        left_m=left_m,
        least_left_m=least_left_m,
        distance_a_day_m=due_row["distance_a_day_m"],
        text=f"{now.order} {due_row['outlook']}",
    )


def driven_a_day_m(readings: Iterable[tuple[datetime, float | None]]) -> float | None:
    """Return the distance that a vehicle is driven a day, None if it is not known; readings come in their order."""
    known = [(at, odometer_m) for at, odometer_m in readings if odometer_m is not None and is_dated(at)]
    if not known:
        return None
    last_at, last_m = known[-1]
    first_at, first_m = next((at, odometer_m) for at, odometer_m in known if last_at - at <= LOOKED_BACK)
    if last_at - first_at < LEAST or last_m <= first_m:
        return None
    return (last_m - first_m) * (timedelta(days=1) / (last_at - first_at))


def _day(now: ClutchNow, distance_m: float | None, a_day_m: float | None) -> date | None:
    if distance_m is None or a_day_m is None or not is_dated(now.end_at) or distance_m > a_day_m * _HORIZON.days:
        return None
    return (now.end_at + timedelta(days=distance_m / a_day_m)).date()
