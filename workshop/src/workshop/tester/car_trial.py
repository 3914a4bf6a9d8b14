"""What a car tells by one profile, what that suffices for, and why not for more."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Self

from cantools.database.can import Database

from clutch_results.records import Tier
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ControllerError
from diag_service.mapping.interpretation import fit_of, open_database
from diag_service.mapping.mapped_messages import fitting, is_of_lockup, lacking, tier_of
from diag_service.mapping.profile import Profile
from diag_service.mapping.signal_words import listed
from workshop.tester.interview import AskOutcome, CarReply, value_words
from workshop.tester.listening import HeardTraffic
from workshop.tester.transmissions import Transmission, transmission_of

LEAST_SETS_HZ: Final = 1.0  # the longest launches slip for some five seconds, and an estimate needs five rows


class Doubt(IntEnum):
    """Whether what a profile says is broadcast can be."""

    HEARD = 0
    UNKNOWN = 1  # it needs nothing that is broadcast, or nothing can be heard
    NONE_HEARD = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class CarTrial:
    """What a car tells by one profile: what it answered, and what a database says is broadcast."""

    profile: Profile
    replies: tuple[CarReply, ...]
    broadcast: frozenset[Signal]
    doubt: Doubt

    @classmethod
    def of(
        cls, profile: Profile, replies: Sequence[CarReply], database: Database | None, traffic: HeardTraffic | None
    ) -> Self:
        broadcast, doubt = frozenset(profile.sources) - profile.asked.keys() - profile.groups.keys(), Doubt.UNKNOWN
        messages, _ = fitting(database or load_contract(), profile)
        if traffic is None:
            broadcast = frozenset()
        elif messages or (database is not None and not profile.is_of_columns):
            is_heard = any(message.address.can_id in traffic.can_ids for message in messages)
            doubt = Doubt.HEARD if is_heard else Doubt.UNKNOWN if profile.is_of_columns else Doubt.NONE_HEARD
        broadcast &= fit_of(database or open_database(profile.database), profile).signals
        return cls(profile=profile, replies=tuple(replies), broadcast=broadcast, doubt=doubt)

    @property
    def answered(self) -> frozenset[Signal]:
        return frozenset(signal for reply in self.replies if reply.has_answer for signal in reply.signals)

    @property
    def signals(self) -> frozenset[Signal]:
        return self.answered if self.doubt is Doubt.NONE_HEARD else self.answered | self.broadcast

    @property
    def transmission(self) -> Transmission:
        return transmission_of(self.profile.sources.keys())

    @property
    def conditions(self) -> dict[str, bool]:
        """What tiers are asked with: a drive teaches the ratios of gears by two speeds."""
        speeds = {Signal.VEHICLE_SPEED, Signal.OUTPUT_SPEED}
        teaches = Signal.ENGINE_SPEED in self.signals and not speeds.isdisjoint(self.signals)
        return {
            "knows_gears": teaches or self.profile.gears is not None,
            "has_converter": is_of_lockup(self.profile.sources.keys()),
        }

    @property
    def tier(self) -> Tier | None:
        return tier_of(self.signals, **self.conditions)

    @property
    def rank(self) -> tuple[bool, float, int, int]:
        """By which the best is the least."""
        return self.doubt is Doubt.NONE_HEARD, self.tier or math.inf, self.doubt, -len(self.answered)

    @property
    def count_words(self) -> str:
        """How many of its values the car answered."""
        return f"{len(self.answered)} of {len(self.profile.asked) + len(self.profile.groups)}"

    def _needed(self, tier: Tier) -> str:
        """Return what a tier also needs, of alternatives the least."""
        alternatives = (each[0] for each in lacking(tier, self.signals, **self.conditions))
        return listed(signal for alternative in alternatives for signal in alternative)

    @property
    def missing(self) -> str:
        """Why values are missing, and which; empty if none is."""
        by_outcome: dict[AskOutcome, list[Signal]] = {}
        for reply in self.replies:
            if not reply.has_answer:
                by_outcome.setdefault(reply.outcome, []).extend(reply.signals)
        return "; ".join(f"{outcome}: {listed(signals)}" for outcome, signals in by_outcome.items())

    def summary(self) -> str:
        """Return in lines what the car tells, and what that suffices for."""
        values = [f"  {value_words(signal, value)}" for reply in self.replies for signal, value in reply.values.items()]
        empty = [signal for reply in self.replies if reply.outcome is AskOutcome.EMPTY for signal in reply.signals]
        lines = [f"{self.profile.name} fits best: the car answers {self.count_words} values", *values]
        lines += [f"  no value now: {listed(empty)}"] if empty else []
        lines += [f"  {self.missing}"] if self.missing else []
        if self.broadcast:
            is_unheard = self.doubt is Doubt.NONE_HEARD
            more = "would be broadcast, but none of their messages was heard" if is_unheard else "are broadcast"
            lines.append(f"  {len(self.broadcast)} more values {more}")
        if self.is_enough and self.tier is not None:
            suffices = f"From these values a drive can tell {self.transmission.purpose[self.tier]}."
            lacks = self.transmission.lacks(self.answered, self._needed(Tier.FRICTION))
            lines.append(" ".join(filter(None, (suffices, lacks))))
        return "\n".join(lines)

    @property
    def is_enough(self) -> bool:
        """Whether a drive tells anything of friction."""
        return self.tier is not None and self.tier is not Tier.KINEMATIC

    def check(self) -> None:
        """Raise ControllerError if no drive tells anything of friction."""
        if not self.is_enough:
            least = Tier.TORQUE if self.conditions["has_converter"] else Tier.FRICTION
            raise ControllerError(
                f"no drive would tell anything of friction: it also takes {self._needed(least)}, and this car does not "
                "answer for them. A profile of your own may ask in another way: --profile names it"
            )

    def promise(self, rate_hz: float) -> str:
        """Return what a drive will tell by so many sets a second; raises ControllerError if that is nothing."""
        self.check()
        if not rate_hz:
            raise ControllerError("the car has stopped answering: leave the ignition on, and try again")
        if rate_hz < LEAST_SETS_HZ:
            raise ControllerError(
                f"all values came {rate_hz:.2g} times a second, which is too slow for any drive: it takes "
                f"{LEAST_SETS_HZ:g}. Try a faster adapter"
            )
        promise = "" if self.tier is None else self.transmission.promise(self.tier, rate_hz)
        return f"The values come {rate_hz:.2g} times a second{promise}."
