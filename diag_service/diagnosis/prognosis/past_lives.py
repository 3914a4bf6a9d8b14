"""What the fluids of one clutch went through: what a population is learned from.

A life is followed until its limit was passed, or as far as it went. What came after the end of a fluid teaches nothing
of how fluids come to it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from clutch_model.calibration import FrictionCurve
from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO
from diag_service.diagnosis.prognosis.assumptions import LEAST_ROWS
from diag_service.diagnosis.prognosis.changes import FluidStart, fluid_starts
from diag_service.diagnosis.prognosis.fluid_lives import (
    CHANGE_MARGIN_RATIO,
    AgedChannel,
    FluidLife,
    either,
    fluid_lives,
)
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.population import Ageing, Course, Hindsight, PeerGroup, Peers, Population
from diag_service.diagnosis.prognosis.trend import Part, Passage, fallen, summary

LOOK_SHARES: Final = (0.1, 0.17, 0.25, 0.35, 0.5, 0.7)  # of a life: when it is foretold what came of it
_HALVINGS: Final = 6  # a fluid's end is found to a sixty-fourth of what was driven with it


def ageings(
    vehicle: str, clutch: int, history: History, reference: FrictionCurve, kinds: Sequence[PeerGroup]
) -> list[Ageing]:
    """Return what each fluid of a clutch that was new when first seen says of its kind.

    ``kinds`` are those of the fluids by their numbers in the history; that of a fill that nobody noted is not known.
    """
    starts = fluid_starts(history) if len(history) else ()
    found = []
    for life in fluid_lives(history, starts, reference, None):
        if not life.is_new:
            continue
        kind = kinds[int(history.fluid_number[life.first])]
        until, has_ended = _until_its_end(history, starts, reference, life)
        found.append(
            Ageing(
                vehicle=vehicle,
                clutch=clutch,
                kind=kind if life.is_noted else replace(kind, fluid=None),
                distance_m=life.distance_m,
                is_present=life.stop == len(history),
                courses={name: _course(channel, until.distance_m) for name, channel in until.channels.items()},
                lasted_m=until.distance_m if has_ended else None,
            )
        )
    return found


def hindsights(
    history: History, reference: FrictionCurve, lives: Sequence[Ageing], population: Population
) -> list[tuple[Ageing, list[Hindsight]]]:
    """Return what would have been foretold of each life at some of its ages, bends apart.

    ``lives`` are those that `ageings` returns of the same history.
    """
    starts = fluid_starts(history) if len(history) else ()
    whole = [life for life in fluid_lives(history, starts, reference, None) if life.is_new]
    found = []
    for ageing, life in zip(lives, whole, strict=True):
        peers = population.of(ageing.kind.vehicle_type, ageing.kind.fluid)
        known_m = life.distance_m if ageing.lasted_m is None else ageing.lasted_m
        told = [
            Hindsight(
                share=share, left_m=known_m * (1.0 - share), has_ended=ageing.lasted_m is not None, passage=_end(then)
            )
            for share in LOOK_SHARES
            if (then := _at(history, starts, reference, life, known_m * share, peers)) is not None
        ]
        found.append((ageing, told))
    return found


def _until_its_end(
    history: History, starts: tuple[FluidStart, ...], reference: FrictionCurve, life: FluidLife
) -> tuple[FluidLife, bool]:
    """Return a life as it was when its limit was passed, and whether it was; else as far as it went."""
    if not _has_ended(life):
        return life, False
    near_m, far_m, ended = 0.0, life.distance_m, life
    for _ in range(_HALVINGS):
        middle_m = 0.5 * (near_m + far_m)
        then = _at(history, starts, reference, life, middle_m, None)
        if then is not None and _has_ended(then):
            far_m, ended = middle_m, then
        else:
            near_m = middle_m
    return ended, True


def _at(
    history: History,
    starts: tuple[FluidStart, ...],
    reference: FrictionCurve,
    life: FluidLife,
    distance_m: float,
    peers: Peers | None,
) -> FluidLife | None:
    """Return a life as it was at a distance; None: there were too few results."""
    odometer_m = history.odometer_m[life.first] + distance_m
    stop = min(int(np.searchsorted(history.odometer_m, odometer_m, side="right")), life.stop)
    if stop - life.first < LEAST_ROWS:
        return None
    so_far = tuple(one for one in starts if one.row <= life.first)
    return fluid_lives(history.first(stop), so_far, reference, peers)[-1]


def _end(life: FluidLife) -> Passage:
    return either(life, CHANGE_MARGIN_RATIO, CHANGE_LEVEL_RATIO)


def _has_ended(life: FluidLife) -> bool:
    return _end(life).within(0.0) >= 0.5


def _course(channel: AgedChannel, distance_m: float) -> Course:
    """Return start and mean loss of a channel; by distance, whatever clock explains it better."""
    start, start_std = summary(channel.by_distance, Part.SEEN_START)
    fall, fall_std = fallen(channel.by_distance)
    return Course(
        start=start,
        start_std=start_std,
        loss_per_m=fall / max(distance_m, 1.0),
        loss_std_per_m=fall_std / max(distance_m, 1.0),
    )
