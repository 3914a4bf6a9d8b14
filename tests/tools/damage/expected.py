"""What can be known of a damaged recording, and whether that is what the service said of it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from canlog.frames import MAX_GAP_NS
from diag_service.diagnosis.records import FrictionEstimate, ShiftEstimate, Status
from ecu_emulator.bus.frames import EncodedFrames
from tests.tools.damage.recordings import NS_PER_US, Outcome, times_us, true_friction

MOST_STD = 4.0  # an estimate may be off, by its own account


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """Where all times begin to be later, or earlier, than they were."""

    to_ns: int  # the first of the moved times
    by_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """What must be true of the damaged recording; None where it cannot be known."""

    frames: int | None = None
    rejected: int | None = None  # lines, objects, rows
    jumps_back: int | None = None
    jumps_ahead: int | None = None
    repeated: int | None = None
    is_beginning: bool = False  # the frames are the first ones of the sound recording
    must_be_noticed: bool = False
    jump: Jump | None = None  # no shift may reach over it


def expected_of(frames: EncodedFrames, clock_us: int, jump: Jump | None = None) -> Expected:
    """Return what must be counted in a sound file that holds these frames."""
    t_us = times_us(frames) // clock_us * clock_us
    steps_us = np.diff(t_us)
    same = (frames.can_id[1:] == frames.can_id[:-1]) & (frames.data[1:] == frames.data[:-1]).all(axis=1)
    return Expected(
        frames=len(frames),
        rejected=0,
        jumps_back=int(np.count_nonzero(steps_us < 0)),
        jumps_ahead=int(np.count_nonzero(steps_us * NS_PER_US > MAX_GAP_NS)),
        repeated=int(np.count_nonzero(same & (steps_us == 0))),
        jump=jump,
    )


def faults(expected: Expected, damaged: Outcome, sound: Outcome) -> Iterator[str]:
    """Yield what must not be, in words."""
    if "\n" in damaged.error:
        yield "an error of several lines"
    yield from wrong_counts(expected, damaged)
    if expected.must_be_noticed and not is_noticed(damaged, sound):
        yield "nothing says that the recording is damaged"
    if expected.is_beginning and not is_beginning(damaged, sound):
        yield "frames that the sound recording does not begin with"
    for estimate in damaged.estimates:
        if estimate.status is Status.VALID and estimate.friction is not None:
            yield from wrong_estimate(estimate, estimate.friction, sound)
            if expected.jump is not None and not is_on_one_side(estimate, sound, expected.jump):
                yield f"the shift at {estimate.start_ns} ns reaches over a jump of time"


def wrong_counts(expected: Expected, damaged: Outcome) -> Iterator[str]:
    """Yield the counts that differ from what was done."""
    counts = damaged.counts
    found = {
        "frames": counts.frames,
        "rejected": sum(counts.rejected.values()),
        "jumps_back": counts.jumps_back,
        "jumps_ahead": counts.jumps_ahead,
        "repeated": counts.repeated,
    }
    for name, value in found.items():
        wanted = getattr(expected, name)
        if wanted is not None and value != wanted:
            yield f"{name}: {value} instead of {wanted}{f' ({damaged.error})' if damaged.error else ''}"


def is_noticed(damaged: Outcome, sound: Outcome) -> bool:
    """Return whether anything says that the recording is not what it was."""
    return damaged.error != "" or damaged.counts != sound.counts


def is_beginning(damaged: Outcome, sound: Outcome) -> bool:
    """Return whether the frames are the first ones of the sound recording."""
    count = len(damaged.frames)
    first = sound.frames[:count]
    return len(first) == count and all(
        np.array_equal(getattr(damaged.frames, column), getattr(first, column))
        for column in ("t_ns", "can_id", "length", "data")
    )


def wrong_estimate(estimate: ShiftEstimate, friction: FrictionEstimate, sound: Outcome) -> Iterator[str]:
    """Yield how an estimate contradicts the truth, or that of the same shift of the sound recording."""
    where = f"of the shift {estimate.from_gear}-{estimate.to_gear} at {estimate.start_ns} ns"
    truth = true_friction()[estimate.clutch - 1]
    others = [
        other.friction
        for other in sound.estimates
        if (other.from_gear, other.to_gear) == (estimate.from_gear, estimate.to_gear) and other.friction is not None
    ]
    for name in ("mu_c", "mu_s"):
        value, std = getattr(friction, name), getattr(friction, f"std_{name}")
        if abs(value - truth[name]) > MOST_STD * std:
            yield f"{name} {where} is {value:.4f}, std {std:.4f}; the truth is {truth[name]:.4f}"
        for other in others:
            random_std = max(getattr(friction, f"random_std_{name}"), getattr(other, f"random_std_{name}"))
            if abs(value - getattr(other, name)) > MOST_STD * random_std:
                was = f"{getattr(other, name):.4f}, random std {random_std:.4f}"
                yield f"{name} {where} is {value:.4f}; without damage it was {was}"


def is_on_one_side(estimate: ShiftEstimate, sound: Outcome, jump: Jump) -> bool:
    """Return whether a shift of the sound recording was found as a whole, or what comes of it after the jump."""
    start_ns, end_ns = estimate.start_ns, estimate.end_ns
    return any(
        (start_ns, end_ns) == (other.start_ns, other.end_ns)
        or (end_ns == other.end_ns + jump.by_ns and start_ns >= max(other.start_ns + jump.by_ns, jump.to_ns))
        for other in sound.estimates
    )
