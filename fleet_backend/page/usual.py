"""What is usual in the fleet now: where the clutches of one type and fluid stand, for the background of a trend."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from fleet_backend.page.listing import vehicle_type
from fleet_backend.page.records import ClutchNow, Usual

LEAST_CLUTCHES: Final = 20  # fewer say little of what is usual
_SHARES: Final = (0.1, 0.5, 0.9)

ClutchGroup = tuple[str, int, str | None]  # type, clutch, fluid


def group_of(now: ClutchNow) -> ClutchGroup:
    return vehicle_type(now), now.clutch, now.fluid


def usual_of(clutches: Iterable[ClutchNow]) -> Mapping[ClutchGroup, Usual]:
    levels: dict[ClutchGroup, list[float]] = {}
    for now in clutches:
        if now.mu_c is not None:
            levels.setdefault(group_of(now), []).append(now.mu_c)
    return MappingProxyType({
        kind: Usual(clutch_count=len(some), **_quantiles(some))
        for kind, some in levels.items()
        if len(some) >= LEAST_CLUTCHES
    })  # fmt: skip


def _quantiles(levels: list[float]) -> dict[str, float]:
    low, middle, high = np.quantile(levels, _SHARES).tolist()
    return {"low_mu_c": low, "middle_mu_c": middle, "high_mu_c": high}
