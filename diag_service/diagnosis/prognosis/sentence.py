"""One sentence per clutch for people: how far the fluid will go, as a range, and how sure that is."""

from typing import Final

from diag_service.diagnosis.prognosis.assumptions import HORIZON_M, LEAST_ROWS
from diag_service.diagnosis.prognosis.prognosis import Outlook, Prognosis, Reach
from diag_service.diagnosis.prognosis.words import M_PER_KM

_PERCENT: Final = 100.0


def outlook_line(found: Prognosis) -> str:
    """Return what is to be expected of a clutch; never a distance without its range."""
    if found.change_fluid is None or found.watch is None:
        return (
            f"Clutch {found.clutch}: no prognosis yet: it takes {LEAST_ROWS} usable results with this fluid, "
            f"there are {found.row_count}."
        )
    if found.outlook is Outlook.NO_TREND:
        return f"Clutch {found.clutch}: no trend yet; {_at_least(found.change_fluid)}."
    chance = found.change_fluid.probability_before_service
    return (
        f"Clutch {found.clutch}: the fluid ages; change it {_range(found.change_fluid)}, watch it "
        f"{_range(found.watch)}; {_percent(chance)} that the change is due within the next "
        f"{found.service_distance_m / M_PER_KM:,.0f} km."
    )


def _range(when: Reach) -> str:
    if when.p90_m == 0.0:
        return "now"
    if when.p10_m is None:
        return f"in more than {HORIZON_M / M_PER_KM:,.0f} km"
    if when.p90_m is None and when.p10_m == 0.0:
        return "now or much later, nobody can say"
    if when.p90_m is None:
        return f"in more than {_km(when.p10_m)} km (90 % sure)"
    if when.p10_m == 0.0:
        return f"within {_km(when.p90_m)} km (90 % sure)"
    return f"in {_km(when.p10_m)} to {_km(when.p90_m)} km (80 % sure)"


def _at_least(when: Reach) -> str:
    if when.p10_m == 0.0:
        return "the fluid may be due for a change already"
    least_m = HORIZON_M if when.p10_m is None else when.p10_m
    return f"a change of the fluid is at least {_km(least_m)} km away (90 % sure)"


def _km(distance_m: float) -> str:
    """Return a distance [m] in kilometres with two digits that mean something."""
    return f"{float(f'{distance_m / M_PER_KM:.2g}'):,.0f}"


def _percent(probability: float) -> str:
    if probability < 0.005:
        return "less than 1 %"
    return "more than 99 %" if probability > 0.995 else f"{_PERCENT * probability:.0f} %"
