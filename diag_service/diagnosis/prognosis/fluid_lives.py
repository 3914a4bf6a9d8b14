"""The lives of the fluids of one clutch so far: each fitted by itself, one saying what to expect of the next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from clutch_model.calibration import FrictionCurve
from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO
from diag_service.diagnosis.prognosis import trend
from diag_service.diagnosis.prognosis.assumptions import (
    LEAST_ROWS,
    LEVEL_OF_NEW,
    LIFE_LOG_STD,
    MARGIN_OF_NEW,
    NEW_WITHIN_M,
    NEXT_FLUID_LOG_STD,
    RANDOMNESS,
    START_SCATTER,
    UNKNOWN_LEVEL,
    UNKNOWN_MARGIN,
    USUAL_LIFE_M,
    ChannelPrior,
)
from diag_service.diagnosis.prognosis.changes import FluidStart, fluid_starts
from diag_service.diagnosis.prognosis.channels import Channel, ChannelName, Clock, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.population import Ageing, Course, Hindsight, PeerGroup, Peers, Population

MOST_CLOCKS = 6  # that are looked at for bends
LEAST_LOG_EVIDENCE = -4.6  # of a clock against the best: one in a hundred
CHANGE_MARGIN_RATIO = 0.0  # the slope turns: what the verdict calls a negative slope
_OF_NEW = {ChannelName.MARGIN: MARGIN_OF_NEW, ChannelName.LEVEL: LEVEL_OF_NEW}
_UNKNOWN = {ChannelName.MARGIN: UNKNOWN_MARGIN, ChannelName.LEVEL: UNKNOWN_LEVEL}


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """A number and its standard deviation."""

    mean: float
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AgedChannel:
    """One channel with one fluid: what each clock makes of it."""

    by_distance: trend.Fit  # where the fluid ages by distance alone
    mixtures: tuple[trend.Mixture, ...]  # of the likely clocks; all weights together sum to one

    @property
    def rate_per_m(self) -> Value:
        """How fast it falls, as fluids do."""
        weight = np.concatenate([one.weight for one in self.mixtures])
        rate = np.concatenate([one.rate_per_m * one.clock.pace for one in self.mixtures])
        mean = float(weight @ rate)
        return Value(mean=mean, std=float(np.sqrt(weight @ (rate - mean) ** 2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidLife:
    """The life of one fluid so far."""

    is_new: bool  # was, when first seen
    is_noted: bool
    first: int  # row
    stop: int  # row after the last
    distance_m: float
    usual: trend.UsualLife | None  # of its kind; None: how old it is is not known
    channels: dict[ChannelName, AgedChannel]


def fluid_lives(
    history: History, starts: tuple[FluidStart, ...], reference: FrictionCurve, peers: Peers | None
) -> list[FluidLife]:
    """Return the life of each fluid with enough results; one says what to expect of the next."""
    lives: list[FluidLife] = []
    stops = [*(start.row for start in starts[1:]), len(history)]
    for start, stop in zip(starts, stops, strict=True):
        if stop - start.row < LEAST_ROWS:
            continue
        is_new = _is_new(history, start)
        clocks = clocks_of(history, start.row, stop, is_new=is_new)
        before = next((life for life in reversed(lives) if life.is_new), None)
        priors = {name: _prior(name, before, peers, is_new=is_new) for name in ChannelName}
        channels = {
            one.name: _aged_channel(one, clocks, priors[one.name])
            for one in channels_of(history, start.row, stop, reference, clocks)
        }
        margin = priors[ChannelName.MARGIN]
        distance_m = float(history.odometer_m[stop - 1] - history.odometer_m[start.row])
        lives.append(
            FluidLife(
                is_new=is_new,
                is_noted=start.is_noted,
                first=start.row,
                stop=stop,
                distance_m=distance_m,
                usual=trend.UsualLife(
                    age_m=distance_m,
                    median_m=margin.start / margin.typical_rate_per_m,
                    log_std=min(margin.typical_log_std, LIFE_LOG_STD),
                )
                if is_new
                else None,
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
        start, std = trend.summary(last.by_distance, trend.Part.START)
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


def _aged_channel(channel: Channel, clocks: tuple[Clock, ...], prior: ChannelPrior) -> AgedChannel:
    """Return what the likely clocks make of a channel, each with the amounts of random wear that are likely."""
    random_per_m = (prior.usual_wear * np.array(list(RANDOMNESS))) ** 2 / USUAL_LIFE_M
    log_prior = np.add.outer([one.log_prior for one in clocks], np.log(list(RANDOMNESS.values())))
    likely = log_prior + trend.log_evidence(channel, prior, random_per_m)
    plainest, least = int(np.argmax(likely[0])), likely.max() + LEAST_LOG_EVIDENCE
    likely[0, 0] = np.inf  # even wear by distance is always tried: without its bends a knee looks like random wear

    def fitted(clock: int, amount: int) -> trend.Fit:
        return trend.fit(channel, clock, float(clocks[clock].age_m[-1]), prior, float(random_per_m[amount]))

    mixtures, evidence = [], []
    for place in np.argsort(-likely, axis=None)[:MOST_CLOCKS]:
        clock, amount = divmod(int(place), len(random_per_m))
        if likely[clock, amount] < least:
            break
        mixture, of_ageing = trend.aged(fitted(clock, amount), prior, clocks[clock], float(random_per_m[amount]))
        mixtures.append(mixture)
        evidence.append(of_ageing + log_prior[clock, amount])
    share = np.exp(np.array(evidence) - max(evidence))
    share /= share.sum()
    return AgedChannel(
        by_distance=fitted(0, plainest),
        mixtures=tuple(
            replace(one, weight=one.weight * part) for one, part in zip(mixtures, share.tolist(), strict=True)
        ),
    )


def either(life: FluidLife, margin_limit: float, level_limit: float) -> trend.Passage:
    """Return when the margin or the level passes its limit; the level that of new fluid or that of its own start."""
    margin = trend.passage(life.channels[ChannelName.MARGIN].mixtures, [(margin_limit, 0.0)])
    level = trend.passage(life.channels[ChannelName.LEVEL].mixtures, [(level_limit, 0.0), (0.0, level_limit)])
    return margin.or_(level)


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


def _end(life: FluidLife) -> trend.Passage:
    return either(life, CHANGE_MARGIN_RATIO, CHANGE_LEVEL_RATIO)


def _has_ended(life: FluidLife) -> bool:
    return _end(life).within(0.0) >= 0.5


def _course(channel: AgedChannel, distance_m: float) -> Course:
    """Return start and mean loss of a channel; by distance, whatever clock explains it better."""
    start, start_std = trend.summary(channel.by_distance, trend.Part.SEEN_START)
    fall, fall_std = trend.fallen(channel.by_distance)
    return Course(
        start=start,
        start_std=start_std,
        loss_per_m=fall / max(distance_m, 1.0),
        loss_std_per_m=fall_std / max(distance_m, 1.0),
    )
