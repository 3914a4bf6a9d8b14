"""The history in a store: the friction of each clutch, fluid by fluid; without it how the vehicle shifts."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich.table import Table
from rich.text import Text

from clutch_results import records, shift_course
from clutch_results.event_kinds import events_text
from clutch_results.prognosis import Peers, Population, Prognosis, history_of, prognose, without
from clutch_results.prognosis.sentence import outlook_line
from clutch_results.shifting import MOST_NAMED, seen_changes, shifting_of, shifting_record, unknown_friction_words
from clutchdiag_io.console import plain_table
from clutchdiag_io.pages.content import spread
from clutchdiag_io.people import PLUS_MINUS, plus_minus
from diag_service.delivery.console import condition_words, order_lines, shifting_table
from diag_service.diagnosis.capability import NEEDS_HEAD
from diag_service.diagnosis.summary import cause_lines, is_relative, latest_of, newest_causes
from diag_service.report.findings import Findings, moment_words
from diag_service.store import Row
from fleet_contract import JsonObject

HISTORY_SCHEMA: Final = "clutchdiag/history/v1"
UNKNOWN_FLUID: Final = "fluid of unknown age"
_NONE: Final = "-"
_UNKNOWN: Final = "not known yet (a baseline takes some 25 shifts of a clutch), or there was no other fluid"
_MINUTE: Final = 16  # characters of an ISO moment up to its minutes


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidPeriod:
    """The results of one clutch with one fluid."""

    fill: records.FluidFill | None  # None: the fluid was there before anything was known
    rows: tuple[Row, ...]
    until: float = math.inf  # the place of the first result of a later fluid, of any clutch

    @property
    def name(self) -> str:
        """The fluid and since when, for people."""
        if self.fill is None:
            return UNKNOWN_FLUID
        return f"{self.fill.product or 'fluid'} since {self.fill.filled_at[:_MINUTE].replace('T', ' ')}"

    @property
    def last_verdict(self) -> records.ClutchVerdict | None:
        """The last one while the fluid was in; an event whose log came later was judged by itself."""
        timely = [row for row in self.rows if row.position < self.until] or self.rows
        return latest_of(row.result for row in timely)[0].verdict if timely else None


def periods_of(findings: Findings, clutch: int) -> list[FluidPeriod]:
    """Return the results of a clutch, fluid by fluid; a fluid without any is one of them too."""
    dated = [
        (row, records.utc_from_bus_ns(result.estimate.start_ns))
        for row, result in zip(findings.rows, findings.results, strict=True)
    ]
    fills: list[records.FluidFill | None] = [None, *findings.fills]
    periods = []
    for fill, following in zip(fills, [*fills[1:], None], strict=True):
        since, until = "" if fill is None else fill.filled_at, "~" if following is None else following.filled_at
        rows = [row for row, start in dated if since <= start < until and row.result.estimate.clutch == clutch]
        later = min((row.position for row, start in dated if start >= until), default=math.inf)
        if rows or fill is not None:
            periods.append(FluidPeriod(fill=fill, rows=tuple(rows), until=later))
    return periods


def history_records(findings: Findings, clutches: Sequence[int]) -> Iterator[JsonObject]:
    """Yield a record per event of the clutches, in order, how they shift if that is all, and the fills."""
    for clutch in clutches:
        number = 0
        for period in periods_of(findings, clutch):
            for row in period.rows:
                number += 1
                yield _event_record(row, clutch, number, period.fill)
    if findings.untold:
        untold = [result for result in findings.untold if result.estimate.clutch in clutches]
        shifting = shifting_record(shifting_of(untold))
        yield {"schema": HISTORY_SCHEMA, "record": "shifting", "vehicle": findings.vehicle, **shifting}
    yield {
        "schema": HISTORY_SCHEMA,
        "record": "fills",
        "vehicle": findings.vehicle,
        "fills": [records.fill_record(fill) for fill in findings.fills],
        "left_out_count": findings.left_out_count,
        **records.order_record(findings.order),
        "algorithm_version": findings.versions.algorithm,
        "calibration_version": findings.versions.calibration,
    }


def history_lines(
    findings: Findings, clutches: Sequence[int], *, most_rows: int, population: Population | None = None
) -> Iterator[Text | Table]:
    """Yield for people: the order for the vehicle, how far its fluid will go, and of each clutch its fluids and events.

    Prognoses begin with what a fleet taught, if that is given.
    """
    left_out = f"; {findings.left_out_count} of other versions are left out" if findings.left_out_count else ""
    yield Text(f"{findings.vehicle}: {events_text(len(findings.rows))}{left_out}")
    yield from order_lines(findings.order)
    yield from map(Text, cause_lines(newest_causes(findings.latest, findings.today_ns)))
    if findings.untold:
        yield from _untold_lines(findings, clutches)
        return
    peers = peers_of(findings, population)
    known = "" if peers is None else f" Before its own results: as {peers.life_count} lives of its peers."
    yield Text(outlook_of(findings, prognoses_of(findings, population)) + known)
    for clutch in (clutch for clutch in clutches if clutch in findings.clutches):
        periods = periods_of(findings, clutch)
        rows = [row for period in periods for row in period.rows]
        if not rows:
            yield Text(f"{findings.title(clutch)}: no event engaged it.")
            continue
        yield _fluid_table(findings.title(clutch), periods)
        yield _event_table(findings.title(clutch), periods, most_rows, is_dated=findings.is_dated)
    yield from _course(findings)


def _untold_lines(findings: Findings, clutches: Sequence[int]) -> Iterator[Text | Table]:
    """Yield how a vehicle shifts whose signals do not tell friction: by kind and gears, and what changed."""
    untold = [result for result in findings.untold if result.estimate.clutch in clutches]
    shifting = shifting_of(untold)
    yield Text(f"{unknown_friction_words(shifting, is_relative=is_relative(untold))}.")
    yield shifting_table(shifting)
    yield from (Text(f"Changed: {change}.") for change in seen_changes(shifting)[MOST_NAMED:])
    yield from map(Text, shift_course.course_lines(shift_course.courses(result.estimate for result in untold)))
    if findings.needs:
        yield Text(f"{NEEDS_HEAD}:")
        yield from (Text(f"  {need}") for need in findings.needs)


def _course(findings: Findings) -> Iterator[Text | Table]:
    """Yield how well the gear changes went, if that is known."""
    estimates = [result.estimate for result in findings.results]
    known = shift_course.courses(estimates)
    if not known:
        return
    head, caption = shift_course.COURSE_HEAD, "Score of the gear changes, 100 is faultless"
    table = plain_table(head, {"change", "mostly costs"}, caption)
    for course in known:
        table.add_row(*shift_course.course_row(course))
    yield table
    yield from map(Text, shift_course.course_lines(known))
    yield from (Text(shift_course.load_line(load)) for load in shift_course.loads(estimates))


def prognoses_of(findings: Findings, population: Population | None = None) -> list[Prognosis]:
    """Return the prognosis of each clutch that has engaged; new fluid is that of the calibration."""
    prognoses: list[Prognosis] = []
    if findings.calibration is None:
        return prognoses
    for clutch in sorted({result.estimate.clutch for result in findings.results}):
        past = history_of(findings.results, findings.fills, clutch)
        if population is not None:
            past = without(past, population.common.get(findings.calibration.name))
        new = findings.calibration.clutches[clutch - 1].friction
        prognoses.append(prognose(clutch, past, new, peers=peers_of(findings, population)))
    return prognoses


def peers_of(findings: Findings, population: Population | None) -> Peers | None:
    """Return what a fleet taught of vehicles of this type with this fluid."""
    if population is None or findings.calibration is None:
        return None
    return population.of(findings.calibration.name, findings.fills[-1].product if findings.fills else None)


def outlook_of(findings: Findings, prognoses: Sequence[Prognosis]) -> str:
    """Return how far the fluid will go, for people."""
    if findings.calibration is None:
        return "No prognosis: these results are of another calibration; --calibration names it."
    return outlook_line(
        prognoses, findings.order.action, findings.latest[0].verdict.element if findings.latest else None
    )


def _event_record(row: Row, clutch: int, number: int, fill: records.FluidFill | None) -> JsonObject:
    result, running = row.result, row.result.verdict.friction
    friction = result.estimate.friction
    return {
        "schema": HISTORY_SCHEMA,
        "record": "event",
        "vehicle": result.vehicle,
        "clutch": clutch,
        "number": number,
        "shift": row.position,
        "end_utc": records.utc_from_bus_ns(result.estimate.end_ns),
        "odometer_m": result.estimate.conditions.odometer_m,
        "kind": result.estimate.kind.value,
        "status": result.estimate.status.value,
        "mu_c": None if friction is None else friction.mu_c,
        "std_mu_c": None if friction is None else friction.std_mu_c,
        "running_mu_c": None if running is None else running.mu_c,
        "running_std_mu_c": None if running is None else running.std_mu_c,
        "running_mu_s": None if running is None else running.mu_s,
        "running_std_mu_s": None if running is None else running.std_mu_s,
        "probability_negative_slope": None if running is None else running.probability_negative_slope,
        "level_ratio": result.verdict.level_ratio,
        "condition": result.verdict.condition.name.lower(),
        "advice": result.verdict.advice,
        "fluid_since": None if fill is None else fill.filled_at,
        "stream": result.stream,
        "seq": result.seq,
    }


def _fluid_table(title: str, periods: Sequence[FluidPeriod]) -> Table:
    head = ("fluid", "shifts", "mu_C at the end", "since its baseline", "against the first fluid", "verdict")
    table = plain_table(head, {"fluid", "verdict"}, f"{title}, fluid by fluid; {PLUS_MINUS}; -: {_UNKNOWN}")
    for period in periods:
        verdict = period.last_verdict
        table.add_row(
            period.name,
            "0" if verdict is None else str(verdict.shift_count),
            _NONE if verdict is None else _friction(verdict.friction),
            _NONE if verdict is None else _change(verdict.trend),
            _NONE if verdict is None else _change(verdict.lining),
            _NONE if verdict is None else condition_words(verdict.condition),
        )
    return table


def _event_table(title: str, periods: Sequence[FluidPeriod], most_rows: int, *, is_dated: bool) -> Table:
    rows = [row for period in periods for row in period.rows]
    places = spread(range(len(rows)), most_rows)
    firsts = [sum(len(before.rows) for before in periods[:number]) for number in range(len(periods))]
    fills = [(first, period.fill) for first, period in zip(firsts, periods, strict=True) if period.fill is not None]
    shown = f"{len(places)} of {events_text(len(rows))}, evenly spread, --rows sets how many"
    shown = shown if len(places) < len(rows) else events_text(len(rows))
    caption = f"{title}: {shown}; shift is the number that 'show' takes; {PLUS_MINUS}"
    head = ("shift", "end (UTC)" if is_dated else "end in the log", "km", "data", "mu_C", "running mu_C", "verdict")
    table = plain_table(head, {"data", "verdict"}, caption)
    for place in [*places, len(rows)]:
        while fills and fills[0][0] <= place:
            fill = fills.pop(0)[1]
            moment = fill.filled_at[:_MINUTE].replace("T", " ")
            table.add_row(_NONE, moment, _km(fill.odometer_m), "new fluid", fill.product or _NONE, _NONE, _NONE)
        if place == len(rows):
            return table
        estimate, verdict = rows[place].result.estimate, rows[place].result.verdict
        table.add_row(
            str(rows[place].position),
            moment_words(estimate.end_ns, is_dated=is_dated)[:_MINUTE],
            _km(estimate.conditions.odometer_m),
            estimate.status.value,
            _friction(estimate.friction),
            _friction(verdict.friction),
            condition_words(verdict.condition),
        )
    return table


def _km(odometer_m: float | None) -> str:
    return _NONE if odometer_m is None else f"{odometer_m / 1000.0:.0f}"


def _friction(friction: records.FrictionEstimate | None) -> str:
    return _NONE if friction is None else plus_minus(friction.mu_c, friction.std_mu_c)


def _change(since: records.FrictionTrend | records.LiningChange | None) -> str:
    if since is None:
        return _NONE
    return plus_minus(since.change_mu_c_ratio, since.std_change_mu_c_ratio, "{:+.1f}", scale=100.0) + " %"
