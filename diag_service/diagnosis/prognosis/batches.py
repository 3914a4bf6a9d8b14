"""Whether some vehicles of a type age faster than the others where no table knows what they have in common.

A bad batch shows among all vehicles together before any of them shows alone: the losses of a fleet are described once
as those of one kind, and once as those of two. Where two explain them so much better that chance hardly does so, there
is a batch; who belongs to it remains a probability for each vehicle.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.outliers import FALSE_SHARE
from diag_service.diagnosis.prognosis.population import Ageing

LEAST_VEHICLES: Final = 50  # of a type with young fluid: among fewer a batch cannot be told from scatter
YOUNG_M: Final = 2.0e7  # 20,000 km: later vehicles also differ by bends, which are no batch
SHARES: Final = (0.025, 0.05, 0.1)  # of the vehicles that may be of the batch
RATIOS: Final = (1.5, 2.0, 3.0)  # of their loss
FOUND_LOG_RATIO: Final = 1.5  # of the likelihoods; set on simulated fleets, docs/prognosis.md
WILD_SHARE: Final = 0.003  # of the vehicles, which are like no others
WILD_LOG_STD: Final = 0.9
_MIDDLES: Final = np.linspace(-0.3, 0.3, 25)  # of the usual loss over the median of all, natural logarithm
_SCATTERS: Final = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5])
_TRUE: Final = np.linspace(np.log(0.1), np.log(10.0), 231)  # losses that a vehicle may truly have, likewise
_LEAST_STD: Final = 0.03  # of one loss over the median: more than the step of those
_LEAST_DENSITY: Final = 1e-30


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """What is to be said of a hidden batch among the vehicles of one type."""

    vehicle_type: str
    vehicle_count: int  # with young fluid
    log_ratio: float  # natural logarithm of how much likelier two kinds make the losses than one kind
    is_found: bool
    share: float  # of the vehicles, where there is a batch
    loss_ratio: float  # of their loss
    probability: Mapping[str, float]  # of each vehicle to belong to it, the largest first
    named: tuple[str, ...]  # of these one in ten is sound at most, as far as the description holds


def hidden_batches(lives: Sequence[Ageing]) -> list[Batch]:
    """Return what is to be said of each type of which enough vehicles have young fluid."""
    types: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for life in lives:
        course = life.courses.get(ChannelName.MARGIN)
        if life.is_present and course is not None and life.distance_m <= YOUNG_M:
            vehicles = types.setdefault(life.kind.vehicle_type, {})
            vehicles.setdefault(life.vehicle, []).append((course.loss_per_m, course.loss_std_per_m))
    return [_batch(name, types[name]) for name in sorted(types) if len(types[name]) >= LEAST_VEHICLES]


def _batch(vehicle_type: str, vehicles: Mapping[str, Sequence[tuple[float, float]]]) -> Batch:
    loss, std = np.array([np.mean(own, axis=0) for own in vehicles.values()]).T
    middle = max(float(np.median(loss)), 1e-12)
    readings = _readings(loss / middle, np.hypot(std / middle, _LEAST_STD))
    one_kind = _likelihood(readings, 1.0)
    best_of_one = float(np.max(np.log(one_kind).sum(axis=1)))
    cases = [(share, ratio) for ratio in RATIOS for share in SHARES]
    faster = {ratio: _likelihood(readings, ratio) / one_kind for ratio in RATIOS}
    better = [np.log1p(share * (faster[ratio] - 1.0)) for share, ratio in cases]
    logs = np.array([np.log(one_kind).sum(axis=1) + one.sum(axis=1) for one in better])
    chances = np.array([share * faster[ratio] / (1.0 - share + share * faster[ratio]) for share, ratio in cases])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    probability = np.einsum("cg,cgn->n", weight, chances)
    order = np.argsort(-probability)
    names = list(vehicles)
    log_ratio = float(logs.max()) - best_of_one
    return Batch(
        vehicle_type=vehicle_type,
        vehicle_count=len(names),
        log_ratio=log_ratio,
        is_found=log_ratio >= FOUND_LOG_RATIO,
        share=float(weight.sum(axis=1) @ [share for share, _ in cases]),
        loss_ratio=float(weight.sum(axis=1) @ [ratio for _, ratio in cases]),
        probability={names[row]: float(probability[row]) for row in order.tolist()},
        named=tuple(names[row] for row in order[: _sure_count(probability[order])].tolist()),
    )


def _readings(loss: FloatArray, std: FloatArray) -> FloatArray:
    """Return how likely each reading is for each loss that its vehicle may truly have, shape (n, t)."""
    z = (loss[:, None] - np.exp(_TRUE)) / std[:, None]
    return np.asarray(np.exp(-0.5 * z**2) / std[:, None])


def _likelihood(readings: FloatArray, ratio: float) -> FloatArray:
    """Return how likely each reading is in vehicles whose loss is so much larger, shape (g, n), for each description.

    A description is a usual loss and a log-normal scatter about it; readings are normal about the loss of the vehicle.
    """
    middle, scatter = (one.ravel() for one in np.meshgrid(_MIDDLES, _SCATTERS))
    alike = _shares(middle + np.log(ratio), scatter) @ readings.T
    wild = _shares(middle, np.full_like(scatter, WILD_LOG_STD)) @ readings.T
    return np.asarray((1.0 - WILD_SHARE) * alike + WILD_SHARE * wild + _LEAST_DENSITY)


def _shares(middle: FloatArray, scatter: FloatArray) -> FloatArray:
    """Return which part of the vehicles has each loss, shape (g, t)."""
    density = np.exp(-0.5 * ((_TRUE - middle[:, None]) / scatter[:, None]) ** 2)
    return np.asarray(density / density.sum(axis=1, keepdims=True))


def _sure_count(probability: FloatArray) -> int:
    """Return how many of the likeliest may be named with one in ten sound among them, on average."""
    sound = np.cumsum(1.0 - probability) / np.arange(1, len(probability) + 1)
    rows = np.flatnonzero(sound <= FALSE_SHARE)
    return int(rows[-1]) + 1 if len(rows) else 0
