"""How the score of gear changes falls with what is wrong of the control, and whether what it names is right.

Vehicles are drawn with production scatter and driven through all gears. Of each one thing of the control is made wrong
step by step: the touch points it believes in, how full it fills a clutch, how far both clutches overlap. Then its touch
points are mended, once by the error that was found and once by routine 0302 of the emulated controller.

    python -m studies.shift_quality --vehicles 12
    python -m studies.shift_quality drive-a.csv drive-b.csv     # every change of recorded tables, with its parts
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import spearmanr

from studies.accuracy import to_batch
from studies.scan_tool import written
from studies.study import over_drives, root_mean_square
from clutch_model.calibration import clutch_of_gear, nominal_calibration
from dbc.contract import load_contract
from diag_service import analyze
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.condition.shift_quality import PARTS, weighed
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import ShiftEstimate, ShiftQuality
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.mapping.survey import proposed_profile
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import merge
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.build import build_vehicle, drive_settings
from ecu_emulator.drive.recording import Drive
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import Driver, Routine, Scenario, Truth
from ecu_emulator.shift_control import tcu_data
from tests.support.uds.adapting_car import ADAPT, AdaptingCar

FIRST_SEED: Final = 98_000  # 1 to 8, 98700 to 98705, 98800 to 98807: looked at while it was chosen
STRETCH_S: Final = 60.0
STEPS: Final = {  # what is wrong, by kind: first nothing
    "touch point believed too low, bar": (0.0, -0.06, -0.12, -0.18, -0.24, -0.3),
    "touch point believed too high, bar": (0.0, 0.06, 0.12, 0.18, 0.24, 0.3),
    "filled too little, share": (0.0, -0.13, -0.26, -0.39, -0.52, -0.65),
    "filled too much, share": (0.0, 0.03, 0.06, 0.09, 0.12),
    "off-going clutch let go too early, share": (0.0, -0.1, -0.2, -0.3, -0.4, -0.5),
    "overlap too large, Nm": (0.0, 20.0, 40.0, 60.0, 80.0, 100.0),
}
RIGHT_FILL: Final = 0.88  # of the prefill: as torque is asked for the cavity is just full
NOMINAL_OVERLAP_NM: Final = 8.0
NOMINAL_GAIN: Final = 1.08
LEAST_SPEARMAN, LEAST_RIGHT = 0.95, 0.92
MOST_LEFT: Final = 3.0  # points below that without an error, after it was mended
SCATTER_VEHICLES: Final = 4
BAR_PA: Final = 1e5


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One vehicle with one thing wrong."""

    kind: str
    step: float
    seed: int
    is_mended: bool = False  # the error of the touch points is mended, and all is driven again


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What its changes came to."""

    case: Case
    scores: tuple[float, ...]
    touch_errors: tuple[float, ...] = ()  # in stated deviations, of every change
    fill_errors: tuple[float, ...] = ()
    mended: tuple[float, ...] = ()  # scores after the error that was found is mended
    by_routine: tuple[float, ...] = ()  # after routine 0302


def scenario_of(case: Case) -> Scenario:
    """Return the drive of a case."""
    kind, plant = case.kind, dict[str, float]()
    rng = np.random.default_rng(case.seed)
    if kind.startswith("filled"):
        plant = {"control.prefill_ratio": RIGHT_FILL + case.step}
    elif kind.startswith("off-going"):
        plant = {"control.overlap_gain_ratio": NOMINAL_GAIN + case.step}
    elif kind.startswith("overlap"):
        plant = {"control.overlap_margin_nm": NOMINAL_OVERLAP_NM + case.step}
    driver = Driver(pedal_ratio=float(rng.uniform(0.35, 0.55)))
    return Scenario(name="quality", seed=case.seed, driver=driver, truth=Truth(plant=plant))


def driven(scenario: Scenario, believed_pa: tuple[float, float]) -> list[ShiftEstimate]:
    """Drive with these touch points believed in, and return the estimates of all changes."""
    drive = Drive(scenario)
    drive.believe(believed_pa)
    frames = merge([stretch.frames for stretch in drive.stretches(STRETCH_S)])
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    return [one.estimate for one in stages.feed(to_batch(frames))]


def scored(estimates: Sequence[ShiftEstimate]) -> list[tuple[ShiftEstimate, ShiftQuality, float]]:
    """Return the changes that have a score."""
    return [
        (one, one.shift_quality, one.shift_quality.score)
        for one in estimates
        if one.shift_quality is not None and one.shift_quality.score is not None
    ]


def true_fills_s(scenario: Scenario, believed_pa: tuple[float, float]) -> list[float]:
    """Return of every change by how much longer its clutch ought to be filled, as the plant has it."""
    vehicle = build_vehicle(scenario)
    plant = Powertrain(
        vehicle.calibration, vehicle.parameters, drive_settings(scenario), touch_pressures_pa=believed_pa
    )
    pieces = []
    while not plant.finished:
        pieces.append(plant.advance(STRETCH_S))
    rows = np.vstack(pieces)
    phase = rows[:, Col.SHIFT_PHASE]
    starts = np.flatnonzero((phase[1:] == tcu_data.TORQUE) & (phase[:-1] == tcu_data.PREFILL)) + 1
    found = []
    for row in starts:
        clutch = clutch_of_gear(int(rows[row, Col.TARGET_GEAR])) - 1
        law = vehicle.calibration.clutches[clutch]
        stroke_pa = law.piston.spring_rate_n_m * law.piston.fill_stroke_m / law.geometry.piston_area_m2
        pressure_pa = rows[:, Col.PRESSURE1 + clutch]
        command_pa = rows[row - 220 : row, Col.PRESSURE1_COMMAND + clutch]
        end = row - 220 + int(np.flatnonzero(command_pa > law.touch_pressure_pa + BAR_PA)[-1])
        rate_pa_s = (pressure_pa[end] - pressure_pa[end - 30]) / 0.03
        short_pa = law.touch_pressure_pa - pressure_pa[row]
        found.append(max(float(short_pa / rate_pa_s), 0.0) if rate_pa_s < 10 * stroke_pa else np.nan)
    return found


def shown(case: Case) -> list[Shown]:
    """Drive a case, and again without the error that was found."""
    scenario = scenario_of(case)
    vehicle = build_vehicle(scenario).calibration
    true_pa = tuple(clutch.touch_pressure_pa for clutch in vehicle.clutches)
    step_pa = case.step * BAR_PA if case.kind.startswith("touch") else 0.0
    believed_pa = (true_pa[0] + step_pa, true_pa[1] + step_pa)
    found = scored(driven(scenario, believed_pa))
    touch = [
        (one.touch_error_pa + step_pa) / one.std_touch_error_pa
        for _, one, _ in found
        if one.touch_error_pa is not None and one.std_touch_error_pa
    ]
    fill: list[float] = []
    if case.kind == "filled too little, share":
        truths = true_fills_s(scenario, believed_pa)
        for (_, one, _), truth in zip(found, truths, strict=False):
            if one.fill_error_s is not None and one.std_fill_error_s and np.isfinite(truth):
                fill.append((one.fill_error_s - truth) / one.std_fill_error_s)
    mended: list[float] = []
    by_routine: list[float] = []
    if case.is_mended:
        last = {clutch_of_gear(one.to_gear): part.touch_error_pa or 0.0 for one, part, _ in found}
        better_pa = (believed_pa[0] + last.get(1, 0.0), believed_pa[1] + last.get(2, 0.0))
        mended = [score for *_, score in scored(driven(scenario, better_pa))]
        car = AdaptingCar(replace(scenario, routine=Routine(on_request=True), adapted=False))
        car.perform(ADAPT)
        car.go_on()
        by_routine = [score for *_, score in scored(driven(scenario, car.drive.touch_pressures_pa))]
    return [
        Shown(
            case=case,
            scores=tuple(score for *_, score in found),
            touch_errors=tuple(touch),
            fill_errors=tuple(fill),
            mended=tuple(mended),
            by_routine=tuple(by_routine),
        )
    ]


def falls(kind: str, found: Sequence[Shown]) -> tuple[float, float, float, list[float]]:
    """Return how the score goes with the size of the error: of means, of all drives, least of a vehicle; the means."""
    sizes = [abs(one.case.step) for one in found]
    scores = [float(np.mean(one.scores)) for one in found]
    means = [
        float(np.mean([s for s, size in zip(scores, sizes, strict=True) if size == abs(step)])) for step in STEPS[kind]
    ]
    by_vehicle = []
    for seed in {one.case.seed for one in found}:
        own = [(abs(one.case.step), np.mean(one.scores)) for one in found if one.case.seed == seed]
        by_vehicle.append(-float(spearmanr(*zip(*own, strict=True)).statistic))
    pooled = -float(spearmanr(sizes, scores).statistic)
    return float(np.median(by_vehicle)), min(by_vehicle), pooled, means


def tables_agree(seeds: Sequence[int]) -> list[float]:
    """Return by how much the score of what both tell differs between frames and a table of the same drive."""
    differences = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in seeds:
            log, table = folder / f"{seed}.log", folder / f"{seed}.csv"
            emulator(["record", str(log), "--seed", str(seed), "--cycles", "1"])
            written(
                log,
                table,
                np.random.default_rng(seed),
                rate_hz=100.0,
                jitter_s=0.0,
                skew_ratio=0.0,
                left_out=frozenset(),
            )
            of_frames, of_table = (scored(estimates_of(path)) for path in (log, table))
            for (_, one, _), (_, other, _) in zip(of_frames, of_table, strict=False):
                both = {
                    part.name
                    for part in PARTS
                    if getattr(one, part.name) is not None and getattr(other, part.name) is not None
                }
                both |= {"acceleration_m_s2"} if "jerk_m_s3" in both else set()
                first, second = (weighed({name: getattr(each, name) for name in both})[0] for each in (one, other))
                if first is not None and second is not None:
                    differences.append(second - first)
    return differences


def estimates_of(path: Path) -> list[ShiftEstimate]:
    """Return the estimates of a log, or of a table by the profile that is proposed from it."""
    if path.suffix == ".log":
        return [one.estimate for one in analyze(path).results]
    with tempfile.TemporaryDirectory() as name:
        profile = Path(name) / "proposed.toml"
        profile.write_text(proposed_profile(path), encoding="utf-8")
        return [one.estimate for one in analyze(path, profile=profile).results]


def rows_of(path: Path) -> Iterator[str]:
    """Yield a table's changes with all their parts, as a table."""
    names = [part.name for part in PARTS]
    yield f"\n{path.name}\n\n| event | kind | gears | score | {' | '.join(names)} | reasons |"
    yield f"|{'---|' * (len(names) + 5)}"
    for one in estimates_of(path):
        quality = one.shift_quality
        if one.from_gear == one.to_gear:
            continue
        cells = ["-"] * (len(names) + 1) + [f"no score: {one.end_reason}"]
        if quality is not None:
            values = [quality.score, *(getattr(quality, name) for name in names)]
            cells = ["-" if value is None else f"{value:.3g}" for value in values] + [", ".join(quality.reasons)]
        yield f"| {one.number} | {one.kind} | {one.from_gear}-{one.to_gear} | {' | '.join(cells)} |"


