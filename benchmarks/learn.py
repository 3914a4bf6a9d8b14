"""What ``diag-service learn`` finds of vehicles that nobody described, beside the truth.

    python -m benchmarks.learn --vehicles 3 drive-a.csv

The gearboxes of the emulated cars are drawn: every step between two gears differs from the type's by 6 % (standard
deviation). Each drives the shift cycle and US06; its frames and a table of 27 rows a second, without the gears, are
learned from. A table of a real car is learned from too; its truth is not known here.
"""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.real_dct import meaning_of
from benchmarks.scan_tool import written
from clutch_model.calibration import clutch_of_gear
from diag_service.commands.learn import learned_from, said
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.learning import LearnedVehicle
from diag_service.service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from ecu_emulator.plant.parameters import plant_table

if TYPE_CHECKING:
    from canlog.arrays import FloatArray

GEARS_OF = frozenset({"Current Gear", "Target Gear"})
STEP_STD_RATIO = 0.06
HEAD = "| vehicle | what | found | deviation | truth | error | in deviations | clutch |\n" + 8 * "|---" + "|"


def drawn_ratios(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Return the ratios of a gearbox, and the true ones of engine over the output shaft that is measured."""
    gearbox = plant_table()["gearbox"]
    assert isinstance(gearbox, dict)  # noqa: S101 - nested tables of TOML
    gears, finals = (np.array(gearbox[name]) for name in ("gear_ratios", "final_drive_ratios"))
    overall = gears * finals
    steps = overall[:-1] / overall[1:]
    steps = 1.0 + (steps - 1.0) * np.maximum(0.6, 1.0 + rng.normal(0.0, STEP_STD_RATIO / (steps - 1.0)))
    overall = overall[0] / np.concatenate(([1.0], np.cumprod(steps)))
    return (overall / finals).tolist(), (overall / finals[0]).tolist()


def driven(folder: Path, seed: int, gears: Sequence[float]) -> list[Path]:
    """Return the logs of an emulated car: its shift cycle and a drive in traffic."""
    scenario = folder / f"{seed}.toml"
    values = ", ".join(f"{one:.6f}" for one in gears)
    scenario.write_text(f'name = "learned"\n[truth.plant.gearbox]\ngear_ratios = [{values}]\n', encoding="utf-8")
    logs = []
    for name, words in (("cycle", ["--cycles", "2"]), ("us06", ["--drive", "us06"])):
        log = folder / f"{seed}-{name}.log"
        emulator(["record", str(log), "--scenario", str(scenario), "--seed", str(seed), *words])
        logs.append(log)
    return logs


def rows(name: str, found: LearnedVehicle, truth: Sequence[float]) -> Iterator[str]:
    """Yield a line for each value: found, stated deviation, truth, error in deviations."""
    for gear, one in found.gears.items():
        true = truth[gear - 1] if gear <= len(truth) else float("nan")
        ratio, std = one.ratio.ratio, one.ratio.std
        off = f"{100 * (ratio / true - 1.0):+.3f} % | {(ratio - true) / std:+.1f}"
        right = "right" if one.clutch == clutch_of_gear(gear) else f"wrong: {one.clutch}"
        yield f"| {name} | ratio of gear {gear} | {ratio:.4f} | {std:.4f} | {true:.4f} | {off} | {right} |"
    for clutch, lag in found.lag_s.items():
        value, std = 1e3 * lag.value, 1e3 * lag.std
        yield f"| {name} | pressure behind its command, clutch {clutch}, ms | {value:.1f} | {std:.1f} | | | |"
    for clutch, gain in found.gain_rad_s2_pa.items():
        value, std = 1e3 * gain.value, 1e3 * gain.std
        yield f"| {name} | gain of clutch {clutch}, rad/s2 a kPa | {value:.2f} | {std:.2f} | | | |"
    held = ", ".join(f"clutch {one}" for one in found.touch_pa) or "of no clutch: none is held at standstill here"
    yield f"| {name} | touch points told | {held} | | | | |"


def emulated(vehicles: int, folder: Path) -> Iterator[tuple[str, LearnedVehicle, list[float]]]:
    """Yield what was learned of drawn cars from their frames, and from tables without gears."""
    for seed in range(1, vehicles + 1):
        gears, truth = drawn_ratios(np.random.default_rng(seed))
        logs = driven(folder, seed, gears)
        yield f"{seed} frames", learned_from(logs, interpret(None, None), stop=Trigger()), truth
        tables = []
        for log in logs:
            tables.append(log.with_suffix(".csv"))
            written(log, tables[-1], np.random.default_rng(seed), left_out=GEARS_OF)
        yield f"{seed} table", learned_from(tables, meaning_of(tables[0], folder), stop=Trigger()), truth
        for path in (*logs, *tables):
            path.unlink()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", type=Path, metavar="FILE", help="tables of signals of one vehicle")
    parser.add_argument("--vehicles", type=int, default=3, help="emulated cars")
    options = parser.parse_args(arguments)
    off: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(HEAD)
        for title, found, truth in emulated(options.vehicles, folder):
            print("\n".join(rows(title, found, truth)), flush=True)
            off += [(one.ratio.ratio - truth[gear - 1]) / one.ratio.std for gear, one in found.gears.items()]
            missing = sorted(set(range(1, 7)) - set(found.gears))
            print(f"| {title} | gears | {len(found.gears)}{f', without {missing}' if missing else ''} | | 6 | | | |")
        if off:
            errors: FloatArray = np.abs(np.array(off))
            inside = 100 * np.mean(errors < 2.0)
            print(f"\n{len(off)} ratios: {inside:.0f} % within two deviations, worst {errors.max():.1f}")
        if options.tables:
            found = learned_from(options.tables, meaning_of(options.tables[0], folder), stop=Trigger())
            print("\n" + "\n".join(said(found)))


if __name__ == "__main__":
    main()
