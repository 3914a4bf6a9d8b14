"""Where the fleet meets the pure diagnosis: rows of the database become results again, and those a prognosis."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import date, datetime, timedelta
from typing import Final

import msgspec
from sqlalchemy import Engine

from clutch_model.calibration import FrictionCurve
from clutch_results.event_kinds import EventKind
from clutch_results.pictures import UNFORETOLD, Fan, fan_of
from clutch_results.prognosis import (
    Forecast,
    History,
    Peers,
    Prognosis,
    forecast,
    history_of_estimates,
    prognose,
    without,
)
from clutch_results.prognosis.sentence import outlook_line, soonest
from clutch_results.records import (
    ClutchVerdict,
    Condition,
    FluidFill,
    FrictionEstimate,
    ScaleFreeFriction,
    ShiftEstimate,
    ShiftQuality,
    ShiftResult,
    Status,
    iso_utc,
)
from clutchdiag_io.people import is_dated
from fleet_backend.page.calibrations import reference_of, type_of
from fleet_backend.page.populations import StoredPopulation, latest
from fleet_backend.page.queries import fills_of, friction_in, in_order, record_in, results_of, words_in
from fleet_backend.page.records import Alarm, ClutchNow, Due, Fill, OutlookAnswer, TrendPoint
from fleet_backend.queries import Row
from fleet_backend.schema import RUNNING, SCALE_FREE, SCALE_FREE_COLUMNS
from fleet_contract.orders import Action

SERVICE_M: Final = 1.5e7  # to the next service, if nobody says
LOOKED_BACK: Final = timedelta(days=90)  # over which it is counted how much a vehicle is driven
LEAST: Final = timedelta(days=1)
_HORIZON: Final = timedelta(days=3653)
_KINDS: Final = frozenset(EventKind)
_SAME_IN_ROWS: Final = (  # of an estimate
    *("number", "from_gear", "to_gear", "clutch", "sample_count", "window_s", "chi_square_ratio", "quality"),
    *("sump_temperature_k", "clutch_temperature_k", "slip_energy_j", "duration_s", "odometer_m"),
)
NO_PROGNOSIS: Final = (
    "No prognosis: its service has not told what calibration these results are of, or their numbers are of no clutch."
)
NOT_YET: Final = "Not foretold yet: fleet-backend watch does so."
_NOTHING: Final = dict.fromkeys(("half_by", "most_by", "distance_a_day_m")) | {"outlook": NOT_YET}
# What calculations raise of numbers that keep the contract and are of no clutch; a LinAlgError is a ValueError.
BEYOND_NUMBERS: Final = (ArithmeticError, ValueError)


def estimate_of(row: Row) -> ShiftEstimate:
    """Return what one event said of the friction; what no prognosis asks for is left out."""
    return ShiftEstimate(
        **{name: row[name] for name in _SAME_IN_ROWS},
        start_ns=row["start_bus_ns"],
        end_ns=row["end_bus_ns"],
        status=Status(row["status"]),
        reasons=(),
        friction=_friction(row, ""),
        scale_free=_scale_free(row),
        kind=EventKind(row["kind"]) if row["kind"] in _KINDS else EventKind.SHIFT,  # newer programs may know more
        shift_quality=record_in(row, "shift_quality", ShiftQuality),
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
    told = friction_in(row, prefix)
    return None if told is None else FrictionEstimate(**told)


def _result_of(row: Row, estimate: ShiftEstimate) -> ShiftResult:
    """Return a row as the service had it, as far as the fan chart asks for it."""
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
    told = {name: row[name] for name in names}
    return ShiftResult(estimate=estimate, verdict=verdict, produced_at=iso_utc(row["produced_at"]), **told)


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """What a prognosis of one clutch rests on."""

    history: History
    reference: FrictionCurve
    peers: Peers | None


def _basis(
    clutch: int,
    rows: Sequence[Row],
    estimates: Sequence[ShiftEstimate],
    fills: Sequence[Fill],
    kept: StoredPopulation | None,
) -> Basis | None:
    vehicle, calibration = rows[-1]["vehicle"], rows[-1]["calibration_version"]
    reference, vehicle_type = reference_of(vehicle, calibration, clutch), type_of(vehicle, calibration)
    if reference is None:
        return None
    same = [one for row, one in zip(rows, estimates, strict=True) if row["calibration_version"] == calibration]
    try:
        past = history_of_estimates(same, [fluid_fill(vehicle, one) for one in fills], clutch)
        if kept is None:
            return Basis(history=past, reference=reference, peers=None)
        past = without(past, kept.population.common.get(vehicle_type))
    except BEYOND_NUMBERS:
        return None
    peers = kept.population.of(vehicle_type, fills[-1].product if fills else None)
    return Basis(history=past, reference=reference, peers=peers)


def _prognosis(clutch: int, basis: Basis | None, service_distance_m: float) -> Prognosis | None:
    if basis is None:
        return None
    try:
        return prognose(
            clutch, basis.history, basis.reference, service_distance_m=service_distance_m, peers=basis.peers
        )
    except BEYOND_NUMBERS:
        return None


def outlook_of(
    clutch: int,
    rows: Sequence[Row],
    estimates: Sequence[ShiftEstimate],
    fills: Sequence[Fill],
    service_distance_m: float,
    kept: StoredPopulation | None,
) -> Prognosis | None:
    """Return how far the fluid of a clutch will go; None: that cannot be told.

    ``rows`` are its results, the oldest first, and ``estimates`` what they say. It begins with the population that was
    kept last.
    """
    basis = _basis(clutch, rows, estimates, fills, kept) if rows else None
    return _prognosis(clutch, basis, service_distance_m)


def fluid_fill(vehicle: str, fill: Fill) -> FluidFill:
    """Return a fill of the database as the diagnosis knows it."""
    return FluidFill(
        vehicle=vehicle,
        filled_at=iso_utc(fill.filled_at),
        odometer_m=fill.odometer_m,
        product=fill.product,
        note=fill.note,
    )


def outlook_text(founds: Iterable[Prognosis | None], first: ClutchNow) -> str:
    """Return how far the fluid of a vehicle will go, by what is foretold of each clutch; made for pages and alarms."""
    known = [found for found in founds if found is not None]
    return outlook_line(known, Action(first.action), first.element) if known else NO_PROGNOSIS


def chance_of(found: Prognosis) -> float | None:
    """Return how likely an ageing fluid reaches its limit before the next service; None: it shows no trend."""
    first = soonest([found])
    return None if first is None else first.probability_before_service


_POINT_NAMES: Final = tuple(field.name for field in fields(TrendPoint))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchPast:
    """The past of a clutch, the oldest event first, and what follows from it."""

    rows: Sequence[Row]
    estimates: tuple[ShiftEstimate, ...]
    basis: Basis | None
    prognosis: Prognosis | None

    @property
    def trend(self) -> tuple[TrendPoint, ...]:
        return tuple(map(_point_of, self.rows, self.estimates))


def read_past(engine: Engine, now: ClutchNow, fills: Sequence[Fill], service_distance_m: float) -> ClutchPast:
    """Read the past of a clutch, and work out how far its fluid will go."""
    rows = results_of(engine, now.vehicle, now.clutch)
    estimates = tuple(map(estimate_of, rows))
    basis = _basis(now.clutch, rows, estimates, fills, latest(engine)) if rows else None
    found = _prognosis(now.clutch, basis, service_distance_m)
    return ClutchPast(rows=rows, estimates=estimates, basis=basis, prognosis=found)


def _point_of(row: Row, estimate: ShiftEstimate) -> TrendPoint:
    quality = estimate.shift_quality
    told = {**row, "reasons": words_in(row), "score": None if quality is None else quality.score}
    return TrendPoint(**{name: told[name] for name in _POINT_NAMES})


def outlook_answer(past: ClutchPast) -> OutlookAnswer | None:
    """Return the prognosis of a clutch as pages and programs read it; of all its results, those of no use included."""
    if past.prognosis is None:
        return None
    found = replace(past.prognosis, assumptions=(*past.prognosis.assumptions, *_left_out(past.rows)))
    return msgspec.convert(found, OutlookAnswer, from_attributes=True)


def fan_of_vehicle(
    clutches: Sequence[ClutchNow], pasts: Sequence[ClutchPast], fills: Sequence[Fill], alarms: Sequence[Alarm]
) -> Fan | None:
    """Return the fan chart of a vehicle as its report has it; None where no margin is known."""
    now = clutches[0]
    told = {id(row): estimate for past in pasts for row, estimate in zip(past.rows, past.estimates, strict=True)}
    rows = [row for past in pasts for row in past.rows if row["calibration_version"] == now.calibration_version]
    results = [_result_of(row, told[id(row)]) for row in in_order(rows)]
    known = {one.clutch: past.basis for one, past in zip(clutches, pasts, strict=True)}

    def foretell(clutch: int) -> Forecast | None:
        basis = known[clutch]
        return None if basis is None else forecast(basis.history, basis.reference, peers=basis.peers)

    numbers = range(1, 1 + max(known))
    new = [reference_of(now.vehicle, now.calibration_version, clutch) for clutch in numbers]
    if not results or None in new:
        return None
    try:
        return fan_of(
            results,
            [fluid_fill(now.vehicle, one) for one in fills],
            [one for one in new if one is not None],
            [past.prognosis for past in pasts if past.prognosis is not None],
            foretell=None if now.action in UNFORETOLD else foretell,
            alarms=[(iso_utc(one.raised_at), f"alarm: {one.rule}") for one in alarms],
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


def foretold_now(engine: Engine, clutches: Sequence[ClutchNow]) -> list[Row]:
    """Read the past of a vehicle, and return when its fluids are due, a row per clutch."""
    fills = fills_of(engine, clutches[0].vehicle)
    pasts = [read_past(engine, now, fills, SERVICE_M) for now in clutches]
    founds = [past.prognosis for past in pasts]
    readings = [[(row["end_at"], row["odometer_m"]) for row in past.rows] for past in pasts]
    return [foretold(now, founds, own) for now, own in zip(clutches, readings, strict=True)]


def foretold(
    now: ClutchNow, founds: Sequence[Prognosis | None], readings: Iterable[tuple[datetime, float | None]]
) -> Row:
    """Return when a fluid is due, as a row of the table; by the prognoses of all clutches: they slip in one oil."""
    a_day_m = driven_a_day_m(readings)
    reach = None if now.action == Action.FIND_CAUSE else soonest(one for one in founds if one is not None)
    quantiles = (None, None, None) if reach is None else (reach.p10_m, reach.p50_m, reach.p90_m)
    first, half, most = (_day(now, distance_m, a_day_m) for distance_m in quantiles)
    return {
        "vehicle": now.vehicle,
        "clutch": now.clutch,
        "action": now.action,
        "fluid_since": now.fluid_since,
        "due_from": first,
        "half_by": half,
        "most_by": most,
        "distance_a_day_m": a_day_m,
        "outlook": outlook_text(founds, now),
    }


def days_of(now: ClutchNow, row: Row | None, today: date) -> tuple[bool, date | None]:
    """Return whether a fluid is overdue, more probably than not, and from which day it is due."""
    if now.action == Action.CHANGE_NOW:
        return True, today
    return (False, None) if row is None else (row["half_by"] is not None and row["half_by"] < today, row["due_from"])


def due_of(now: ClutchNow, row: Row | None, today: date) -> Due:
    """Return when a fluid is due by what was foretold of it; None: nothing was yet."""
    told = _NOTHING if row is None else row
    is_overdue, first = days_of(now, row, today)
    is_now, a_day_m = now.action == Action.CHANGE_NOW, told["distance_a_day_m"]
    half, most = (today if is_now else told[name] for name in ("half_by", "most_by"))
    left_m = None if half is None or a_day_m is None else max((half - now.end_at.date()).days, 0) * a_day_m
    return Due(
        vehicle=now.vehicle,
        clutch=now.clutch,
        element=now.element,
        condition=now.condition,
        is_overdue=is_overdue,
        due_from=first,
        half_by=half,
        most_by=most,
        left_m=0.0 if is_now else left_m,
        distance_a_day_m=a_day_m,
        text=f"{now.order} {told['outlook']}",
    )


def driven_a_day_m(readings: Iterable[tuple[datetime, float | None]]) -> float | None:
    """Return the distance that a vehicle is driven a day, None if it is not known; readings come in their order."""
    known = [(at, odometer_m) for at, odometer_m in readings if odometer_m is not None and is_dated(at)]
    if not known:
        return None
    last_at, last_m = known[-1]
    first_at, first_m = next(one for one in known if last_at - one[0] <= LOOKED_BACK)
    if last_at - first_at < LEAST or last_m <= first_m:
        return None
    return (last_m - first_m) * (timedelta(days=1) / (last_at - first_at))


def _day(now: ClutchNow, distance_m: float | None, a_day_m: float | None) -> date | None:
    if distance_m is None or a_day_m is None or not is_dated(now.end_at) or distance_m > a_day_m * _HORIZON.days:
        return None
    return (now.end_at + timedelta(days=distance_m / a_day_m)).date()
