"""Gear ratios that a log shows: engine speed over output speed while a gear's clutch is closed."""

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.series import Series
from diag_service.diagnosis.columns import ColumnBatch, Signal

WINDOW: Final = 0.01  # width of the band in which the ratios of a closed clutch lie, as a part of them
LEAST_SAMPLES: Final = 10
LEAST_SHARE: Final = 0.2  # of a gear's samples in that band: else its clutch was never closed for long
LEAST_SPEED: Final = 0.1  # of the highest output speed: below, its steps are too coarse


class GearRatio(NamedTuple):
    """What a log shows of a gear: the ratio, its standard deviation, and from how many samples."""

    ratio: float
    std: float
    sample_count: int


def gear_ratios(batches: Iterable[ColumnBatch], over: Signal) -> Mapping[int, GearRatio]:
    """Return the ratios of the gears that a log shows, by gear; of others nothing is said.

    ``over`` is the speed behind the gears. Gears come from the target where there is one, else from the current gear.
    """
    collected: dict[Signal, list[Series]] = {}
    for batch in batches:
        for signal, series in batch.columns.items():
            collected.setdefault(signal, []).append(series)
    gear = Signal.TARGET_GEAR if Signal.TARGET_GEAR in collected else Signal.CURRENT_GEAR
    if not {gear, Signal.ENGINE_SPEED, over} <= collected.keys():
        return {}
    t_s, output = _joined(collected[over])
    engine = np.interp(t_s, *_joined(collected[Signal.ENGINE_SPEED]))
    gear_t_s, gears = _joined(collected[gear])
    known = np.searchsorted(gear_t_s, t_s, side="right") - 1
    is_fast = (known >= 0) & (output > LEAST_SPEED * output.max(initial=0.0))
    found = {
        int(one): _densest(engine[rows] / output[rows])
        for one in np.unique(gears)
        if one > 0 and np.count_nonzero(rows := is_fast & (gears[np.maximum(known, 0)] == one)) >= LEAST_SAMPLES
    }
    return {one: ratio for one, ratio in found.items() if ratio is not None}


def is_complete(ratios: Mapping[int, GearRatio]) -> bool:
    """Return whether there is every gear from the first on, each with a lower ratio than the one below it."""
    values = [ratios[gear].ratio for gear in sorted(ratios)]
    return (
        sorted(ratios) == list(range(1, len(ratios) + 1)) and len(values) > 1 and values == sorted(values, reverse=True)
    )


def _joined(series: Iterable[Series]) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and values of a signal."""
    pieces = list(series)
    order = np.argsort(t_ns := np.concatenate([one.t_ns for one in pieces]), kind="stable")
    return t_ns[order] / 1e9, np.concatenate([one.value for one in pieces])[order]


def _densest(ratios: FloatArray) -> GearRatio | None:
    """Return the middle of the band that holds most ratios; None if too few lie in any."""
    ordered = np.sort(ratios[ratios > 0.0])
    counts = np.searchsorted(ordered, ordered * (1.0 + WINDOW), side="right") - np.arange(len(ordered))
    if not len(counts) or counts.max() < max(LEAST_SAMPLES, LEAST_SHARE * len(ratios)):
        return None
    first = int(counts.argmax())
    band = ordered[first : first + int(counts[first])]
    return GearRatio(float(np.median(band)), float(band.std() / np.sqrt(len(band))), len(band))
