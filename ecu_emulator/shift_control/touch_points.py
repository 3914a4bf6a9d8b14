"""Where a clutch begins to carry torque, as a controller finds it: from its commands and sensors, not from the clutch.

The engine idles against a clutch whose pressure comes down in steps. While the clutch carries something, the engine
gives that much more; the touch point lies between the last step that was felt and the first that was not.
docs/model.md, section "Touch points".
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from statistics import fmean, linear_regression, median, stdev
from typing import Final

from clutch_model.calibration import nominal_calibration, shipped_calibration

# All [C].
WINDOW_S: Final = 0.6  # of each step, at its end, and of the wait with an empty clutch
QUIET_S: Final = 0.2  # without pressure, after which the steps are over
LEAST_SAMPLES: Final = 20  # in a window, of a hundred in a second
FELT_NM: Final = 1.5  # a film that has just closed carries 2 to 9 N m, noise is 0.5 N m
COARSE_PA: Final = 0.1e5
COARSE_RANGE_PA: Final = 0.35e5  # on either side of the type's touch point
FINE_PA: Final = 0.02e5
FINE_RANGE_PA: Final = 0.08e5
REPEATS: Final = 3
MOST_TRIES: Final = 5  # of fine steps
MOST_SCATTER_PA: Final = 0.03e5  # standard deviation of the repeats
FELT_LATE_PA: Final = 0.006e5  # hot thin oil carries so little that it is felt a little above the touch point
MOST_SHAFT_RAD_S: Final = 5.0  # of a shaft that the brake holds


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureSteps:
    """Steps to hold one after the other, from the highest pressure to the lowest."""

    clutch: int  # 1 or 2
    top_pa: float
    down_pa: float
    count: int

    def pressure_pa(self, step: int) -> float:
        return self.top_pa - step * self.down_pa


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What the controller commands and its sensors say at one moment."""

    t_s: float
    command_pa: float
    engine_torque_nm: float
    engine_speed_rad_s: float
    shaft_speed_rad_s: float

    @property
    def is_known(self) -> bool:
        """Whether all sensors say something."""
        return math.isfinite(self.engine_torque_nm + self.engine_speed_rad_s + self.shaft_speed_rad_s)


class Felt(IntEnum):
    """What steps have shown."""

    BETWEEN = 0  # somewhere a clutch that carried carries no more
    NEVER = 1  # it carries nothing, even at the highest pressure
    ALWAYS = 2  # it carries, even at the lowest
    UNCLEAR = 3  # sensors were silent, or the shaft turned


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPointFinding:
    """What steps have shown, and where."""

    felt: Felt
    pressure_pa: float = math.nan  # in the middle between the two steps


class Result(IntEnum):
    """How the search for a touch point has ended; numbers as routines tell them."""

    FOUND = 0
    AT_LIMIT = 1  # it lies beyond what may be adapted
    SCATTERS = 2
    UNCLEAR = 3  # nothing could be measured


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPoint:
    """A touch point that a controller has adapted."""

    pressure_pa: float
    std_pa: float
    is_at_limit: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """The search for the touch point of one clutch, as far as it has gone."""

    clutch: int
    nominal_pa: float
    most_change_pa: float  # from the type's touch point; what lies beyond is not adapted
    coarse: TouchPointFinding | None = None
    fine: tuple[TouchPointFinding, ...] = ()

    @property
    def clear_pa(self) -> tuple[float, ...]:
        """What the fine steps have shown, where they did."""
        return tuple(finding.pressure_pa for finding in self.fine if finding.felt is Felt.BETWEEN)

    def next_steps(self) -> PressureSteps | None:
        """Return the steps that are to be held next; None if the search is over."""
        if self.coarse is None:
            count = round(2.0 * COARSE_RANGE_PA / COARSE_PA) + 1
            top_pa = self.nominal_pa + COARSE_RANGE_PA
            return PressureSteps(clutch=self.clutch, top_pa=top_pa, down_pa=COARSE_PA, count=count)
        is_over = len(self.clear_pa) >= REPEATS or len(self.fine) >= MOST_TRIES
        if self.coarse.felt is not Felt.BETWEEN or is_over:
            return None
        shift_pa = (len(self.fine) % REPEATS - (REPEATS - 1) / 2) * FINE_PA / REPEATS
        return PressureSteps(
            clutch=self.clutch,
            top_pa=self.coarse.pressure_pa + FINE_RANGE_PA + shift_pa,
            down_pa=FINE_PA,
            count=round(2.0 * FINE_RANGE_PA / FINE_PA) + 1,
        )

    def after(self, finding: TouchPointFinding) -> "Search":
        """Return the search after the steps that were asked for have been held."""
        if self.coarse is None:
            return replace(self, coarse=finding)
        return replace(self, fine=(*self.fine, finding))

    def ended(self) -> tuple[Result, TouchPoint | None]:
        """Return how the search has ended, and what is adapted; None: nothing."""
        if self.coarse is None or self.coarse.felt is Felt.UNCLEAR:
            return Result.UNCLEAR, None
        if self.coarse.felt is not Felt.BETWEEN:
            return Result.AT_LIMIT, self._limit(is_above=self.coarse.felt is Felt.NEVER)
        clear_pa = self.clear_pa
        if len(clear_pa) < REPEATS:
            return Result.UNCLEAR, None
        middle_pa, scatter_pa = median(clear_pa), stdev(clear_pa)
        if scatter_pa > MOST_SCATTER_PA:
            return Result.SCATTERS, None
        if abs(middle_pa - self.nominal_pa) > self.most_change_pa:
            return Result.AT_LIMIT, self._limit(is_above=middle_pa > self.nominal_pa)
        std_pa = math.sqrt(FINE_PA**2 / 12.0 + scatter_pa**2 / len(clear_pa) + FELT_LATE_PA**2)
        return Result.FOUND, TouchPoint(pressure_pa=middle_pa, std_pa=std_pa)

    def _limit(self, *, is_above: bool) -> TouchPoint:
        change_pa = self.most_change_pa if is_above else -self.most_change_pa
        return TouchPoint(pressure_pa=self.nominal_pa + change_pa, std_pa=math.nan, is_at_limit=True)


