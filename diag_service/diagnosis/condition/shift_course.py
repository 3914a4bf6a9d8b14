"""What the quality of many gear changes comes to: by kind, gears and oil; what to adapt; what the clutches bore."""

import math
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Final

from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_model.units import degc_from_k
from diag_service.diagnosis.events import EventKind
from diag_service.diagnosis.records import ShiftQuality, ShiftResult

COURSE_COUNT: Final = 20  # changes of a kind at either end of a course
COLD_DEGC, HOT_DEGC = 40.0, 90.0  # of the oil
ENERGY_BOUNDS_J: Final = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0)
WEAR_M3_J: Final = 1.4e-15  # of a wet paper lining, by Archard's law [C]: 1.4 mm3 per MJ
WORN_M: Final = 0.2e-3  # that each lining may lose [C]
PASCAL_PER_BAR: Final = 1e5


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How changes of one kind between two gears went."""

    kind: EventKind
    from_gear: int
    to_gear: int
    count: int
    first: float  # mean score of the first of them
    last: float  # of the last
    by_oil: tuple[float | None, float | None, float | None]  # cold, warm, hot
    reason: str  # the part that cost most most often; empty: none


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one clutch had to bear."""

    clutch: int
    counts: tuple[int, ...]  # events by their slip energy, bounds as ENERGY_BOUNDS_J
    energy_j: float
    peak_k: float | None  # of the pack
    launch_count: int
    life_ratio: float  # of a lining's life that this energy consumes: an index, docs/shift-quality.md


def courses(results: Iterable[ShiftResult]) -> list[Course]:
    """Return how the changes went, by kind and gears; results in their order."""
    groups: dict[tuple[EventKind, int, int], list[tuple[float, float | None, tuple[str, ...]]]] = {}
    for one in (result.estimate for result in results):
        quality = one.shift_quality
        if quality is not None and quality.score is not None:
            told = quality.score, one.sump_temperature_k, quality.reasons
            groups.setdefault((one.kind, one.from_gear, one.to_gear), []).append(told)
    found = []
    for (kind, from_gear, to_gear), group in sorted(groups.items()):
        by_oil: list[list[float]] = [[], [], []]
        for score, oil_k, _ in group:
            if oil_k is not None:
                by_oil[bisect((COLD_DEGC, HOT_DEGC), degc_from_k(oil_k))].append(score)
        reasons = Counter(reasons[0] for *_, reasons in group if reasons)
        found.append(
            Course(
                kind=kind,
                from_gear=from_gear,
                to_gear=to_gear,
                count=len(group),
                first=fmean(score for score, *_ in group[:COURSE_COUNT]),
                last=fmean(score for score, *_ in group[-COURSE_COUNT:]),
                by_oil=tuple(fmean(scores) if scores else None for scores in by_oil),  # type: ignore[arg-type]
                reason=reasons.most_common(1)[0][0] if reasons else "",
            )
        )
    return found


def correction_lines(results: Sequence[ShiftResult]) -> list[str]:
    """Return what a control should adapt of each clutch, by the newest change that names it for sure."""
    newest: dict[tuple[int, str], ShiftQuality] = {}
    for one in (result.estimate for result in results):
        if one.shift_quality is not None and one.shift_quality.std_touch_error_pa is not None:
            for name in ("touch_error_pa", "fill_error_s"):
                newest[clutch_of_gear(one.to_gear), name] = one.shift_quality
    lines = []
    for (clutch, name), quality in sorted(newest.items(), key=lambda item: item[0]):
        if name in quality.corrections:
            lines.append(f"clutch {clutch}: {_correction(quality, name)}")
    return lines


def _correction(quality: ShiftQuality, name: str) -> str:
    error, std = (getattr(quality, key) or 0.0 for key in (name, f"std_{name}"))
    if name == "touch_error_pa":
        bar, std_bar = error / PASCAL_PER_BAR, std / PASCAL_PER_BAR
        return f"touch point {abs(bar):.2f} bar {'later' if bar > 0.0 else 'earlier'} than believed (± {std_bar:.2f})"
    return f"fill for {1e3 * abs(error):.0f} ms {'longer' if error > 0.0 else 'less'} (± {1e3 * std:.0f})"


def loads(results: Iterable[ShiftResult], calibration: Calibration) -> list[Load]:
    """Return what each clutch had to bear, those that slipped; slip without pressures counts nothing."""
    known = [result.estimate for result in results]
    found = []
    for clutch, law in zip((1, 2), calibration.clutches, strict=True):
        energies_j = [
            energy_j
            for one in known
            if one.shift_quality is not None
            and (energy_j := getattr(one.shift_quality, f"slip_energy{clutch}_j")) is not None
            and energy_j > 0.0
        ]
        if not energies_j:
            continue
        counts = Counter(bisect(ENERGY_BOUNDS_J, energy_j) for energy_j in energies_j)
        geometry = law.geometry
        ring_m2 = math.pi * (geometry.outer_radius_m**2 - geometry.inner_radius_m**2)
        own = [one for one in known if one.clutch == clutch]
        found.append(
            Load(
                clutch=clutch,
                counts=tuple(counts[place] for place in range(len(ENERGY_BOUNDS_J) + 1)),
                energy_j=sum(energies_j),
                peak_k=max((one.clutch_temperature_k for one in own if one.clutch_temperature_k), default=None),
                launch_count=sum(one.kind is EventKind.LAUNCH for one in own),
                life_ratio=sum(energies_j) * WEAR_M3_J / (WORN_M * ring_m2 * geometry.interface_count),
            )
        )
    return found
