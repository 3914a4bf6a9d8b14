"""What ``diag-service learn`` finds of vehicles that nobody described, beside the truth.

    python -m studies.learn --vehicles 3 drive-a.csv

The gearboxes of the emulated cars are drawn: every step between two gears differs from the type's by 6 % (standard
deviation). Each drives the shift cycle and US06; its frames and a table of 27 rows a second, without the gears, are
learned from. The true lag is the valve's and what readings are old; the true gain lies between those of mu_S and mu_C,
and the share of the engine's inertia that is drawn. A table of a real car is learned from too, its truth is not known.
"""

import argparse
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studies.real_dct import meaning_of
from studies.scan_tool import written
from clutch_model.calibration import clutch_of_gear, nominal_calibration
from clutch_model.pack import contact_torques_nm
from diag_service.commands.learn import learned_from, said
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.learning import LearnedVehicle
from diag_service.service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from ecu_emulator.plant.parameters import nominal_parameters, plant_table

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


def rows(name: str, found: LearnedVehicle, truth: Sequence[float], drawn: Mapping[str, float]) -> Iterator[str]:
    """Yield a line for each value: found, stated deviation, truth, error in deviations."""
    for gear, one in found.gears.items():
        true = truth[gear - 1] if gear <= len(truth) else float("nan")
        right = "right" if one.clutch == clutch_of_gear(gear) else f"wrong: {one.clutch}"
        yield row(name, f"ratio of gear {gear}", one.ratio.ratio, one.ratio.std, true, right)
    nominal, valve = nominal_calibration(), nominal_parameters().hydraulics
    late_s = valve.solenoid_lag_s + nominal.bias.pressure_latency_s + drawn["pressure_latency_s"]
    for clutch, lag in found.lag_s.items():
        what = f"pressure behind its command, clutch {clutch}, ms"
        yield row(name, what, 1e3 * lag.value, 1e3 * lag.std, 1e3 * late_s)
    side = nominal.input_side
    mass_kg_m2 = side.engine_inertia_kg_m2 * (1.0 + drawn["engine_inertia_ratio"]) + side.hub_inertia_kg_m2
    for clutch, gain in found.gain_rad_s2_pa.items():
        pack = nominal.clutches[clutch - 1]
        area_ratio = pack.geometry.piston_area_m2 / pack.geometry.faces.lining_area_m2
        area_ratio *= 1.0 + drawn[f"clutch{clutch}_piston_area_ratio"]
        by_pressure_m3 = contact_torques_nm(1.0, pack.friction.mu_c, area_ratio, pack.geometry.faces.contact_factor_m3)
        true = by_pressure_m3 / mass_kg_m2
        yield row(name, f"gain of clutch {clutch}, rad/s2 a kPa", 1e3 * gain.value, 1e3 * gain.std, 1e3 * true)
    for clutch, touch in found.touch_pa.items():
        true = nominal.clutches[clutch - 1].touch_pressure_pa + drawn[f"clutch{clutch}_touch_pressure_pa"]
        yield row(name, f"touch point of clutch {clutch}, kPa", 1e-3 * touch.value, 1e-3 * touch.std, 1e-3 * true)
    if not found.touch_pa:
        yield f"| {name} | touch points | none: no clutch is held at standstill here | | | | | |"


def row(name: str, what: str, found: float, std: float, truth: float, right: str = "") -> str:
    """Return one value beside its truth."""
    off = f"{100 * (found / truth - 1.0):+.3f} % | {(found - truth) / std:+.1f}"
    return f"| {name} | {what} | {found:.5g} | {std:.2g} | {truth:.5g} | {off} | {right} |"


def drawn_for(log: Path) -> Mapping[str, float]:
    """Return by what the car of a log differs from its type."""
    with log.with_name(f"{log.name}.truth.jsonl").open(encoding="utf-8") as lines:
        drawn = json.loads(next(lines))["drawn"]
    return {name: float(value) for name, value in drawn.items()}


def emulated(
    seeds: Iterable[int], folder: Path
) -> Iterator[tuple[str, LearnedVehicle, list[float], Mapping[str, float]]]:
    """Yield what was learned of drawn cars from their frames, and from tables without gears."""
    for seed in seeds:
        gears, truth = drawn_ratios(np.random.default_rng(seed))
        logs = driven(folder, seed, gears)
        drawn = drawn_for(logs[0])
        yield f"{seed} frames", learned_from(logs, interpret(None, None), stop=Trigger()), truth, drawn
        tables = []
        for log in logs:
            tables.append(log.with_suffix(".csv"))
            written(log, tables[-1], np.random.default_rng(seed), left_out=GEARS_OF)
        yield f"{seed} table", learned_from(tables, meaning_of(tables[0], folder), stop=Trigger()), truth, drawn
        for path in (*logs, *tables):
            path.unlink()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", type=Path, metavar="FILE", help="tables of signals of one vehicle")
    parser.add_argument("--vehicles", type=int, default=3, help="emulated cars")
    parser.add_argument("--seed", type=int, default=1, help="of the first of them")
    options = parser.parse_args(arguments)
    off: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(HEAD)
        for title, found, truth, drawn in emulated(range(options.seed, options.seed + options.vehicles), folder):
            print("\n".join(rows(title, found, truth, drawn)), flush=True)
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
