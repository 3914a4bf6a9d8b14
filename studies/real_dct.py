"""Blind prediction of shifts of a real dual-clutch transmission, beside the same of emulated drives as such tables.

    python -m studies.real_dct drive-a.csv drive-b.csv --vehicles 12

The profile is what ``diag-service signals`` proposes from the first table. No shift tells anything of its own
prediction: each is left out, or only the first half is known. Emulated cars are predicted each from its own shifts.
Downshifts are predicted from the other downshifts, launches from all power upshifts: none of one clutch are many.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from scipy.special import stdtrit

from canlog.arrays import FloatArray
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EventKind
from demo.drawing import as_svg, drawing_style
from diag_service.api.learning import (
    OURS,
    PredictedShift,
    left_out_one_by_one,
    scores,
    second_half_from_first,
    slip_phases,
)
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.prediction import (
    DELAY_STD_S,
    FREEDOM,
    LEAST_EVENTS,
    LEAST_ROWS,
    PRESSURES,
    STEP_RATIO,
    STEP_S,
    TORQUE_SOURCES,
    Prediction,
    Scales,
    SlipPhase,
    Standing,
    fitted,
)
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.mapping.learning import proposed_profile
from diag_service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from studies.builders import written
from studies.run import parsed, study_parser

RPM = 30.0 / np.pi  # of rad/s


def _mean_rate(known: Sequence[SlipPhase], phase: SlipPhase) -> float:
    own = [one for one in known if one.clutch == phase.clutch] or known
    return float(np.mean([one.change_rad_s[-1] / one.t_s[-1] for one in own]))


def _line_of_pressure(known: Sequence[SlipPhase], phase: SlipPhase) -> float:
    rates = [one.change_rad_s[-1] / one.t_s[-1] for one in known]
    slope, level = np.polyfit([one.mean_pa for one in known], rates, 1)
    return float(slope * phase.mean_pa + level)


def _nearest_shift(known: Sequence[SlipPhase], phase: SlipPhase) -> float:
    nearest = min(known, key=lambda one: (one.to_gear != phase.to_gear, abs(one.mean_pa - phase.mean_pa)))
    return float(nearest.change_rad_s[-1] / nearest.t_s[-1])


SIMPLER: Final[Mapping[str, Callable[[Sequence[SlipPhase], SlipPhase], float]]] = {
    "mean rate of the clutch": _mean_rate,
    "line through mean pressure": _line_of_pressure,
    "nearest shift": _nearest_shift,
}
"""Rates of engine speed from other shifts, each a straight line through the slip phase."""


def predicted_simply(name: str, known: Sequence[SlipPhase], phase: SlipPhase) -> Prediction:
    """Return what a simpler model says of a shift; its deviation is what it misses on the known ones, each left out."""
    rate = SIMPLER[name]
    missed = [
        rate([other for other in known if other is not one], one) * one.t_s[-1] - one.change_rad_s[-1] for one in known
    ]
    mean = rate(known, phase) * phase.t_s[1:]
    std = float(np.sqrt(np.mean(np.square(missed)))) * phase.t_s[1:] / phase.t_s[-1]
    return Prediction(mean_rad_s=mean, scale_rad_s=std, freedom=float(len(known)))


def beside_simpler(shown: PredictedShift, known: Sequence[SlipPhase]) -> PredictedShift:
    """Return a shift with what simpler models say of it from the same others."""
    simpler = {name: predicted_simply(name, known, shown.phase) for name in SIMPLER}
    return replace(shown, predictions={**shown.predictions, **simpler})


def each_from_others(named: Sequence[tuple[str, SlipPhase]], touch_pa: float | None) -> Iterator[PredictedShift]:
    """Yield every shift with what the others say of it."""
    for one in left_out_one_by_one(named, touch_pa):
        yield beside_simpler(one, [other for _, other in named if other is not one.phase])


def half_from_half(named: Sequence[tuple[str, SlipPhase]], touch_pa: float | None) -> Iterator[PredictedShift]:
    """Yield the shifts of the second half with what those of the first say."""
    known = [phase for _, phase in named[: (len(named) + 1) // 2]]
    for one in second_half_from_first(named, touch_pa):
        yield beside_simpler(one, known)


SPLITS = {"each from all others": each_from_others, "second half from the first": half_from_half}


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


def launches(table: Path, meaning: Interpretation) -> Iterator[SlipPhase]:
    """Yield the slip of each launch: clutch 1 drags a shaft that turns by the first ratio; clutch 2 is open."""
    decoder, calibration = meaning.decoder(), nominal_calibration()
    gears = decoder.gears
    if gears is None or Signal.ENGINE_SPEED not in decoder.signals:
        return
    finder = DriveFinder(decoder.signals, calibration, gears)
    with read_log(table) as reader:
        events = [event for part in decoder.whole(reader) for event in finder.feed(part)]
    for event in (*events, *finder.flush()):
        engine, over = event.columns.get(Signal.ENGINE_SPEED), event.columns.get(gears.over)
        if event.kind is not EventKind.LAUNCH or engine is None or over is None:
            continue
        slip_rad_s = engine.value - gears.ratios[0] * np.interp(engine.t_ns, over.t_ns, over.value)
        rows = (engine.t_ns >= event.start_ns) & (engine.t_ns <= event.end_ns)
        rows &= np.logical_and.accumulate((slip_rad_s > 0.0) | (engine.t_ns < event.start_ns))
        if rows.sum() < LEAST_ROWS:
            continue
        source = next((event.columns[one] for one in TORQUE_SOURCES if one in event.columns), None)
        pressures = [event.columns[PRESSURES[clutch]] for clutch in (1, 2)]
        on_pa, off_pa = (np.column_stack([(one.t_ns - event.start_ns) / 1e9, one.value]) for one in pressures)
        t_s = (engine.t_ns[rows] - event.start_ns) / 1e9
        drive = np.array([[0.0, 1.0]])
        if source is not None:
            drive = np.column_stack([(source.t_ns - event.start_ns) / 1e9 - t_s[0], source.value])
        on_pa[:, 0] -= t_s[0]
        off_pa[:, 0] -= t_s[0]
        yield SlipPhase(
            number=event.number, from_gear=2, to_gear=1, is_powered=True, start_ns=event.start_ns, t_s=t_s - t_s[0],
            speed_rad_s=engine.value[rows], slip_rad_s=slip_rad_s[rows], on_pa=on_pa, off_pa=off_pa, drive=drive,
        )  # fmt: skip


def launched(parameters: FloatArray, scales: Scales, phase: SlipPhase) -> float:
    """Return the change of engine speed in a launch [rad/s]: no clutch of another gear holds the engine."""
    drive, drag, gain, _, touch, delay = parameters
    t_s = np.arange(0.0, phase.t_s[-1], STEP_S)
    torque = drive * np.interp(t_s, *phase.drive.T) / scales.drive - drag
    above_pa = np.interp(t_s + delay * DELAY_STD_S, *phase.on_pa.T) - scales.touch_pa - touch * scales.touch_std_pa
    carried = gain * np.maximum(above_pa, 0.0) / scales.pressure_pa
    return float(scales.rate_rad_s2 * STEP_S * (torque - carried).sum())


def launch_lines(
    tables: Sequence[Path], meaning: Interpretation, known: Sequence[SlipPhase], touch_pa: float | None
) -> Iterator[str]:
    """Yield what the power upshifts say of each launch: the change of engine speed while its clutch slips."""
    model = fitted(known, touch_pa)
    steps = STEP_RATIO * np.eye(len(model.parameters))
    for path in tables:
        for phase in launches(path, meaning):
            said, true = launched(model.parameters, model.scales, phase), float(phase.change_rad_s[-1])
            moved = [launched(model.parameters + one, model.scales, phase) for one in steps]
            slope = (np.array(moved) - said) / STEP_RATIO
            scale = np.hypot(np.sqrt(slope @ model.covariance @ slope), model.scatter.scales_rad_s(np.array(said)))
            half = float(scale * stdtrit(FREEDOM, 0.95))
            yield (
                f"launch of {path.name}, {phase.t_s[-1]:.2f} s, {len(phase.t_s)} rows: engine speed changes by "
                f"{true:.0f} rad/s, predicted {said:.0f} +- {half:.0f} (90 %)"
            )


def emulated(vehicles: int, cycles: int, folder: Path) -> Iterator[PredictedShift]:
    """Yield the power upshifts of emulated cars at 27 rows a second, each predicted from the others of its car."""
    for seed in range(1, vehicles + 1):
        log, table = folder / f"{seed}.log", folder / f"{seed}.csv"
        emulator(["record", str(log), "--seed", str(seed), "--cycles", str(cycles)])
        written(log, table, np.random.default_rng(seed))
        named, touch_pa = slips([table], meaning_of(table, folder))
        yield from each_from_others(power_upshifts(named), touch_pa)
        log.unlink()


def table(title: str, shown: Sequence[PredictedShift], what: str = "power upshifts") -> Iterator[str]:
    """Yield what each model was worth, as a table."""
    found = scores(shown)
    best = min(score["crps_rad_s"] for name, score in found.items() if name != OURS)
    yield f"\n{title}: {len(shown)} {what}\n"
    yield "| model | median error | CRPS rad/s | ends in 50 % | in 90 % | samples in 50 % | in 90 % |"
    yield "|---|---|---|---|---|---|---|"
    for name, score in found.items():
        inside = (score[key] for key in ("inside_50", "inside_90", "samples_inside_50", "samples_inside_90"))
        shares = " | ".join(f"{100 * one:.0f} %" for one in inside)
        yield f"| {name} | {100 * score['median_error_ratio']:.1f} % | {score['crps_rad_s']:.2f} | {shares} |"
    left = [one.predictions[OURS].mean_rad_s[-1] / one.phase.change_rad_s[-1] - 1.0 for one in shown]
    spread = 100 * float(np.percentile(np.abs(left), 68))
    yield f"\nCRPS over that of the best simpler model: {found[OURS]['crps_rad_s'] / best:.2f}; "
    yield f"68 of 100 shifts are predicted within {spread:.1f} % of their change"


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
            meaning = meaning_of(options.tables[0], folder)
            named, touch_pa = slips(options.tables, meaning)
            upshifts, downshifts = power_upshifts(named), [one for one in named if one[1].sign < 0.0]
            for title, split in SPLITS.items():
                shown = list(split(upshifts, touch_pa))
                print("\n".join(table(f"Recorded, {title}", shown)), flush=True)
                if options.picture and split is each_from_others:
                    drawn = max(shown[1:], key=lambda one: len(one.phase.t_s))
                    options.picture.write_text(picture(drawn), encoding="utf-8")
            if len(downshifts) > LEAST_EVENTS:
                shown = list(each_from_others(downshifts, touch_pa))
                print("\n".join(table("Recorded, each from all others", shown, "downshifts")))
            known = [phase for _, phase in upshifts]
            print("\n" + "\n".join(launch_lines(options.tables, meaning, known, touch_pa)), flush=True)
        if options.vehicles:
            shown = list(emulated(options.vehicles, options.cycles, folder))
            print("\n".join(table("Emulated, each from all others of its car", shown)))


if __name__ == "__main__":
    main()
