"""Capability tiers: what a set of canonical signals suffices for, and what is missing for more.

Only the first tier speaks of friction; the others say what torques or speeds alone can tell.
"""

from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from typing import Final

from clutch_model.calibration import TorqueSource
from clutch_results.records import Tier
from diag_service.diagnosis.columns import BALANCE_SIGNALS, LOCKUP_SIGNALS, Signal

Alternative = frozenset[Signal]
Requirement = tuple[Alternative, ...]  # one of these sets

GEAR_PAIR: Final = frozenset({Signal.CURRENT_GEAR, Signal.TARGET_GEAR})
INPUT_PAIR: Final = frozenset({Signal.INPUT1_SPEED, Signal.INPUT2_SPEED})
INPUT: Final = frozenset({Signal.INPUT_SPEED})
TORQUE_COMMANDS: Final = frozenset({Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND})

PRESSURES: Final = frozenset({Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE})

MANDATORY: Final = frozenset({*BALANCE_SIGNALS, Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.SUMP_TEMPERATURE})
"""Without these there is no friction of dual clutches to estimate."""

FRICTION_SIGNALS: Final = MANDATORY | LOCKUP_SIGNALS

_SPEED: Final[Requirement] = (frozenset({Signal.ENGINE_SPEED}),)
_GEARS: Final[Requirement] = (
    GEAR_PAIR,
    frozenset({Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *INPUT}),
    frozenset({Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *INPUT_PAIR}),
)
_REQUIREMENTS: Final[dict[Tier, tuple[Requirement, ...]]] = {
    Tier.FRICTION: (_GEARS, *((frozenset({signal}),) for signal in Signal if signal in MANDATORY - GEAR_PAIR)),
    Tier.TORQUE: (
        _SPEED,
        _GEARS,
        (frozenset({Signal.ENGINE_TORQUE}),),
        (TORQUE_COMMANDS, frozenset({Signal.CLUTCH_TORQUE})),
        (INPUT_PAIR, INPUT),
    ),
    Tier.KINEMATIC: (_SPEED, (*_GEARS, frozenset({Signal.CURRENT_GEAR}))),
}

PURPOSE: Final[dict[Tier, str]] = {
    Tier.FRICTION: "friction",
    Tier.TORQUE: "torque capacity",
    Tier.KINEMATIC: "shift time and slip",
}
"""What each tier yields, for people."""


def tier_of(signals: AbstractSet[Signal], *, knows_gears: bool = False, has_converter: bool = False) -> Tier | None:
    """Return the best tier that the signals suffice for, or None if not even shifts can be found.

    ``knows_gears`` says that gears can be told from the ratio of speeds instead of gear signals; ``has_converter`` that
    it is about a lock-up clutch.
    """
    if has_converter:
        return Tier.FRICTION if signals >= LOCKUP_SIGNALS else None
    return next((tier for tier in Tier if not any(_unmet(tier, signals, knows_gears=knows_gears))), None)


def missing_for_next(signals: AbstractSet[Signal], *, knows_gears: bool = False, has_converter: bool = False) -> str:
    """Return one sentence: what the next better tier is and lacks; empty at the first tier."""
    if has_converter:
        lacking = LOCKUP_SIGNALS - signals
        return f"{PURPOSE[Tier.FRICTION]} of a lock-up clutch needs {_joined(lacking)}" if lacking else ""
    tier = tier_of(signals, knows_gears=knows_gears)
    if tier is Tier.FRICTION:
        return ""
    if Signal.LOCKUP_PRESSURE in signals:
        return "friction of a lock-up clutch needs a description with its converter (--calibration lockup)"
    wanted = Tier.KINEMATIC if tier is None else Tier(tier - 1)
    verb = "need" if " and " in PURPOSE[wanted] else "needs"
    missing = (
        " or ".join(dict.fromkeys(_joined(alternative - signals) for alternative in requirement))
        for requirement in _unmet(wanted, signals, knows_gears=knows_gears)
    )
    return f"{PURPOSE[wanted]} {verb} {', '.join(missing)}"


def why_no_friction(
    signals: AbstractSet[Signal], torque: TorqueSource, *, knows_gears: bool = False, has_converter: bool = False
) -> str:
    """Return one sentence: why there is no verdict on friction; empty at the first tier."""
    if (Signal.ENGINE_TORQUE not in signals or torque.is_modelled) and signals >= PRESSURES:
        return "engine torque is not measured, and without it the level of friction is known up to a scale at best"
    return missing_for_next(signals, knows_gears=knows_gears, has_converter=has_converter)


def _unmet(tier: Tier, signals: AbstractSet[Signal], *, knows_gears: bool) -> Iterator[Requirement]:
    for requirement in _REQUIREMENTS[tier]:
        if knows_gears and requirement[: len(_GEARS)] == _GEARS:
            continue
        if not any(alternative <= signals for alternative in requirement):
            yield requirement


def _joined(signals: Iterable[Signal]) -> str:
    return " and ".join(signal.value for signal in Signal if signal in set(signals))
