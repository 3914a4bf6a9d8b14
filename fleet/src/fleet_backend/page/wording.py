"""How numbers, moments and verdicts of the fleet read: the one place, for all pages."""

from datetime import datetime
from typing import Final
from urllib.parse import quote, urlencode

from clutchdiag_io.pages.content import NONE, Advice, Badge, Cell, Link, number
from fleet_contract.orders import SHOWN_AS, Action

M_PER_KM: Final = 1000.0


def share(value: float | None) -> Cell:
    """Return a ratio as percent."""
    return number(value, "{:.1%}")


def probability(value: float | None) -> Cell:
    return number(value, "{:.3f}")


def km(distance_m: float | None) -> Cell:
    """Return a distance; programs read metres."""
    return number(distance_m, "{:,.0f}", scale=1.0 / M_PER_KM)


def quality(value: float | None) -> Cell:
    return number(value, "{:.2f}")


def condition_word(condition: str) -> str:
    return condition.replace("_", " ")


def style(condition: str) -> str:
    """Return the style of a verdict's badge."""
    return condition.replace("_", "-")


def badge(condition: str) -> Badge:
    return Badge(style=style(condition), text=condition_word(condition))


def plain(text: str | None) -> str:
    """Return a text, or a dash where there is none."""
    return text or NONE


def words(reasons: tuple[str, ...]) -> str:
    """Return reasons as people read them."""
    return ", ".join(reason.replace("_", " ") for reason in reasons) or NONE


def advice(action: str, order: str) -> Advice:
    """Return the order for a vehicle, shown as the verdict that it comes from."""
    condition = SHOWN_AS[Action(action)]
    return Advice(condition=style(condition), word=condition_word(condition), text=order)


def vehicle_link(vehicle: str) -> Link:
    return Link(text=vehicle, href=f"/vehicles/{quote(vehicle, safe='')}")


def alarm_href(vehicle: str, clutch: int, rule: str, number_of_it: int) -> str:
    """Return the address of an alarm; clutch 0 is the vehicle as a whole."""
    words_of_it = urlencode({"vehicle": vehicle, "clutch": clutch, "rule": rule, "number": number_of_it})
    return f"/alarm?{words_of_it}"


def shift_link(text: str, vehicle: str, stream: str, seq: int, *, at: datetime | None = None) -> Link:
    """Return the link to an event; ``at`` is the moment that the text tells, if it does."""
    words_of_it = urlencode({"stream": stream, "seq": seq})
    return Link(
        text=text, href=f"/vehicles/{quote(vehicle, safe='')}/shift?{words_of_it}", iso=at.isoformat() if at else ""
    )
