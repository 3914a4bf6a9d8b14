"""``diag-service learn``, ``calibrate``, ``predict`` and ``transmission``: what is known of a vehicle, for people."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from clutch_model.calibration import nominal_calibration, read_calibration
from clutch_model.transmission import Transmission, read_transmission
from clutch_model.units import bar_from_pa, pa_from_bar, rpm_from_rad_s
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.people import PLUS_MINUS, digits, plus_minus
from clutchdiag_io.program import replacement_refusal
from diag_service.api.choices import diagnosis_config
from diag_service.api.learning import (
    OURS,
    PredictedShift,
    inside_ratio,
    learned_from,
    learned_record,
    predict_shifts,
    said,
    scores,
    write_description,
)
from diag_service.console import ReadingLine, write_record
from diag_service.diagnosis.prediction import LEAST_EVENTS
from diag_service.errors import ConfigError
from diag_service.service import calibrate_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import MeaningOptions
from fleet_contract import JsonObject

SCHEMA: Final = "clutchdiag/transmission/v1"


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnOptions(MeaningOptions):
    """From which logs a file about their vehicle is made."""

    logs: tuple[Path, ...]
    output: Path
    force: bool
    json: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictOptions:
    """Which shifts are predicted, and from what."""

    logs: tuple[Path, ...]
    dbc: Path | None
    profile: Path | None
    touch: float | None  # [bar]
    halves: bool
    json: bool


def learn(options: LearnOptions, controls: Controls) -> None:
    """Learn a vehicle, and write and show its description."""
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    assumed = nominal_calibration() if options.calibration is None else read_calibration(options.calibration)
    with ReadingLine() as line:
        learned = learned_from(
            options.logs,
            options.profile,
            options.dbc,
            columns=options.columns,
            stop=controls.stop,
            watch=line.watch,
        )
    write_description(options.output, learned, assumed, options.logs)
    last = f"description in {options.output}: what is assumed there, a drawing or a data sheet tells better"
    told = {**learned_record(learned), "output": str(options.output)}
    write_record(told, (*said(learned), last), as_json=options.json)


def calibrate(options: LearnOptions, controls: Controls) -> None:
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    config = diagnosis_config(options)
    calibrate_run.run_calibrate(config, options.logs, options.output, controls.stop, as_json=options.json)


def predict(options: PredictOptions, controls: Controls) -> None:
    """Predict the shifts of logs from each other and show how well it went."""
    touch_pa = None if options.touch is None else pa_from_bar(options.touch)
    with ReadingLine() as line:
        found = predict_shifts(
            options.logs,
            options.profile,
            options.dbc,
            touch_pa=touch_pa,
            is_by_halves=options.halves,
            stop=controls.stop,
            watch=line.watch,
        )
    console = PeopleConsole(stderr=options.json)
    for record in found.records() if options.json else ():
        sys.stdout.write(dump(record) + "\n")
    for title, shown in found.groups.items() if not options.json else ():
        console.print_all(_lines(title, shown))
    for title, count in found.too_few.items():
        console.print(f"{title}: {count}, too few to predict one from others ({LEAST_EVENTS} others are needed)")
    for log, one in found.not_used:
        console.print(f"{log}: {one.event.from_gear}-{one.event.to_gear} not used: {one.reason}")
    if found.touch_pa is not None:
        origin = ", as found at standstill" if touch_pa is None else ""
        console.print(f"touch point: {digits(bar_from_pa(found.touch_pa))} bar{origin}")


def _lines(title: str, shown: Sequence[PredictedShift]) -> Iterator[str]:
    """Yield the table of one group: engine speed from the old gear to the last sample before the clutch locks."""
    yield f"{title}: change of engine speed in the slip [rpm], each predicted from others; {PLUS_MINUS}"
    yield f"{'log':<16} {'gears':>5} {'samples':>7} {'measured':>8} {'predicted':>15} {'error':>6}  in 50 % in 90 %"
    for one in shown:
        prediction, true = one.predictions[OURS], float(one.phase.change_rad_s[-1])
        mean, scale = float(prediction.mean_rad_s[-1]), float(prediction.scale_rad_s[-1])
        inside = ["yes" if inside_ratio([(mean, scale, prediction.freedom, true)], part) else "no" for part in (50, 90)]
        std = scale * (prediction.freedom / (prediction.freedom - 2.0)) ** 0.5  # of Student's distribution
        gears, spread = (
            f"{one.phase.from_gear}-{one.phase.to_gear}",
            plus_minus(rpm_from_rad_s(mean), rpm_from_rad_s(std), "{:.0f}"),
        )
        yield (
            f"{one.log[:16]:<16} {gears:>5} {len(one.phase.t_s):>7} {rpm_from_rad_s(true):>8.0f} {spread:>15} "
            f"{100 * (mean / true - 1):>5.0f}%  {inside[0]:>7} {inside[1]:>7}"
        )
    yield f"{'all':<28} {'median error':>12} {'CRPS rpm':>10} {'in 50 %':>8} {'in 90 %':>8}   of all samples"
    for name, score in scores(shown).items():
        yield (
            f"{name:<28} {100 * score['median_error_ratio']:>10.0f} % {rpm_from_rad_s(score['crps_rad_s']):>10.0f} "
            f"{100 * score['inside_50']:>6.0f} % {100 * score['inside_90']:>6.0f} %   "
            f"{100 * score['samples_inside_50']:.0f} % and {100 * score['samples_inside_90']:.0f} %"
        )


def show_transmission(file: Path, *, json: bool) -> None:
    transmission = read_transmission(file)
    write_record(transmission_record(transmission), transmission_lines(transmission), as_json=json)


def transmission_record(transmission: Transmission) -> JsonObject:
    """Return ratios, levers and slips of all gears, and what each change of one element tells."""
    gears: list[JsonObject] = [
        {
            "number": one.number,
            "ratio": transmission.ratio(one),
            "levers": transmission.levers(one),
            "slips": {name: slip for name, slip in transmission.slips(one).items() if np.isfinite(slip)},
        }
        for one in transmission.gears
    ]
    changes: list[JsonObject] = [
        {
            "lower": one.lower,
            "upper": one.upper,
            "elements": {
                name: {"slip_by_input": slip.by_input, "slip_by_output": slip.by_output}
                for name, slip in zip((one.coming, one.going), one.slips, strict=True)
            },
            "told": [name for name, *_ in one.told],
        }
        for one in transmission.changes()
    ]
    return {"schema": SCHEMA, "name": transmission.name, "gears": gears, "changes": changes}


def transmission_lines(transmission: Transmission) -> Iterator[str]:
    """Yield the same for people, a line each."""
    yield transmission.name
    for one in transmission.gears:
        levers = ", ".join(f"{name} {lever:+.2f}" for name, lever in transmission.levers(one).items())
        gear = "reverse" if one.number < 0 else f"gear {one.number}"
        yield f"{gear}: ratio {transmission.ratio(one):.3f}; torque over the input's: {levers}"
    told: dict[str, list[str]] = {one.name: [] for one in transmission.elements}
    for change in transmission.changes():
        for name, gears, slip in change.told:
            told[name].append(f"{gears[0]}-{gears[1]} (lever {slip.by_input:+.2f})")
    for name, changes in told.items():
        yield f"{name} can be told from {', '.join(changes)}" if changes else f"{name}: no change of gears tells it"