def nominal_touch_pressures_pa(transmission: str = "nominal") -> tuple[float, float]:
    """Return the touch points of the type, by which a control works that has adapted nothing."""
    first, second = shipped_calibration(transmission).clutches
    return first.touch_pressure_pa, second.touch_pressure_pa


def sample_of(values: Mapping[str, float], t_s: float, clutch: int) -> Sample | None:
    """Return what is known at a moment, None if that is not even the command; a sensor that says nothing is NaN."""
    command_pa = values.get(f"clutch{clutch}_pressure_command_pa")
    if command_pa is None:
        return None
    return Sample(
        t_s=t_s,
        command_pa=command_pa,
        engine_torque_nm=values.get("engine_torque_nm", math.nan),
        engine_speed_rad_s=values.get("engine_speed_rad_s", math.nan),
        shaft_speed_rad_s=values.get(f"input{clutch}_speed_rad_s", math.nan),
    )


def are_over(samples: Sequence[Sample]) -> bool:
    """Return whether steps have been held: there was pressure, and there is none any more."""
    last_s = next((sample.t_s for sample in reversed(samples) if sample.command_pa > 0.0), None)
    return last_s is not None and samples[-1].t_s >= last_s + QUIET_S


def finding_of(samples: Sequence[Sample], steps: PressureSteps) -> TouchPointFinding:
    """Return what steps have shown; ``samples`` reach from before the clutch was filled to after they are over."""
    filled_at = next((place for place, sample in enumerate(samples) if sample.command_pa > 0.0), 0)
    open_nm = _engine_load_nm(samples[:filled_at])
    held: dict[int, list[Sample]] = {}
    for sample in samples[filled_at:]:
        held.setdefault(round((steps.top_pa - sample.command_pa) / steps.down_pa), []).append(sample)
    loads_nm = [_engine_load_nm(held.get(step, [])) for step in range(steps.count)]
    carried_nm = [load_nm - open_nm for load_nm in loads_nm]
    if not all(map(math.isfinite, carried_nm)):
        return TouchPointFinding(felt=Felt.UNCLEAR)
    lowest_nm = fmean(carried_nm[-2:])
    if lowest_nm > FELT_NM:
        return TouchPointFinding(felt=Felt.ALWAYS)
    unfelt_nm = lowest_nm / 2.0  # of three stretches: with an empty clutch, where nothing is carried by definition
    is_felt = [load_nm - unfelt_nm > FELT_NM for load_nm in carried_nm]
    first = next(step for step in range(steps.count) if not any(is_felt[step : step + 2]))
    if first == 0:
        return TouchPointFinding(felt=Felt.NEVER)
    middle_pa = 0.5 * (steps.pressure_pa(first - 1) + steps.pressure_pa(first))
    return TouchPointFinding(felt=Felt.BETWEEN, pressure_pa=middle_pa)


def _engine_load_nm(samples: Sequence[Sample]) -> float:
    """Return what the engine gave at the end of a stretch, beyond its own acceleration; NaN if that is not known."""
    window = [sample for sample in samples if sample.t_s > samples[-1].t_s - WINDOW_S and sample.is_known]
    is_turning = any(abs(sample.shaft_speed_rad_s) > MOST_SHAFT_RAD_S for sample in window)
    if len(window) < LEAST_SAMPLES or is_turning:
        return math.nan
    side = nominal_calibration().input_side
    inertia_kg_m2 = side.engine_inertia_kg_m2 + side.hub_inertia_kg_m2
    faster_rad_s2 = linear_regression(
        [sample.t_s for sample in window], [sample.engine_speed_rad_s for sample in window]
    ).slope
    return fmean(sample.engine_torque_nm for sample in window) - inertia_kg_m2 * faster_rad_s2
