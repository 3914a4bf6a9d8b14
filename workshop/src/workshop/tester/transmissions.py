"""Dual clutches and lock-up clutches before their owner: what a drive tells, how to drive, and what is done with it."""

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Final, Protocol

from clutch_results.records import Tier
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.mapped_messages import is_of_lockup
from workshop.tester.signal_asking import LEAST_ROWS

SHUDDER_SETS_HZ: Final = 25.0  # shudder swings 5 to 12 times a second
_OF_ALL: Final = (
    ": starts and gear changes can be judged. From the second drive on you learn how good the friction of both "
    "clutches is, and whether it changes"
)
_OF_STARTS: Final = (
    ": starts from standstill can be judged where the clutch slips for {slip_s:.2g} s, gear changes are over too soon. "
    "From the second drive on you learn how good the friction of clutch 1 is, and whether it changes. Clutch 2 stays "
    "unknown. A faster adapter tells more"
)
_OF_SLOW_STARTS: Final = (
    ": only slow starts from standstill can be judged, in which the clutch slips for {slip_s:.2g} s. From the third "
    "drive on you learn whether the friction of clutch 1 changes, but not how good it is. Clutch 2 stays unknown. A "
    "faster adapter tells more"
)
_BY_RATE: Final = (  # [sets/s]; emulated, city: at 14 no shift counted, at 24 both clutches became known
    (20.0, _OF_ALL),
    (5.0, _OF_STARTS),
    (0.0, _OF_SLOW_STARTS),
)
Run = Callable[[list[str]], object]


class Transmission(Protocol):
    """What differs between kinds of transmissions for whoever owns one."""

    @property
    def purpose(self) -> Mapping[Tier, str]:
        """What a drive tells by tier."""

    @property
    def route(self) -> str:
        """How to drive."""

    def promise(self, tier: Tier, rate_hz: float) -> str:
        """Return what a drive will tell at so many sets a second, as the end of a sentence that says how many."""

    def lacks(self, answered: AbstractSet[Signal], needed: str) -> str:
        """Return what friction needs beside what a car tells; empty if that is nothing."""

    def judge(self, log: Path, words: list[str], run: Run, show: Callable[[str], object]) -> list[str]:
        """Diagnose a drive by commands that a person could type; return the words that name the vehicle in others."""


class DualClutchTransmission:
    """Two wet clutches; a drive teaches which gears and clutches the car has."""

    purpose: Final = {
        Tier.FRICTION: "the friction of both clutches",
        Tier.TORQUE: "the torque that the clutches carry, not their friction",
        Tier.KINEMATIC: "how long gear changes take, nothing of friction",
    }
    route: Final = "through all gears, accelerating and rolling"

    def promise(self, tier: Tier, rate_hz: float) -> str:
        """Return what a drive will tell at so many sets a second."""
        if tier is not Tier.FRICTION:
            return ""
        words = next(text for least_hz, text in _BY_RATE if rate_hz >= least_hz)
        return words.format(slip_s=LEAST_ROWS / rate_hz)

    def lacks(self, answered: AbstractSet[Signal], needed: str) -> str:
        """Return what friction needs beside what a car tells; empty if that is nothing."""
        del answered
        return f"Friction also needs: {needed}." if needed else ""

    def judge(self, log: Path, words: list[str], run: Run, show: Callable[[str], object]) -> list[str]:
        """Learn the vehicle from its drive and diagnose it."""
        description, named = description_path(log), list[str]()
        try:
            run(["learn", str(log), *words, "-o", str(description)])
            named = ["--vehicle-file", str(description)]
        except ConfigError as exc:
            show(str(exc))
        run(["analyze", str(log), *words, *named])
        return named


class LockUpTransmission:
    """A torque converter with a lock-up clutch; what is known of its type is shipped."""

    purpose: Final = {
        Tier.FRICTION: "the friction of the lock-up clutch",
        Tier.TORQUE: "whether friction of the lock-up clutch rises with slip (good) or falls (it can shudder)",
        Tier.KINEMATIC: "slip and shudder of the lock-up clutch, nothing of its friction",
    }
    route: Final = "steadily and gently accelerating in the higher gears, so that the lock-up clutch slips"

    def promise(self, tier: Tier, rate_hz: float) -> str:
        """Return what a drive will tell at so many sets a second."""
        del tier
        if rate_hz < SHUDDER_SETS_HZ:
            return f". Shudder itself is too fast for that: it takes {SHUDDER_SETS_HZ:g} times a second"
        return ": fast enough to see shudder, too"

    def lacks(self, answered: AbstractSet[Signal], needed: str) -> str:
        """Return what friction needs beside what a car tells; empty if that is nothing."""
        if Signal.LOCKUP_PRESSURE_COMMAND in answered and Signal.LOCKUP_PRESSURE not in answered:
            return "How good the friction is stays unknown: the car tells the commanded pressure, not the measured one."
        return f"Friction also needs: {needed}." if needed else ""

    def judge(self, log: Path, words: list[str], run: Run, show: Callable[[str], object]) -> list[str]:
        """Diagnose the drive: there are no gears and clutches to be learned."""
        del show
        named = ["--calibration", "lockup"]
        run(["analyze", str(log), *words, *named])
        return named


def transmission_of(signals: AbstractSet[Signal]) -> Transmission:
    """Return the kind of transmission that has such signals."""
    return LockUpTransmission() if is_of_lockup(signals) else DualClutchTransmission()


def description_path(log: Path) -> Path:
    """Return where the description that a log teaches is written: beside it."""
    return log.with_suffix(".vehicle.toml")
