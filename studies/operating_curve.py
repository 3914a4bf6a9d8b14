"""The verdict's operating curve: how often each verdict is given, against the true slope and level of the friction.

Each drive goes the whole way in memory, with production scatter: another vehicle for every seed and every point.

    python -m studies.operating_curve --seeds 14 --long-seeds 2

prints the shares, and writes ``verdict-operating-curve.csv`` and ``.svg`` into ``docs``.
"""

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from io import StringIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Condition
from demo.drawing import CONDITION_COLOUR, GRID, as_svg, drawing_style
from diag_service.service.stages import Diagnosis
from ecu_emulator.scenario.scenario import Scenario, Truth
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import diagnose
from studies.run import over_drives, parsed, percent, study_parser

DOCS = Path(__file__).parent.parent / "docs"
STEM = "verdict-operating-curve"
SCENARIO = "ideal"
FIRST_SEED = 70_000  # no study that tuned anything came here
SHIFTS_PER_CYCLE = 10
MEDIUM_CYCLES, LONG_CYCLES = 3, 30
SLOPES = (0.025, 0.021, 0.016, 0.0125, 0.0105, 0.0085, 0.005, 0.0025, 0.0, -0.0025, -0.005, -0.01, -0.02)
LEVELS = (0.70, 0.75, 0.78, 0.82, 0.86, 0.90, 0.94, 1.0, 1.05)
LONG_EVERY = 2  # of the points, for the drives of thirty cycles
NEW_FLUID_WEIGHT = 3  # times the seeds where a false alarm would be counted
COLOURS: Mapping[Condition, str] = {
    Condition.NO_VERDICT: GRID,
    **{
        one: CONDITION_COLOUR[one.name.lower().replace("_", " ")]
        for one in Condition
        if one is not Condition.NO_VERDICT
    },
}
CONDITIONS = tuple(COLOURS)


class CurveAxis(StrEnum):
    """What is varied."""

    SLOPE = "slope"  # mu_C - mu_S, at the nominal mu_C
    LEVEL = "level"  # mu_C over the nominal one, at the nominal mu_S/mu_C


class Horizon(StrEnum):
    """After how much driving the verdict is read."""

    ONE_SHIFT = "one shift"  # in which this clutch engaged
    ONE_CYCLE = "one cycle"
    THREE_CYCLES = "three cycles"
    THIRTY_CYCLES = "thirty cycles"


LAST_SHIFT: Mapping[Horizon, int] = {
    Horizon.ONE_CYCLE: SHIFTS_PER_CYCLE,
    Horizon.THREE_CYCLES: MEDIUM_CYCLES * SHIFTS_PER_CYCLE,
    Horizon.THIRTY_CYCLES: LONG_CYCLES * SHIFTS_PER_CYCLE,
}


DRAWN = tuple(LAST_SHIFT)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveCase:
    """One drive: a point of the curve and a vehicle."""

    axis: CurveAxis
    value: float
    seed: int
    cycles: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveOutcome:
    """One verdict on one clutch."""

    axis: CurveAxis
    value: float
    horizon: Horizon
    condition: Condition


Shares = Mapping[tuple[CurveAxis, Horizon], Mapping[float, Mapping[Condition, int]]]


def friction_of(axis: CurveAxis, value: float) -> tuple[float, float]:
    """Return the true (mu_C, mu_S) of a point."""
    nominal = nominal_calibration().clutches[0].friction
    if axis is CurveAxis.SLOPE:
        return nominal.mu_c, nominal.mu_c - value
    return nominal.mu_c * value, nominal.mu_s * value


def scenario_of(case: CurveCase) -> Scenario:
    """Return the drive of a case: a scattered vehicle with the friction of its point."""
    mu_c, mu_s = friction_of(case.axis, case.value)
    friction = {
        f"clutch{number}.friction.{name}": mu for number in (1, 2) for name, mu in (("mu_c", mu_c), ("mu_s", mu_s))
    }
    return replace(load_scenario(SCENARIO), seed=case.seed, cycles=case.cycles, truth=Truth(calibration=friction))


def verdict_at(diagnoses: Sequence[Diagnosis], clutch: int, horizon: Horizon) -> Condition:
    """Return the verdict on a clutch as it stands after a horizon."""
    own = [one for one in diagnoses if one.verdict.clutch == clutch]
    if horizon is Horizon.ONE_SHIFT:
        reached = own[:1]
    else:
        reached = [one for one in own if one.estimate.number <= LAST_SHIFT[horizon]]
    return reached[-1].verdict.condition if reached else Condition.NO_VERDICT


def outcomes(case: CurveCase) -> list[CurveOutcome]:
    """Make one drive and read its verdicts after each horizon that is its own."""
    diagnoses, _ = diagnose(scenario_of(case))
    is_long = case.cycles == LONG_CYCLES
    horizons = [horizon for horizon in Horizon if (horizon is Horizon.THIRTY_CYCLES) == is_long]
    return [
        CurveOutcome(
            axis=case.axis, value=case.value, horizon=horizon, condition=verdict_at(diagnoses, clutch, horizon)
        )
        for horizon in horizons
        for clutch in (1, 2)
    ]


