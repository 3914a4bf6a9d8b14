"""Whether the dates of results can be believed: held against today, and against the odometer.

A date of more than a day ahead is none. Of dates and readings of the odometer that contradict each other the fewest
streams are doubted. Where the odometer is known it says when such a result was: right after the reading before its own.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import accumulate
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from clutch_results.event_kinds import DATED_NS
from clutch_results.prognosis.history import UNSEEN_M
from clutch_results.records import FluidFill, ShiftResult, utc_from_bus_ns
from fleet_contract.orders import EARLIEST, FARTHEST_M, READING_M

AHEAD_NS: Final = 86_400_000_000_000  # by which the clocks of vehicles and of whoever reads their results may differ
NO_TODAY: Final = 2**62  # nanoseconds since 1970: before this day, every date was
_AFTER_NS: Final = 1_000_000_000  # after the reading before its own
_STEP_NS: Final = 1_000  # between two such results
_M_PER_KM: Final = 1000.0


def nanoseconds(moment: str) -> int:
    """Return a moment (ISO 8601) in nanoseconds since 1970."""
    return (datetime.fromisoformat(moment) - EARLIEST) // timedelta(microseconds=1) * 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class DatedOdometer:
    """What clock and odometer of a vehicle said at once."""

    t_ns: int
    odometer_m: float | None
    stream: str | None = None  # of results; None: somebody noted the day of a fill, and its odometer


@dataclass(frozen=True, slots=True, kw_only=True)
class Dates:
    """When some readings were, as far as that can be believed, and in words what cannot."""

    t_ns: tuple[int, ...]
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Chronicle:
    """Results in the order of their arrival, by dates that can be believed, and in words what their own dates said."""

    results: tuple[ShiftResult, ...]
    doubts: tuple[str, ...] = ()


def chronicle_of(results: Iterable[ShiftResult], fills: Iterable[FluidFill], today_ns: int) -> Chronicle:
    """Return results of one vehicle, the first to arrive first, by dates that can be believed.

    Parameters
    ----------
    results
        Of several streams; those of a stream follow each other.
    fills
        The fluid fills of the vehicle that are known.
    today_ns
        The present moment, since 1970.
    """
    results = tuple(results)
    ends = [(result.stream, result.estimate) for result in results]
    readings = [
        DatedOdometer(t_ns=estimate.end_ns, odometer_m=estimate.conditions.odometer_m, stream=stream)
        for stream, estimate in ends
    ]
    readings += [DatedOdometer(t_ns=nanoseconds(fill.filled_at), odometer_m=fill.odometer_m) for fill in fills]
    dates = believed(readings, today_ns)
    if not dates.doubts:
        return Chronicle(results=results)
    shifts_ns = [t_ns - result.estimate.end_ns for t_ns, result in zip(dates.t_ns, results, strict=False)]
    starts_ns = {result.estimate.start_ns: shift for result, shift in zip(results, shifts_ns, strict=True)}
    dated = tuple(_moved(result, shift, starts_ns) for result, shift in zip(results, shifts_ns, strict=True))
    return Chronicle(results=dated, doubts=dates.doubts)


def _moved(result: ShiftResult, shift_ns: int, shifts_ns: dict[int, int]) -> ShiftResult:
    """Return a result so much later; ``shifts_ns`` says how much later events were that began at a moment."""
    estimate, since_ns = result.estimate, result.verdict.running_since_bus_ns
    since_shift_ns = 0 if since_ns is None else shifts_ns.get(since_ns, 0)
    if since_ns is not None and since_shift_ns:
        result = replace(result, verdict=replace(result.verdict, running_since_bus_ns=since_ns + since_shift_ns))
    if not shift_ns:
        return result
    start_ns, end_ns = estimate.start_ns + shift_ns, estimate.end_ns + shift_ns
    return replace(result, estimate=replace(estimate, start_ns=start_ns, end_ns=end_ns))


def believed(readings: Sequence[DatedOdometer], today_ns: int) -> Dates:
    """Return when readings were, the first to arrive first; without doubts their own moments."""
    t_ns = np.array([reading.t_ns for reading in readings], np.int64)
    odometer_m = np.array([reading.odometer_m for reading in readings], np.float64)  # None becomes NaN
    is_ahead, is_read = t_ns - today_ns > AHEAD_NS, np.isfinite(odometer_m)
    ends = _ends(readings, is_read & ~is_ahead & (t_ns >= DATED_NS))
    contradiction = _contradiction(t_ns, odometer_m, ends)
    doubted = {readings[end].stream for end in _doubted(readings, t_ns, odometer_m, ends)} if contradiction else set()
    is_result = np.array([reading.stream is not None for reading in readings], bool)
    is_doubted = is_result & (is_ahead | np.array([reading.stream in doubted for reading in readings], bool))
    is_known = is_read & ~is_doubted & (t_ns >= DATED_NS)
    is_moved = is_read & is_doubted & bool(is_known.any())
    moved = t_ns.copy()
    if is_moved.any():
        moved[is_moved] = _placed(t_ns[is_known], odometer_m[is_known], odometer_m[is_moved])
    doubts = (
        *_ahead_words(t_ns[is_ahead & is_result], is_moved[is_ahead & is_result]),
        *(
            ()
            if contradiction is None
            else (_contradiction_words(t_ns, odometer_m, contradiction, is_odometer=bool(doubted)),)
        ),
    )
    return Dates(t_ns=tuple(moved.tolist()), doubts=doubts)


def _ends(readings: Sequence[DatedOdometer], is_usable: BoolArray) -> list[int]:
    """Return the places of the last usable reading of each stream and of all fills, by arrival."""
    last = {reading.stream or f"fill {place}": place for place, reading in enumerate(readings) if is_usable[place]}
    return sorted(last.values())


def _contradiction(t_ns: Int64Array, odometer_m: FloatArray, ends: Sequence[int]) -> tuple[int, int] | None:
    """Return the places of two readings, the earlier by its date first, of which the other has the lower odometer."""
    by_date = sorted(ends, key=lambda end: (t_ns[end], odometer_m[end]))

    def higher(high: int, end: int) -> int:
        return end if odometer_m[end] >= odometer_m[high] else high

    highest = accumulate(by_date, higher)
    pairs = [
        (high, end) for high, end in zip(highest, by_date, strict=True) if _falls(odometer_m, high, end) > READING_M
    ]
    return max(pairs, key=lambda pair: _falls(odometer_m, *pair), default=None)


def _falls(odometer_m: FloatArray, earlier: int, later: int) -> float:
    return float(odometer_m[earlier] - odometer_m[later])


def _doubted(
    readings: Sequence[DatedOdometer], t_ns: Int64Array, odometer_m: FloatArray, ends: Sequence[int]
) -> Iterator[int]:
    """Yield the places of the ends of streams whose dates have to go for dates and odometers to agree.

    An odometer that falls much is another instrument, unless what it fell to arrived first: then the date is wrong.
    That of a fill, which somebody typed, makes no date after it wrong.
    """
    places = np.array(ends)
    rises = odometer_m[places][:, None] - odometer_m[places]  # by which each is beyond each other
    arrived_later = places[:, None] > places
    is_of_fill = np.array([readings[end].stream is None for end in ends], bool)
    is_seen = arrived_later & ~(is_of_fill[:, None] | is_of_fill)
    falls = (t_ns[places][:, None] < t_ns[places]) & (rises > READING_M) & ~is_of_fill[:, None]
    against = falls & ((rises <= FARTHEST_M) | (is_seen & (rises <= UNSEEN_M)))
    against |= against.T
    while against.any():
        counts = np.where(is_of_fill, 0, against.sum(axis=1))  # somebody noted the day of a fill
        worst = len(counts) - 1 - int(np.argmax(counts[::-1]))  # of several the one that arrived last
        if not counts[worst]:
            return
        yield ends[worst]
        against[worst, :] = against[:, worst] = False


def _placed(known_ns: Int64Array, known_m: FloatArray, odometer_m: FloatArray) -> Int64Array:
    """Return when some readings of an odometer were, by others of which that is known."""
    order = np.argsort(known_m, kind="stable")
    before_ns = np.concatenate(([known_ns.min() - 2 * _AFTER_NS], np.maximum.accumulate(known_ns[order])))
    places = np.searchsorted(known_m[order], odometer_m, side="right")
    ranks = np.argsort(np.argsort(odometer_m, kind="stable"), kind="stable")
    return np.asarray(before_ns[places] + _AFTER_NS + _STEP_NS * ranks, np.int64)


def _ahead_words(ahead_ns: Int64Array, is_moved: BoolArray) -> Iterator[str]:
    if not len(ahead_ns):
        return
    told = "the odometer says when they were" if is_moved.all() else "nothing else says when they were"
    yield (
        f"The vehicle's clock was wrong: results are dated up to {_day(int(ahead_ns.max()))}, which is yet to come; "
        f"{told}. Set the clock."
    )


def _contradiction_words(
    t_ns: Int64Array, odometer_m: FloatArray, places: tuple[int, int], *, is_odometer: bool
) -> str:
    (first, second), (before_km, after_km) = (
        (_day(int(t_ns[place])) for place in places),
        (f"{odometer_m[place] / _M_PER_KM:,.0f} km" for place in places),
    )
    follows = (
        "the odometer decides. Set the clock."
        if is_odometer
        else "the dates decide, as after a change of the instrument cluster or a slip of the pen."
    )
    return f"Dates and odometer contradict each other: {before_km} on {first}, {after_km} on {second}; {follows}"


def _day(t_ns: int) -> str:
    return utc_from_bus_ns(t_ns)[:10]
