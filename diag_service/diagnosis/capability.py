"""What the signals of a run suffice for, what friction lacks, and who could be asked for it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from clutch_model.calibration import TorqueSource
from clutch_results.records import ShiftResult, Tier
from fleet_contract.orders import LEVEL_UNTOLD

TIER_TEXT: Final = {
    Tier.FRICTION: "friction",
    Tier.TORQUE: "torque capacity, no friction",
    Tier.KINEMATIC: "shift time and slip, no friction",
}
LOCKUP_TIER_TEXT: Final = TIER_TEXT | {
    Tier.TORQUE: "slope of friction over slip, no level",
    Tier.KINEMATIC: "slip and shudder, no friction",
}
TORQUE_TEXT: Final = {
    TorqueSource.MODELLED: "engine torque is modelled, not measured: friction is told up to a scale, its level is not",
    TorqueSource.WITHOUT_CUT: (
        "engine torque is modelled, not measured, and does not show what a shift takes away: only launches, creeping "
        "and slips in gear tell friction, up to a scale"
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalNeed:
    """A signal that friction needs and that no frame told."""

    signal: str  # canonical, as profiles have it
    name: str  # for people
    request: str = (
        ""  # that asks a controller for it, hexadecimal: 22 38EB at 7E1; empty: none is known for the vehicle
    )
    profile: str = ""  # in which that stands


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """What the signals of a run suffice for."""

    profile: str = "dct"
    tier: Tier | None = Tier.FRICTION  # None: not even shifts can be found
    missing: str = ""  # what the next better tier needs; empty at the first
    unseen: tuple[str, ...] = ()  # mapped canonical signals that never had a value
    torque: TorqueSource = TorqueSource.MEASURED  # of the engine
    elements: tuple[str, ...] = ()  # names of the clutches, where they are no pair
    needs: tuple[SignalNeed, ...] = ()  # what friction lacks, signal by signal
    absent: tuple[str, ...] = ()  # sentences on signals that stand still where physics demands motion


FULL = Capability()


NEEDS_HEAD: Final = "What would be needed for friction"
AT_THE_CAR: Final = (
    "At the car, diag-service try --active asks for what other cars tell, and diag-service scan --active finds who can "
    "be asked; without --active both only listen."
)


def need_lines(capability: Capability) -> Iterator[str]:
    """Yield for people what friction lacks, and by which request or command each could be had."""
    asked = [need for need in capability.needs if need.request]
    for need in asked:
        answer = ", and no value came" if need.profile == capability.profile else ""
        yield f"{need.name}: asked for by {need.request} (profile {need.profile}){answer}"
    if others := ", ".join(need.name for need in capability.needs if not need.request):
        yield f"{others}: not among what was read, and no request is known for this car"
    for profile in dict.fromkeys(need.profile for need in asked if need.profile != capability.profile):
        yield f"At the car, diag-service try --profile {profile} --active asks for them; without --active it says how."
    if others and not asked:
        yield AT_THE_CAR


def is_relative(untold: Sequence[ShiftResult]) -> bool:
    """Return whether all that is lacking of a vehicle's friction is its scale."""
    return bool(untold) and LEVEL_UNTOLD in str(untold[-1].verdict.advice)
