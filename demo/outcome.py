"""The outcome of a demonstration: estimates beside the truth, frames of both ends, and what is wrong with them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from demo.listener import ClutchState
from diag_service.diagnosis.records import FrictionEstimate, ShiftResult
from ecu_emulator.truth.records import ShiftTruth, TruthLog
from fleet_contract import CLUTCHES

MAX_ERROR_STD = 4.0  # beyond it an estimate is wrong, not unlucky: 6e-5 by chance
SHIFTS_PER_CYCLE = 10  # 1-2-3-4-5-6-5-4-3-2-1


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One estimated friction coefficient beside its true value."""

    name: str
    estimate: float
    std: float
    truth: float

    @property
    def error_std(self) -> float:
        """The error in units of the standard deviation that the service stated."""
        return (self.estimate - self.truth) / self.std


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameAccount:
    """Frames at both ends of the bus."""

    sent: int
    given_up: int  # the emulator's interface did not take them
    lateness_max_s: float  # of sending, against the schedule
    on_bus: int  # seen by the service's interface
    decoded: int
    ignored: int
    rejected: Mapping[str, int]
    dropped: int  # by kernel or service, counted by them
    missing: int  # noticed by alive counters

    @property
    def arrived(self) -> int:
        """Frames that the service judged."""
        return self.decoded + self.ignored + sum(self.rejected.values())

    @property
    def unexplained(self) -> int:
        """Frames sent of which the service knows nothing: neither judged nor noticed as lost."""
        return self.sent - self.arrived - max(self.missing, self.dropped)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Everything that a demonstration ends with."""

    cycles: int
    shifts: tuple[ShiftResult, ...]  # as received from the broker
    clutches: Mapping[int, ClutchState]  # as kept by the broker
    truth: TruthLog
    frames: FrameAccount

    def true_shift(self, result: ShiftResult) -> ShiftTruth | None:
        """Return the truth about a shift, if the emulator drove it."""
        for shift in self.truth.shifts:
            if shift.number == result.estimate.number:
                is_same = (shift.from_gear, shift.to_gear) == (result.estimate.from_gear, result.estimate.to_gear)
                return shift if is_same else None
        return None

    def true_friction(self, clutch: int) -> tuple[float, float]:
        """Return mu_C and mu_S of a clutch as they were when it engaged last."""
        latest = [shift for shift in self.truth.shifts if shift.clutch == clutch]
        if latest:
            return latest[-1].mu_c, latest[-1].mu_s
        return self.truth.drive.mu_c[clutch - 1], self.truth.drive.mu_s[clutch - 1]


def frame_account(transmitted: Mapping[str, object], received: Mapping[str, object]) -> FrameAccount:
    """Return the account from the emulator's transmit report and the ``frames`` of the service's summary."""
    rejected = received["rejected"]
    return FrameAccount(
        sent=_count(transmitted, "frames_sent"),
        given_up=_count(transmitted, "frames_given_up"),
        lateness_max_s=_number(transmitted, "lateness_max_s"),
        on_bus=_count(received, "on_bus"),
        decoded=_count(received, "decoded"),
        ignored=_count(received, "ignored"),
        rejected={str(name): int(count) for name, count in rejected.items()} if isinstance(rejected, dict) else {},
        dropped=_count(received, "kernel_dropped") + _count(received, "queue_dropped"),
        missing=_count(received, "missing"),
    )


def compare(friction: FrictionEstimate, mu_c: float, mu_s: float) -> tuple[Comparison, Comparison]:
    """Return both coefficients beside the truth."""
    return (
        Comparison(name="mu_C", estimate=friction.mu_c, std=friction.std_mu_c, truth=mu_c),
        Comparison(name="mu_S", estimate=friction.mu_s, std=friction.std_mu_s, truth=mu_s),
    )


def complaints(outcome: Outcome) -> list[str]:
    """Return everything that is not as it must be; nothing if the demonstration succeeded."""
    return [
        *_shift_complaints(outcome),
        *_clutch_complaints(outcome),
        *_frame_complaints(outcome.frames),
    ]


def _shift_complaints(outcome: Outcome) -> Iterator[str]:
    expected = SHIFTS_PER_CYCLE * outcome.cycles
    driven = len(outcome.truth.shifts)
    if driven != expected:
        yield f"the emulator drove {driven} shifts, not {expected}"
    if len(outcome.shifts) != driven:
        yield f"{len(outcome.shifts)} of {driven} shifts arrived"
    for result in outcome.shifts:
        estimate = result.estimate
        name = f"shift {estimate.number} ({estimate.from_gear}-{estimate.to_gear})"
        true = outcome.true_shift(result)
        if true is None:
            yield f"{name} was not driven"
        elif estimate.friction is None:
            reasons = ", ".join(reason.value.replace("_", " ") for reason in estimate.reasons)
            yield f"{name} gave no estimate: {estimate.status.value}, {reasons}"
        else:
            yield from _errors(name, compare(estimate.friction, true.mu_c, true.mu_s))


def _clutch_complaints(outcome: Outcome) -> Iterator[str]:
    for clutch in CLUTCHES:
        state = outcome.clutches.get(clutch)
        if state is None:
            yield f"the broker keeps no state of clutch {clutch}"
        elif state.friction is None:
            yield f"clutch {clutch} has no running estimate"
        else:
            name = f"the running estimate of clutch {clutch}"
            yield from _errors(name, compare(state.friction, *outcome.true_friction(clutch)))


def _frame_complaints(frames: FrameAccount) -> Iterator[str]:
    if frames.given_up:
        yield f"the bus did not take {frames.given_up} frames"
    if frames.on_bus != frames.arrived + frames.dropped:
        yield f"{frames.on_bus} frames were on the bus, the service accounts for {frames.arrived + frames.dropped}"
    if frames.unexplained > 0:
        yield f"{frames.unexplained} of {frames.sent} frames were lost without a trace"
    if frames.unexplained < 0:
        yield f"{-frames.unexplained} frames on the bus were not the emulator's"


def _errors(name: str, pairs: Sequence[Comparison]) -> Iterator[str]:
    for pair in pairs:
        if not abs(pair.error_std) <= MAX_ERROR_STD:
            yield f"{name}: {pair.name} is off by {pair.error_std:+.1f} std"


def _count(table: Mapping[str, object], key: str) -> int:
    value = table[key]
    if not isinstance(value, int):
        raise TypeError(f"{key} must be a count, got {value!r}")
    return value


def _number(table: Mapping[str, object], key: str) -> float:
    value = table[key]
    if not isinstance(value, float):
        raise TypeError(f"{key} must be a number, got {value!r}")
    return value