def cases_of(seeds: int, long_seeds: int, first_seed: int) -> list[CurveCase]:
    """Return all drives, the long ones first; no seed comes twice."""
    points = [(CurveAxis.SLOPE, value) for value in SLOPES] + [(CurveAxis.LEVEL, value) for value in LEVELS]
    new_fluid = {(CurveAxis.SLOPE, round(nominal_margin(), 6)), (CurveAxis.LEVEL, 1.0)}
    planned = [(point, LONG_CYCLES) for point in points[::LONG_EVERY] for _ in range(long_seeds)]
    for point in points:
        count = seeds * (NEW_FLUID_WEIGHT if point in new_fluid else 1)
        planned += [(point, MEDIUM_CYCLES)] * count
    return [
        CurveCase(axis=axis, value=value, seed=first_seed + number, cycles=cycles)
        for number, ((axis, value), cycles) in enumerate(planned)
    ]


def nominal_margin() -> float:
    """Return mu_C - mu_S of new fluid."""
    nominal = nominal_calibration().clutches[0].friction
    return nominal.mu_c - nominal.mu_s


def shares_of(results: Sequence[CurveOutcome]) -> Shares:
    """Count the verdicts by axis, horizon, value and kind."""
    shares: dict[tuple[CurveAxis, Horizon], dict[float, dict[Condition, int]]] = {}
    for one in results:
        counts = shares.setdefault((one.axis, one.horizon), {}).setdefault(one.value, dict.fromkeys(CONDITIONS, 0))
        counts[one.condition] += 1
    return shares


def label_of(condition: Condition) -> str:
    """Return the name of a verdict as results spell it."""
    return condition.name.lower()


def cell(counts: Mapping[Condition, int] | None) -> str:
    """Return the shares of one point as ``none / good / watch / change`` in percent, with the number of verdicts."""
    if counts is None:
        return ""
    total = sum(counts.values())
    return " / ".join(percent(counts[condition] / total) for condition in CONDITIONS) + f" ({total})"


def table(shares: Shares, axis: CurveAxis) -> Iterator[str]:
    """Yield the Markdown table of one axis."""
    heads = {CurveAxis.SLOPE: "mu_C - mu_S", CurveAxis.LEVEL: "mu_C over new"}
    yield f"| {heads[axis]} | " + " | ".join(Horizon) + " |"
    yield "|---|" + "---|" * len(Horizon)
    for value in {CurveAxis.SLOPE: SLOPES, CurveAxis.LEVEL: LEVELS}[axis]:
        cells = [cell(shares.get((axis, horizon), {}).get(value)) for horizon in Horizon]
        yield f"| {value:.4g} | " + " | ".join(cells) + " |"


def comma_separated(shares: Shares) -> str:
    """Return the counts as CSV."""
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["axis", "value", "horizon", *(label_of(condition) for condition in CONDITIONS)])
    for (axis, horizon), by_value in sorted(shares.items()):
        for value, counts in sorted(by_value.items()):
            writer.writerow([axis, value, horizon, *(counts[condition] for condition in CONDITIONS)])
    return stream.getvalue()


def picture(shares: Shares) -> str:
    """Return the SVG: one row per axis, one column per horizon after which a verdict is possible, shares stacked."""
    with drawing_style():
        figure = Figure(figsize=(9.6, 5.2), layout="constrained")
        panels = figure.subplots(len(CurveAxis), len(DRAWN), sharey=True, squeeze=False)
        for row, axis in zip(panels, CurveAxis, strict=True):
            for panel, horizon in zip(row, DRAWN, strict=True):
                by_value = sorted(shares.get((axis, horizon), {}).items())
                counts = np.array([[one[condition] for condition in CONDITIONS] for _, one in by_value], np.float64)
                if len(counts):
                    values = [value for value, _ in by_value]
                    stack = 100.0 * counts.T / counts.sum(axis=1)
                    panel.stackplot(
                        values, stack, colors=list(COLOURS.values()), labels=[label_of(one) for one in CONDITIONS]
                    )
                    panel.set_xlim(values[0], values[-1])
                panel.set_ylim(0.0, 100.0)
                panel.set_title(horizon if axis is CurveAxis.SLOPE else "")
                panel.set_xlabel("mu_C - mu_S" if axis is CurveAxis.SLOPE else "mu_C over new")
            row[0].set_ylabel("verdicts [%]")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(CONDITIONS))
        return as_svg(figure)


def main() -> int:
    """Run the study, write its picture and table, and print the shares."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--seeds", type=int, default=14, help="vehicles for each point, up to three cycles")
    parser.add_argument("--long-seeds", type=int, default=2, help="vehicles for every other point, thirty cycles")
    parser.add_argument("--output", type=Path, default=DOCS, help="folder")
    arguments = parsed(parser, seeds=1, long_seeds=0, output=None)
    cases = cases_of(arguments.seeds, arguments.long_seeds, arguments.seed)
    shares = shares_of(over_drives(outcomes, cases, arguments.workers, arguments.kept))
    if arguments.output is not None:
        arguments.output.mkdir(parents=True, exist_ok=True)
        for suffix, text in (("csv", comma_separated(shares)), ("svg", picture(shares))):
            (arguments.output / f"{STEM}.{suffix}").write_text(text, encoding="utf-8")
    print("\n\n".join("\n".join(table(shares, axis)) for axis in CurveAxis))
    return 0


if __name__ == "__main__":
    sys.exit(main())
