"""``diag-service learn``, ``calibrate`` and ``predict``: what is known of a vehicle, for people."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from clutch_model.units import bar_from_pa, rpm_from_rad_s
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole, plain_table
from clutchdiag_io.people import PLUS_MINUS, digits, half_width, plus_minus
from diag_service.api.calibration import FoundCalibration, calibrate_vehicle
from diag_service.api.learning import learn_vehicle, learned_record, predict_shifts, summary_lines
from diag_service.console import ReadingLine, write_record
from diag_service.diagnosis.blind_test import OURS, PredictedShift, levels, scores
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.self_calibration import SelfCalibration
from diag_service.diagnosis.summary import GAP_TEXT
from diag_service.settings.options import LearnOptions, PredictOptions
from diag_service.stopping import Controls
from fleet_contract import JsonObject

SCHEMA: Final = "clutchdiag/self-calibration/v1"
_PER_CENT, _BAR = 100.0, float(bar_from_pa(1.0))
_UNITS: Final[Mapping[str, tuple[str, str, float]]] = {  # how people read a parameter: label, unit, factor from SI
    "torque_offset": ("torque offset", "Nm", 1.0),
    "touch1": ("touch pressure of clutch 1, error", "bar", _BAR),
    "touch2": ("touch pressure of clutch 2, error", "bar", _BAR),
    "zero1": ("pressure zero of clutch 1", "bar", _BAR),
    "zero2": ("pressure zero of clutch 2", "bar", _BAR),
    "torque_gain": ("torque gain, error", "%", _PER_CENT),
    "engine_inertia": ("engine inertia, error", "%", _PER_CENT),
    "piston_area1": ("piston area of clutch 1, error", "%", _PER_CENT),
    "piston_area2": ("piston area of clutch 2, error", "%", _PER_CENT),
    "viscosity": ("viscosity, error", "%", _PER_CENT),
    "torque_latency": ("torque latency against the speeds", "ms", 1e3),
    "pressure_latency": ("pressure latency against the speeds", "ms", 1e3),
    "motoring_gain": ("gain of motoring torque, error", "%", _PER_CENT),
    "stribeck_speed": ("Stribeck speed, error", "%", _PER_CENT),
    "contact_stiffness": ("contact stiffness, error", "%", _PER_CENT),
    "film_mobility": ("film mobility, logarithm of its error", "", 1.0),
    "stribeck_exponent": ("Stribeck exponent, logarithm of its error", "", 1.0),
    "friction_temperature": ("friction per temperature", "%/K", _PER_CENT),
    "open_drag": ("drag of open clutches, logarithm of its error", "", 1.0),
    "shaft_inertia": ("inertia of the input shafts, error", "%", _PER_CENT),
}


def learn(options: LearnOptions, controls: Controls) -> None:
    """Learn a vehicle, and write and show its description."""
    with ReadingLine() as line:
        learned = learn_vehicle(options, controls, line)
    last = f"written to {options.output}; a drawing or data sheet can replace what is assumed there"
    record = {**learned_record(learned), "output": str(options.output)}
    write_record(record, (*summary_lines(learned), last), as_json=options.json)


def predict(options: PredictOptions, controls: Controls) -> None:
    """Predict the shifts of logs from each other and show how well it went."""
    with ReadingLine() as line:
        predicted = predict_shifts(options, controls, line)
    console = PeopleConsole(stderr=options.json)
    for record in predicted.records() if options.json else ():
        sys.stdout.write(dump(record) + "\n")
    for title, test in predicted.tests.items():
        if why := test.why_refused:
            console.print(f"{title}: not predicted: {why}")
        elif not options.json:
            console.print_all(_lines(title, test.shown))
        for (log, unknown), count in Counter((log, reason) for log, _, reason in test.unknown).items():
            console.print(f"{log}: {count} of the {title} not predicted: {unknown}")
    console.print("launches are not predicted: from rest, the sign and gain that gear changes teach do not hold")
    for log, unused in predicted.not_used:
        console.print(f"{log}: {unused.event.from_gear}-{unused.event.to_gear} not used: {unused.reason}")
    if predicted.touch_pa is not None:
        origin = ", as found at standstill" if options.touch_pa is None else ""
        console.print(f"touch point: {digits(bar_from_pa(predicted.touch_pa))} bar{origin}")


def _lines(title: str, shown: Sequence[PredictedShift]) -> Iterator[str]:
    """Yield the table of one group: engine speed from the old gear to the last sample before the clutch locks."""
    yield f"{title}: change of engine speed in the slip [rpm], each predicted from others; {PLUS_MINUS}"
    yield f"{'log':<16} {'gears':>5} {'samples':>7} {'measured':>8} {'predicted':>15} {'error':>6}  in 50 % in 90 %"
    for shift in shown:
        prediction, true = shift.predictions[OURS], float(shift.phase.change_rad_s[-1])
        mean, scale = float(prediction.mean_rad_s[-1]), float(prediction.scale_rad_s[-1])
        level = levels(prediction, shift.phase.change_rad_s)[-1]
        inside = ["yes" if level < part / 100.0 else "no" for part in (50, 90)]
        std = scale * (prediction.freedom / (prediction.freedom - 2.0)) ** 0.5  # of Student's distribution
        gears, spread = (
            f"{shift.phase.from_gear}-{shift.phase.to_gear}",
            plus_minus(rpm_from_rad_s(mean), rpm_from_rad_s(std), "{:.0f}"),
        )
        yield (
            f"{shift.log[:16]:<16} {gears:>5} {len(shift.phase.t_s):>7} {rpm_from_rad_s(true):>8.0f} {spread:>15} "
            f"{100 * (mean / true - 1):>5.0f}%  {inside[0]:>7} {inside[1]:>7}"
        )
    yield f"{'all':<28} {'median error':>12} {'CRPS rpm':>10} {'in 50 %':>8} {'in 90 %':>8}   of all samples"
    for name, score in scores(shown).items():
        yield (
            f"{name:<28} {100 * score['median_error_ratio']:>10.0f} % {rpm_from_rad_s(score['crps_rad_s']):>10.0f} "
            f"{100 * score['inside_50']:>6.0f} % {100 * score['inside_90']:>6.0f} %   "
            f"{100 * score['samples_inside_50']:.0f} % and {100 * score['samples_inside_90']:.0f} %"
        )


def calibrate(options: LearnOptions, controls: Controls) -> None:
    """Write the calibration file of a vehicle and show what was found."""
    with ReadingLine() as line:
        outcome = calibrate_vehicle(options, controls, line)
    if options.json:
        sys.stdout.write(dump(_calibration_record(outcome)) + "\n")
    else:
        _show_calibration(outcome, options.output, PeopleConsole())


def _show_calibration(outcome: FoundCalibration, path: Path | None, console: PeopleConsole) -> None:
    for gap in outcome.gaps:
        console.print(f"{GAP_TEXT[gap]}: calibrated from what there is", style="bold red")
    table = plain_table(("parameter", "found", "±", "± before", ""), {"parameter", ""}, PLUS_MINUS)
    for name, value, std, before in outcome.parameters():
        label, unit, factor = _UNITS[name]
        cells = (half_width(number, "{:.3g}", scale=factor) for number in (std, before))
        table.add_row(label, f"{factor * value:+.3g}", *cells, unit)
    console.print(table)
    console.print_all(_calibration_lines(outcome.self_calibration, path))


def _calibration_lines(calibration: SelfCalibration, path: Path | None) -> Iterator[str]:
    for clutch in (1, 2):
        friction = friction_of(calibration.state, clutch)
        yield (
            f"clutch {clutch}: mu_C {plus_minus(friction.mu_c, friction.std_mu_c)}"
            f"  mu_S {plus_minus(friction.mu_s, friction.std_mu_s)}  ({PLUS_MINUS}, total)"
        )
    opened, closed = calibration.run_up_counts
    yield (
        f"used: {calibration.shift_counts[0]} shifts onto clutch 1, {calibration.shift_counts[1]} onto clutch 2, "
        f"engine revs in neutral {opened} with open and {closed} with closed clutches; "
        f"not used: {calibration.rejected_count} shifts; chi-square {calibration.mean_misfit:.2f} per degree of freedom"
    )
    if not (opened and closed):
        yield (
            "the torque gain, and with it the scale of friction, is not observable from driving: "
            "engine revs in neutral with open and then with closed clutches (workshop routine) tell it"
        )
    yield f"calibration {calibration.calibration.version} in {path}"
    if calibration.calibration.vehicle is None:
        yield "it names no vehicle (--vehicle) so it is used for any vehicle"


def _calibration_record(outcome: FoundCalibration) -> JsonObject:
    """Return what was found, for machines; SI units."""
    calibration = outcome.self_calibration
    frictions = {clutch: friction_of(calibration.state, clutch) for clutch in (1, 2)}
    return {
        "schema": SCHEMA,
        "vehicle": outcome.vehicle,
        "complete": not outcome.gaps,
        "incomplete": [gap.value for gap in outcome.gaps],
        "calibration_version": calibration.calibration.version,
        "parameters": {
            name: {"value": value, "std": std, "std_before": before}
            for name, value, std, before in outcome.parameters()
        },
        "friction": {
            str(clutch): {key: getattr(friction, key) for key in ("mu_c", "std_mu_c", "mu_s", "std_mu_s")}
            for clutch, friction in frictions.items()
        },
        "shift_counts": list(calibration.shift_counts),
        "rev_counts": list(calibration.run_up_counts),
        "rejected_shift_count": calibration.rejected_count,
        "chi_square_ratio": calibration.mean_misfit,
    }
