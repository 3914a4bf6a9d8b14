"""One sentence per vehicle for people: how far its fluid will go, as a range, and how sure that is.

An order is about now and is made from verdicts (`fleet_contract.orders`); here is only what comes later, and nothing
that an order has said otherwise.
"""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from math import inf, isnan
from typing import Final

from clutch_results.prognosis.assumptions import HORIZON_M, LEAST_ROWS
from clutch_results.prognosis.prognosis import M_PER_KM, PERCENT, Outlook, Prognosis, Reach
from clutchdiag_io.people import km_words
from fleet_contract.orders import Action, name_of

LIKELY: Final = 0.5  # so likely the limit comes before the service: then an order that waits for it is not all
_AGES: Final = "The fluid ages: left in"
_SOONER: Final = {
    Action.NOTHING: "But the fluid ages: plan its change before the next service. Left in",
    Action.CHANGE_AT_SERVICE: "The fluid ages: better change it before the next service. Left in",
}
_UNKNOWN: Final = "How far the fluid will go cannot be said yet."


def outlook_line(prognoses: Sequence[Prognosis], action: Action, element: str | None = None) -> str:
    """Return what is to be expected of the fluid by the prognoses of both clutches, or of the only one by its name."""
    return " ".join((_line(prognoses, action, element), *_left_out(prognoses, element)))


def soonest(prognoses: Iterable[Prognosis]) -> Reach | None:
    """Return how far an ageing fluid will go: until the first of the clutches has passed its limit; None: no trend."""
    reaches = (prognosis.change_fluid for prognosis in prognoses if prognosis.outlook is Outlook.AGEING)
    return min((reach for reach in reaches if reach is not None), key=_end, default=None)


def distance_left(prognoses: Sequence[Prognosis], action: Action) -> str:
    """Return what `outlook_line` says of the distance in a few words, for a headline."""
    if action is Action.CHANGE_NOW:
        return "0 km left"
    least_m, first = least_left_m(prognoses, action), soonest(prognoses)
    if least_m is None:
        return "km left: not known yet"
    if first is not None:
        return _range(first).removeprefix("in ").replace("within", "at most").replace(" km", " km left")
    return at_least(least_m, " km left")


def least_left_m(prognoses: Sequence[Prognosis], action: Action) -> float | None:
    """Return the distance that the fluid lasts at least, 90 % sure; None: not known."""
    if action is Action.CHANGE_NOW:
        return 0.0
    known, first = _reaches(prognoses), soonest(prognoses)
    if action in {Action.FIND_CAUSE, Action.NEW_FLUID} or not known:
        return None
    if first is not None:
        return _least_m([first]) if _is_told(first) else None
    return least_m if (least_m := _least_m(known)) > 0.0 else None


def at_least(distance_m: float, unit: str = "") -> str:
    """Return a distance that is the least, 90 % sure, in kilometres."""
    return f"at least {km_words(distance_m)}{unit} (90 % sure)"


def _reaches(prognoses: Iterable[Prognosis]) -> list[Reach]:
    return [prognosis.change_fluid for prognosis in prognoses if prognosis.change_fluid is not None]


def _line(prognoses: Sequence[Prognosis], action: Action, element: str | None) -> str:
    if action is Action.CHANGE_NOW:
        return "No prognosis: the fluid is to be changed now."
    if action is Action.FIND_CAUSE:
        return "No prognosis of the fluid before that was seen to."
    known = _reaches(prognoses)
    if action is Action.NEW_FLUID or not known:
        return _too_few(prognoses, element)
    first = soonest(prognoses)
    if first is None:
        p10_m = _least_m(known)
        return (
            _UNKNOWN
            if not p10_m > 0.0  # nor where it is no number
            else f"No trend yet: left in, the fluid lasts {at_least(p10_m, ' km')}."
        )
    if not _is_told(first):
        return _UNKNOWN
    chance = first.probability_before_service
    begin = _SOONER.get(action, _AGES) if chance >= LIKELY else _AGES
    return (
        f"{begin}, it reaches its limit {_range(first)}; {_percent(chance)} "
        f"that this is within the next {prognoses[0].service_distance_m / M_PER_KM:,.0f} km."
    )


def _too_few(prognoses: Sequence[Prognosis], element: str | None) -> str:
    """Return what a prognosis waits for: results, or of a fill that was noted late a drive that begins after it."""
    enough = [prognosis for prognosis in prognoses if prognosis.change_fluid is not None]
    if enough:
        counts = " and ".join(f"{each.row_count} usable results of {name_of(each.clutch, element)}" for each in enough)
        return (
            "No prognosis before the next drive: what is known of the clutches rests on the earlier fluid, too, for "
            f"the fill was noted after {counts} with the new one."
        )
    counts = ", ".join(f"{name_of(prognosis.clutch, element)} has {prognosis.row_count}" for prognosis in prognoses)
    least = f"No prognosis yet: it takes {LEAST_ROWS} usable results of a clutch with this fluid"
    return f"{least}; {counts}." if counts else f"{least}."


def _least_m(known: Iterable[Reach]) -> float:
    return min(HORIZON_M if reach.p10_m is None else reach.p10_m for reach in known)


def _is_told(when: Reach) -> bool:
    """Return whether the quantiles of a distance tell something of it."""
    ends = (0.0 if end_m is None else end_m for end_m in (when.p10_m, when.p50_m, when.p90_m))
    return when.p90_m != 0.0 and not (when.p90_m is None and when.p10_m == 0.0) and not any(map(isnan, ends))


def _end(when: Reach) -> tuple[float, ...]:
    return tuple(inf if end_m is None else end_m for end_m in (when.p10_m, when.p50_m, when.p90_m))


def _left_out(prognoses: Sequence[Prognosis], element: str | None) -> list[str]:
    """Return how many results no prognosis uses, and why."""
    losing = [prognosis for prognosis in prognoses if prognosis.left_out_count]
    counts = [f"{prognosis.left_out_count} results of {name_of(prognosis.clutch, element)}" for prognosis in losing]
    why = "they miss odometer or oil temperature, or their odometer went back or leapt"
    stale = [prognosis.stale_since_s for prognosis in prognoses if prognosis.stale_since_s is not None]
    since = (
        [f"Stale since {datetime.fromtimestamp(min(stale), UTC):%Y-%m-%d}: no later result counts."] if stale else []
    )
    return [*since, f"Left out: {', '.join(counts)}: {why}."] if counts else since


def _range(when: Reach) -> str:
    if when.p10_m is None:
        return f"in more than {HORIZON_M / M_PER_KM:,.0f} km"
    if when.p90_m is None:
        return f"in more than {km_words(when.p10_m)} km (90 % sure)"
    if when.p10_m == 0.0:
        return f"within {km_words(when.p90_m)} km (90 % sure)"
    return f"in {km_words(when.p10_m)} to {km_words(when.p90_m)} km (80 % sure)"


def _percent(probability: float) -> str:
    if probability < 0.005:
        return "less than 1 %"
    return "more than 99 %" if probability > 0.995 else f"{PERCENT * probability:.0f} %"