def studied(vehicles: int, seed: int, jobs: int, only: str) -> Iterator[str]:
    """Yield what the study of drawn vehicles found; the last line says whether all holds."""
    seeds = range(seed, seed + vehicles)
    holds = True
    everything: list[Shown] = []
    for kind, steps in STEPS.items():
        if only not in kind:
            continue
        cases = [
            Case(kind=kind, step=step, seed=one, is_mended=kind.startswith("touch") and step == steps[-1])
            for one in seeds
            for step in steps
        ]
        found = over_drives(shown, cases, jobs)
        everything += found
        middle, least, pooled, means = falls(kind, found)
        holds &= middle >= LEAST_SPEARMAN
        sizes = ", ".join(f"{step:g}: {mean:.0f}" for step, mean in zip(steps, means, strict=True))
        yield f"{kind}: mean score {sizes}"
        yield f"  Spearman of error and loss: median vehicle {middle:.3f}, least {least:.3f}, all drives {pooled:.3f}"
        if kind.startswith("touch"):
            wrong = [one for one in found if one.mended]
            before, after, routine = (
                float(np.mean([np.mean(getattr(one, name)) for one in wrong]))
                for name in ("scores", "mended", "by_routine")
            )
            yield f"  error mended: {before:.1f} -> {after:.1f}; routine 0302: {routine:.1f}"
            holds &= min(after, routine) > means[0] - MOST_LEFT
    for name, errors in (
        ("touch point", [error for one in everything for error in one.touch_errors]),
        ("fill time", [error for one in everything for error in one.fill_errors]),
    ):
        if not errors:
            continue
        share, rms = float(np.mean(np.abs(errors) < 2.0)), root_mean_square(np.array(errors))
        holds &= share >= LEAST_RIGHT
        yield f"{name}: {share:.1%} of {len(errors)} within 2 deviations, rms {rms:.2f}"
    points = scatter([scenario_of(Case(kind="none", step=0.0, seed=one)) for one in seeds[:SCATTER_VEHICLES]])
    yield f"scatter between equal changes: {points:.1f} points"
    differences = np.array(tables_agree(seeds[:SCATTER_VEHICLES]))
    yield f"tables less frames: mean {differences.mean():+.1f}, rms {root_mean_square(differences):.1f} points"
    yield "all holds" if holds else "does not hold"


