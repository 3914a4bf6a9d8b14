"""The lives of the fluids of one clutch so far: each fitted by itself, one saying what to expect of the next."""

from dataclasses import dataclass, replace

import numpy as np

from clutch_model.calibration import FrictionCurve
from diag_service.diagnosis.prognosis.assumptions import (
    LEAST_ROWS,
    LEVEL_OF_NEW,
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
from diag_service.diagnosis.prognosis.changes import FluidStart
from diag_service.diagnosis.prognosis.channels import Channel, ChannelName, Clock, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.population import Peers
from diag_service.diagnosis.prognosis.trend import (
    Fit,
    Mixture,
    Part,
    Passage,
    aged,
    fit,
    log_evidence,
    passage,
    summary,
)

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

    prior: ChannelPrior
    by_distance: Fit  # where the fluid ages by distance alone
    mixtures: tuple[Mixture, ...]  # of the likely clocks; all weights together sum to one

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
        channels = {
            one.name: _aged_channel(one, clocks, _prior(one.name, before, peers, is_new=is_new))
            for one in channels_of(history, start.row, stop, reference, clocks)
        }
        lives.append(
            FluidLife(
                is_new=is_new,
                is_noted=start.is_noted,
                first=start.row,
                stop=stop,
                distance_m=float(history.odometer_m[stop - 1] - history.odometer_m[start.row]),
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
        start, std = summary(last.by_distance, Part.START)
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
    likely = log_prior + log_evidence(channel, prior, random_per_m)

    def fitted(clock: int, amount: int) -> Fit:
        return fit(channel, clock, float(clocks[clock].age_m[-1]), prior, float(random_per_m[amount]))

    mixtures, evidence = [], []
    for place in np.argsort(-likely, axis=None)[:MOST_CLOCKS]:
        clock, amount = divmod(int(place), len(random_per_m))
        if likely[clock, amount] < likely.max() + LEAST_LOG_EVIDENCE:
            break
        mixture, of_ageing = aged(fitted(clock, amount), prior, clocks[clock], float(random_per_m[amount]))
        mixtures.append(mixture)
        evidence.append(of_ageing + log_prior[clock, amount])
    share = np.exp(np.array(evidence) - max(evidence))
    share /= share.sum()
    return AgedChannel(
        prior=prior,
        by_distance=fitted(0, int(np.argmax(likely[0]))),
        mixtures=tuple(
            replace(one, weight=one.weight * part) for one, part in zip(mixtures, share.tolist(), strict=True)
        ),
    )


def either(life: FluidLife, margin_limit: float, level_limit: float) -> Passage:
    """Return when the margin or the level passes its limit; the level that of new fluid or that of its own start."""
    margin = passage(life.channels[ChannelName.MARGIN].mixtures, [(margin_limit, 0.0)])
    level = passage(life.channels[ChannelName.LEVEL].mixtures, [(level_limit, 0.0), (0.0, level_limit)])
    return margin.or_(level)
