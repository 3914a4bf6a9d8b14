"""Blind prediction of shifts of a real dual-clutch transmission, beside the same of emulated drives as such tables.

    python -m studies.real_dct drive-a.csv drive-b.csv --vehicles 12

The profile is what ``diag-service signals`` proposes from the first table. No shift tells anything of its own
prediction: each is left out, or only the first half or other logs are known. Emulated cars are predicted from their own
shifts, then from other cars.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.special import stdtrit

from demo.drawing import as_svg, drawing_style
from diag_service.api.learning import learn, slip_phases
from diag_service.diagnosis.blind_test import (
    OURS,
    BlindTest,
    PredictedShift,
    blind_test,
    each_left_out,
    each_log,
    scores,
    second_half,
)
from diag_service.diagnosis.slip_phase import SlipPhase, Standing
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.mapping.learning import proposed_profile
from diag_service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from ecu_emulator.plant.parameters import nominal_parameters
from studies.builders import OF_FRICTION, written
from studies.run import parsed, study_parser

RPM = 30.0 / np.pi  # of rad/s
GROUP = 10  # cars, each of which is predicted from the others
LEFT_OUT: Final = OF_FRICTION | {"Input Shaft 1 Speed", "Input Shaft 2 Speed", "Current Gear"}
TUNES: Final = {
    "control.torque_phase_s": (0.06, 0.1),  # the handover
    "control.upshift_inertia_phase_s": (0.18, 0.45),
    "control.spark_reduction_ratio": (0.3, 0.6),
    "control.overlap_gain_ratio": (1.0, 1.2),
}


SPLITS = {
    "each from all others": each_left_out,
    "second half from the first": second_half,
    "each log from the others": each_log,
}


def meaning_of(table: Path, folder: Path) -> Interpretation:
    """Return the columns of a table as the service proposes them."""
    profile = folder / f"{table.stem}.toml"
    profile.write_text(proposed_profile(table), encoding="utf-8")
    return interpret(None, profile)


def slips(tables: Sequence[Path], meaning: Interpretation) -> tuple[list[tuple[str, SlipPhase]], float | None]:
    """Return the slip phases of all gear changes, with the name of their table, and the touch point."""
    standing, named = Standing(), list[tuple[str, SlipPhase]]()
    for table in tables:
        phases, _ = slip_phases(table, meaning, standing, Trigger())
        named += [(table.name, one) for one in phases]
    return named, standing.touch_pa


def power_upshifts(named: Sequence[tuple[str, SlipPhase]]) -> list[tuple[str, SlipPhase]]:
    """Return those of the power upshifts."""
    return [one for one in named if one[1].sign > 0.0 and one[1].is_powered]


class EmulatedCar(NamedTuple):
    """The power upshifts of a car with the name of its table, its touch point, and how its ratios are learnt."""

    named: list[tuple[str, SlipPhase]]
    touch_pa: float | None
    ratios_off: list[float]
    """From those of the plant, in stated deviations; a gear that is called not driven is not among them."""


def emulated(vehicles: int, cycles: int, folder: Path) -> Iterator[EmulatedCar]:
    """Yield emulated cars at 27 rows a second, on rough ground and handed over quickly.

    Each has a tune of its own; the noise of the output speed scatters its ratios by 1.5 %.
    """
    ratios = nominal_parameters().gearbox.input_output_ratios
    for seed in range(1, vehicles + 1):
        rng = np.random.default_rng(seed)
        tune = {name: rng.uniform(*ends) for name, ends in TUNES.items()}
        scenario, log, path = (folder / f"{seed}.{suffix}" for suffix in ("toml", "log", "csv"))
        lines = [
            f'name = "tune {seed}"',
            f"cycles = {cycles}",
            "[truth.plant]",
            *(f'"{k}" = {v}' for k, v in tune.items()),
        ]
        scenario.write_text("\n".join(lines), encoding="utf-8")
        emulator(["record", str(log), "--seed", str(seed), "--scenario", str(scenario)])
        written(log, path, rng, left_out=LEFT_OUT)
        log.unlink()
        rows = pd.read_csv(path)
        rows["Output Shaft Speed [rpm]"] *= rng.normal(1.0, 0.015, len(rows))
        rows.to_csv(path, index=False)
        named, touch_pa = slips([path], meaning_of(path, folder))
        gears = learn(path, path.with_suffix(".toml"))["gears"]
        off = [(one["ratio"] - ratios[int(gear) - 1]) / one["std"] for gear, one in gears.items()]
        yield EmulatedCar(power_upshifts(named), touch_pa, off)


def of_each_log(test: BlindTest) -> Iterator[BlindTest]:
    """Yield the same of each log by itself."""
    for name in dict.fromkeys([one.log for one in test.shown] + [log for log, *_ in test.unknown]):
        yield BlindTest(
            shown=[one for one in test.shown if one.log == name],
            unknown=[one for one in test.unknown if one[0] == name],
        )


def emulated_lines(title: str, tests: Sequence[BlindTest]) -> Iterator[str]:
    """Yield what predictions of emulated cars are worth, those that are refused left out."""
    passed = [test for test in tests if not test.why_refused]
    yield f"\nEmulated, from {title}: {len(passed)} of {len(tests)} cars are predicted"
    yield from table("Those", BlindTest(shown=[one for test in passed for one in test.shown]))


def table(title: str, test: BlindTest, why_refused: str = "", what: str = "power upshifts") -> Iterator[str]:
    """Yield what each model was worth, as a table, and what is not predicted."""
    yield f"\n{title}: {len(test.shown)} {what}; not predicted: {why_refused or 'none'}"
    for (log, why), count in Counter((log, why) for log, _, why in test.unknown).items():
        yield f"{log}: {count} not predicted: {why}"
    if not test.shown:
        return
    found = scores(test.shown)
    best = min(score["crps_rad_s"] for name, score in found.items() if name != OURS)
    yield "\n| model | median error | CRPS rad/s | ends in 50 % | in 90 % | samples in 50 % | in 90 % |"
    yield "|---|---|---|---|---|---|---|"
    for name, score in found.items():
        inside = (score[key] for key in ("inside_50", "inside_90", "samples_inside_50", "samples_inside_90"))
        shares = " | ".join(f"{100 * one:.0f} %" for one in inside)
        yield f"| {name} | {100 * score['median_error_ratio']:.1f} % | {score['crps_rad_s']:.2f} | {shares} |"
    yield f"\nCRPS over that of the best simpler model: {found[OURS]['crps_rad_s'] / best:.2f}"


def picture(shown: PredictedShift) -> str:
    """Return the picture of a shift as SVG: samples of engine speed, what was predicted, and simpler models."""
    phase, ours = shown.phase, shown.predictions[OURS]
    t_ms, start = 1e3 * phase.t_s, float(phase.speed_rad_s[0])
    with drawing_style():
        figure = Figure(figsize=(7.0, 3.4), layout="constrained")
        axes = figure.subplots()
        for share, alpha in ((0.9, 0.18), (0.5, 0.3)):
            half = np.append(0.0, ours.scale_rad_s * stdtrit(ours.freedom, 0.5 + share / 2.0))
            mean = start + np.append(0.0, ours.mean_rad_s)
            label = f"{100 * share:.0f} % of the prediction"
            axes.fill_between(t_ms, (mean - half) * RPM, (mean + half) * RPM, alpha=alpha, color="#0f6cbd", label=label)
        axes.plot(t_ms, mean * RPM, color="#0f6cbd", label="predicted from the other shifts")
        for name, said in shown.predictions.items():
            if name != OURS:
                axes.plot(t_ms, (start + np.append(0.0, said.mean_rad_s)) * RPM, "--", lw=0.9, label=name)
        axes.plot(t_ms, phase.speed_rad_s * RPM, "o", color="#111827", label="recorded", clip_on=False, zorder=5)
        axes.set(xlabel="time in the slip phase [ms]", ylabel="engine speed [rpm]")
        axes.set_title(f"{phase.from_gear}-{phase.to_gear} under power", loc="left")
        axes.legend(fontsize=7, loc="lower left")
        return as_svg(figure)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("tables", nargs="*", type=Path, metavar="FILE", help="tables of signals of one type of vehicle")
    parser.add_argument("--vehicles", type=int, default=12, help="emulated cars beside them")
    parser.add_argument("--picture", type=Path, help="SVG of the upshift with most samples but the first")
    parser.add_argument("--cycles", type=int, default=3, help="shift cycles of each, with five power upshifts")
    options = parsed(parser, arguments, vehicles=2, cycles=1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.tables:
            named, touch_pa = slips(options.tables, meaning_of(options.tables[0], folder))
            downshifts = [one for one in named if one[1].sign < 0.0]
            for title, split in SPLITS.items():
                test = blind_test(power_upshifts(named), touch_pa, split)
                print("\n".join(table(f"Recorded, {title}", test, test.why_refused)), flush=True)
                if options.picture and split is each_left_out and test.shown:
                    drawn = max(test.shown[1:] or test.shown, key=lambda one: len(one.phase.t_s))
                    options.picture.write_text(picture(drawn), encoding="utf-8")
            test = blind_test(downshifts, touch_pa)
            print("\n".join(table("Recorded, each from all others", test, test.why_refused, "downshifts")))
        if not options.vehicles:
            return
        cars = list(emulated(options.vehicles, options.cycles, folder))
        off = [one for car in cars for one in car.ratios_off]
        print(f"\nEmulated: {len(off)} gears learnt, {np.count_nonzero(np.abs(off) <= 2)} within two deviations")
        print(*emulated_lines("its own", [blind_test(car.named, car.touch_pa) for car in cars]), sep="\n", flush=True)
        groups = [cars[place : place + GROUP] for place in range(0, len(cars), GROUP)]
        tests = [blind_test([one for car in group for one in car.named], None, each_log) for group in groups]
        by_log = [one for test in tests for one in of_each_log(test)]
        print(*emulated_lines("others, ten by ten", by_log), sep="\n")


if __name__ == "__main__":
    main()
