"""What clutches had to bear, and what a part of the score of a gear change is worth."""

from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from clutch_results.event_kinds import EventKind
from clutch_results.records import ShiftEstimate

ENERGY_BOUNDS_J: Final = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0)


class Part(NamedTuple):
    """What a part of the score is worth: up to ``free`` it costs nothing, at ``felt`` its weight."""

    name: str  # of the field of `ShiftParts`
    weight: float
    free: float
    felt: float
    is_relative: bool = False  # it is felt beside the acceleration that the driver asked for


PARTS: Final = (
    Part("jerk_m_s3", 25.0, 12.0, 30.0, is_relative=True),
    Part("torque_hole_m_s2", 15.0, 0.8, 2.0, is_relative=True),
    Part("flare_rad_s", 20.0, 1.5, 10.0),
    Part("tie_up_nm", 15.0, 8.0, 40.0),
    Part("fill_error_s", 10.0, 0.04, 0.12),
    Part("touch_error_pa", 15.0, 0.05e5, 0.2e5),
    Part("lock_rate_rad_s2", 10.0, 100.0, 400.0),
    Part("overtime_s", 5.0, 0.1, 0.6),
    Part("temperature_rise_k", 5.0, 6.0, 30.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one clutch had to bear."""

    clutch: int
    counts: tuple[int, ...] = (0,) * (len(ENERGY_BOUNDS_J) + 1)  # events by slip energy, bounds as ENERGY_BOUNDS_J
    energy_j: float = 0.0
    peak_k: float | None = None  # of the pack
    launch_count: int = 0
    life_ratio: float = 0.0  # of a lining's life that this energy consumes: an index, docs/verdict.md


_UNLOADED: Final = Load(clutch=0)


def borne(before: Mapping[int, Load], estimate: ShiftEstimate) -> dict[int, Load]:
    """Return what each clutch had to bear after one more event; slip without pressures tells no energy."""
    after, quality = dict(before), estimate.shift_quality
    if quality is None:
        return after
    for clutch, pack in enumerate(quality.packs, 1):
        energy_j = pack.slip_energy_j or 0.0
        is_launch = estimate.kind is EventKind.LAUNCH and estimate.clutch == clutch
        if energy_j or is_launch:
            old = after.get(clutch, _UNLOADED)
            counts = list(old.counts)
            counts[bisect(ENERGY_BOUNDS_J, energy_j)] += bool(energy_j)
            after[clutch] = Load(
                clutch=clutch,
                counts=tuple(counts),
                energy_j=old.energy_j + energy_j,
                peak_k=max(pack.peak_k or 0.0, old.peak_k or 0.0) or None,
                launch_count=old.launch_count + is_launch,
                life_ratio=old.life_ratio + (pack.life_ratio or 0.0),
            )
    return after