def scatter(scenarios: Sequence[Scenario]) -> float:
    """Return the standard deviation of the score of the same change of the same vehicle, driven again."""
    variances = []
    for scenario in scenarios:
        first, second = (clutch.touch_pressure_pa for clutch in build_vehicle(scenario).calibration.clutches)
        runs = [
            [
                score
                for *_, score in scored(
                    driven(replace(scenario, vehicle_seed=scenario.seed, drive_seed=again), (first, second))
                )
            ]
            for again in range(4)
        ]
        count = min(map(len, runs))
        variances.append(np.var([run[:count] for run in runs], axis=0, ddof=1).mean())
    return float(np.sqrt(np.mean(variances)))


def main() -> int:
    """Print tables of the files that are named, else the study; return 1 if it does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "tables", nargs="*", type=Path, metavar="FILE", help="tables of signals, or logs of the emulated car"
    )
    parser.add_argument("--vehicles", type=int, default=12)
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first vehicle")
    parser.add_argument(
        "--only", default="", metavar="WORDS", help="what is wrong, part of its name: 'filled too little'"
    )
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    if options.tables:
        for path in options.tables:
            print("\n".join(rows_of(path)))
        return 0
    line = ""
    for line in studied(options.vehicles, options.seed, options.workers, options.only):
        print(line, flush=True)
    return 0 if line == "all holds" else 1


if __name__ == "__main__":
    sys.exit(main())
