"""The lives of the fluids of one clutch so far: each fitted by itself, one saying what to expect of the next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from clutch_model.calibration import FrictionCurve
from clutch_results.curves import CHANGE_LEVEL_RATIO
from clutch_results.prognosis import trend
from clutch_results.prognosis.assumptions import (
    KNEE_PROBABILITY,
    LEAST_ROWS,
    LEVEL_OF_NEW,
    MARGIN_OF_NEW,
    NEW_WITHIN_M,
    NEXT_FLUID_LOG_STD,
    START_SCATTER,
    UNKNOWN_LEVEL,
    UNKNOWN_MARGIN,
    ChannelPrior,
)
from clutch_results.prognosis.changes import FluidStart, fluid_starts
from clutch_results.prognosis.channels import ChannelName, channels_of, clocks_of
from clutch_results.prognosis.history import History
from clutch_results.prognosis.population import Ageing, Course, PeerGroup, Peers

CHANGE_MARGIN_RATIO = 0.0  # the slope turns: what the verdict calls a negative slope
_OF_NEW = {ChannelName.MARGIN: MARGIN_OF_NEW, ChannelName.LEVEL: LEVEL_OF_NEW}
_UNKNOWN = {ChannelName.MARGIN: UNKNOWN_MARGIN, ChannelName.LEVEL: UNKNOWN_LEVEL}


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidLife:
    """The life of one fluid so far."""

    is_new: bool  # was, when first seen
    is_noted: bool
    first: int  # row
    stop: int  # row after the last
    distance_m: float
    channels: dict[ChannelName, trend.AgedChannel]


def fluid_lives(
    history: History, starts: tuple[FluidStart, ...], reference: FrictionCurve, peers: Peers | None
) -> list[FluidLife]:
    """Return the life of each fluid with enough results; one says what to expect of the next."""
    lives: list[FluidLife] = []
    bend_chance = KNEE_PROBABILITY if peers is None else peers.bend_chance
    stops = [*(start.row for start in starts[1:]), len(history)]
    for start, stop in zip(starts, stops, strict=True):
        if stop - start.row < LEAST_ROWS:
            continue
        is_new = _is_new(history, start)
        clocks = clocks_of(history, start.row, stop, is_new=is_new)
        before = next((life for life in reversed(lives) if life.is_new), None)
        priors = {name: _prior(name, before, peers, is_new=is_new) for name in ChannelName}
        channels = {
            channel.name: trend.aged(channel, clocks, priors[channel.name], bend_chance)
            for channel in channels_of(history, start.row, stop, reference, clocks)
        }
        distance_m = float(history.odometer_m[stop - 1] - history.odometer_m[start.row])
        lives.append(
            FluidLife(
                is_new=is_new,
                is_noted=start.is_noted,
                first=start.row,
                stop=stop,
                distance_m=distance_m,
                channels=channels,
            )
        )
    return lives


def _is_new(history: History, start: FluidStart) -> bool:
    """Return whether a fluid was new when first seen."""
    if start.is_noted:
        return int(history.fluid_number[start.row]) in history.new_fluids
    return start.odometer_m - float(history.odometer_m[start.row - 1]) <= NEW_WITHIN_M


def _prior(name: ChannelName, before: FluidLife | None, peers: Peers | None, *, is_new: bool) -> ChannelPrior:
    """Return what is believed of a channel with another fluid: that of the vehicle's last one, if there was one."""
    prior = _OF_NEW[name] if peers is None else peers.prior(name, _OF_NEW[name])
    if before is not None:
        last = before.channels[name]
        start, std = last.seen_start.mean, last.seen_start.std
        rate = -last.rate_per_m.mean
        prior = replace(
            prior,
            start=start,
            start_std=float(np.hypot(std, START_SCATTER[name])),
            typical_rate_per_m=rate,
            typical_log_std=float(min(np.hypot(NEXT_FLUID_LOG_STD, last.rate_per_m.std / rate), prior.typical_log_std)),
        )
    if is_new:
        return prior
    start, start_std = _UNKNOWN[name]
    return replace(prior, start=start, start_std=start_std)


def either(life: FluidLife, margin_limit: float, level_limit: float, part: slice = trend.ALL) -> trend.Passage:
    """Return when the margin or the level passes its limit; the level that of new fluid or that of its own start."""
    margin, level = life.channels[ChannelName.MARGIN].future, life.channels[ChannelName.LEVEL].future
    when = trend.passage(margin, [(margin_limit, 0.0)], part)
    return when.or_(trend.passage(level, [(level_limit, 0.0), (0.0, level_limit)], part))


_HALVINGS: Final = 6  # a fluid's end is found to a sixty-fourth of what was driven with it


def ageings(history: History, reference: FrictionCurve, kinds: Sequence[PeerGroup]) -> list[Ageing]:
    """Return what each fluid of a clutch that was new when first seen says of its kind.

    ``kinds`` are those of the fluids by their numbers in the history; that of a fill that nobody noted is not known.
    """
    starts = fluid_starts(history) if len(history) else ()
    lives = []
    for life in fluid_lives(history, starts, reference, None):
        if not life.is_new:
            continue
        kind = kinds[int(history.fluid_number[life.first])]
        until, has_ended = _until_its_end(history, starts, reference, life)
        lives.append(
            Ageing(
                kind=kind if life.is_noted else replace(kind, fluid=None),
                courses={name: _course(channel, until.distance_m) for name, channel in until.channels.items()},
                lasted_m=until.distance_m if has_ended else None,
                bent_odds=until.channels[ChannelName.MARGIN].bent_odds,
            )
        )
    return lives


def _until_its_end(
    history: History, starts: tuple[FluidStart, ...], reference: FrictionCurve, life: FluidLife
) -> tuple[FluidLife, bool]:
    """Return a life as it was when its limit was passed, and whether it was; else as far as it went."""
    if not _has_ended(life):
        return life, False
    near_m, far_m, ended = 0.0, life.distance_m, life
    for _ in range(_HALVINGS):
        middle_m = 0.5 * (near_m + far_m)
        then = _at(history, starts, reference, life, middle_m)
        if then is not None and _has_ended(then):
            far_m, ended = middle_m, then
        else:
            near_m = middle_m
    return ended, True


def _at(
    history: History, starts: tuple[FluidStart, ...], reference: FrictionCurve, life: FluidLife, distance_m: float
) -> FluidLife | None:
    """Return a life as it was at a distance; None: there were too few results."""
    odometer_m = history.odometer_m[life.first] + distance_m
    stop = min(int(np.searchsorted(history.odometer_m, odometer_m, side="right")), life.stop)
    if stop - life.first < LEAST_ROWS:
        return None
    so_far = tuple(start for start in starts if start.row <= life.first)
    return fluid_lives(history.first(stop), so_far, reference, None)[-1]


def _has_ended(life: FluidLife) -> bool:
    return either(life, CHANGE_MARGIN_RATIO, CHANGE_LEVEL_RATIO, slice(1)).within(0.0) >= 0.5


def _course(channel: trend.AgedChannel, distance_m: float) -> Course:
    """Return start and mean loss of a channel; by distance, whatever clock explains it better."""
    start, start_std = channel.seen_start.mean, channel.seen_start.std
    fall, fall_std = channel.fallen.mean, channel.fallen.std
    return Course(
        start=start,
        start_std=start_std,
        loss_per_m=fall / max(distance_m, 1.0),
        loss_std_per_m=fall_std / max(distance_m, 1.0),
    )
