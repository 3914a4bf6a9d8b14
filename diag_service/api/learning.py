"""What logs teach of a vehicle: predictions of its shifts, its description."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canlog.logs import read_log
from canlog.logs.reading import Watch
from clutch_model.calibration import nominal_calibration, read_calibration
from clutch_model.units import bar_from_pa, pa_from_bar, rpm_from_rad_s
from clutchdiag_io.people import PLUS_MINUS, half_width, plus_minus
from clutchdiag_io.program import legible
from diag_service.api.choices import AnyPath, AnyPaths, optional_path, path_list
from diag_service.console import SILENT, ReadingLine, collected_notices
from diag_service.diagnosis.blind_test import BlindTest, blind_test, each_left_out, each_log, scores, second_half
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.shifts.gear_tracking import tracker_for
from diag_service.diagnosis.shifts.shifts import PRE_NS
from diag_service.diagnosis.shifts.tracking import NS_PER_S, EventFinder
from diag_service.diagnosis.slip_phase import PRESSURES, NoPhase, SlipPhase, Standing, slip_phase
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.mapping.learning import BEHIND, COMMANDS, LearnedVehicle, VehicleSurvey
from diag_service.mapping.mapped_messages import is_of_lockup, missing_for_next
from diag_service.mapping.vehicle_file import description_toml
from diag_service.settings.config import write_text
from diag_service.settings.options import LearnOptions, PredictOptions, as_proposed, check_replaceable, diagnosis_config
from diag_service.stopping import Controls, Trigger

if TYPE_CHECKING:
    from diag_service.diagnosis.events import Event

PREDICT_SCHEMA: Final = "clutchdiag/predict/v1"
LEARN_SCHEMA: Final = "clutchdiag/learn/v1"
AFTER_NS: Final = NS_PER_S // 2  # behind a gear change: its slip is nearly closed there


def predict(
    paths: AnyPaths,
    profile: AnyPath | None = None,
    dbc: AnyPath | None = None,
    *,
    touch_pa: float | None = None,
    is_by_halves: bool = False,
    is_by_log: bool = False,
) -> list[dict[str, Any]]:
    """Predict shifts of logs from the others, as ``diag-service predict`` does (docs/logs.md).

    Parameters
    ----------
    paths
        Logs of one type of vehicle, frames or tables of signals.
    profile, dbc
        As of ``analyze``.
    touch_pa
        Touch point of the clutches [Pa]; None: the pressure in gear at standstill.
    is_by_halves
        Whether the second half is predicted from the first; else each shift from all others.
    is_by_log
        Whether the shifts of each log are predicted from the other logs alone.

    Returns
    -------
    list of dict
        A record for each kind of gear change: ``shifts`` with the recorded change of engine speed [rad/s] and what
        each model said of it, and ``scores``. If these fail, ``refused`` says why and there are no ``shifts``;
        ``unknown`` are those that nothing is said of.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If a log or the database cannot be read, or the profile lacks what a prediction needs.
    """
    options = PredictOptions(
        logs=path_list(paths), touch_pa=touch_pa, halves=is_by_halves, each_log=is_by_log,
        profile=optional_path(profile), dbc=optional_path(dbc),
    )  # fmt: skip
    with collected_notices():
        return predict_shifts(options, Controls()).records()


def learn(
    paths: AnyPaths,
    profile: AnyPath | None = None,
    dbc: AnyPath | None = None,
    *,
    output: AnyPath | None = None,
    calibration: AnyPath | None = None,
    columns: str = "",
) -> dict[str, Any]:
    """Describe an unknown vehicle from its logs, as ``diag-service learn`` does.

    Parameters
    ----------
    paths
        Logs of one vehicle, frames or tables of signals.
    profile, dbc, columns
        As of ``analyze``.
    output
        Where the description goes, which ``analyze(calibration=...)`` takes; None: nowhere.
    calibration
        Of the type that all is assumed from which the logs do not tell; None: the shipped one.

    Returns
    -------
    dict
        ``gears`` with ratio, deviation and clutch of each, and by clutch touch points [Pa], lags [s] and gains
        [rad/s^2 a Pa], each with its deviation and origin; what is absent the logs do not tell.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If a log or the database cannot be read, or the profile lacks the speeds.
    """
    options = LearnOptions(
        logs=path_list(paths), output=optional_path(output), force=True, columns=columns,
        profile=optional_path(profile), dbc=optional_path(dbc), calibration=optional_path(calibration),
    )  # fmt: skip
    with collected_notices():
        return learned_record(learn_vehicle(options, Controls()))


def slip_phases(
    log: Path, meaning: Interpretation, standing: Standing, stop: Trigger, watch: Watch | None = None, columns: str = ""
) -> tuple[list[SlipPhase], list[NoPhase]]:
    """Return the slip phases of the gear changes of a log, and the gear changes without one; raises StoppedError."""
    decoder = meaning.decoder()
    finder = EventFinder(tracker_for(decoder.signals, decoder.gears), PRE_NS, AFTER_NS)
    events: list[Event] = []
    with read_log(log, is_stopped=lambda: stop.is_set, watch=watch, columns=columns) as reader:
        for samples in decoder.whole(reader):
            if stop.is_set:
                raise StoppedError("stopped early: nothing is predicted from a part of a log")
            standing.add(samples)
            events += decoder.marked(finder.feed(samples))
    outcomes = [slip_phase(event, decoder.gears) for event in [*events, *decoder.marked(finder.flush())]]
    phases = [outcome for outcome in outcomes if isinstance(outcome, SlipPhase)]
    return phases, [outcome for outcome in outcomes if isinstance(outcome, NoPhase)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """The gear changes of some logs: each predicted from others, by kind, and those that cannot be."""

    tests: dict[str, BlindTest]
    not_used: list[tuple[str, NoPhase]]  # log, and why
    touch_pa: float | None

    def records(self) -> list[dict[str, object]]:
        """Return what ``--json`` prints, a record for each kind of gear change."""
        return [_record(title, test, self.touch_pa) for title, test in self.tests.items() if test.shown or test.unknown]


def predict_shifts(options: PredictOptions, controls: Controls, line: ReadingLine = SILENT) -> Predicted:
    """Return the gear changes of logs of one type of vehicle, each predicted from the others or by the first half.

    Raises ConfigError if the profile lacks what this needs, SourceError if a log cannot be read, StoppedError.
    """
    config = as_proposed(diagnosis_config(options), options.logs, lambda: controls.stop.is_set)
    meaning = config.interpretation()
    signals = meaning.decoder().signals
    wanted = {Signal.ENGINE_SPEED, *PRESSURES.values()}
    if not wanted <= signals:
        lacking = ", ".join(sorted(signal.value for signal in wanted - signals))
        raise ConfigError(f"profile {meaning.profile.name} has no {lacking}. {missing_for_next(signals)}".rstrip())
    standing, used, without = Standing(), list[tuple[str, SlipPhase]](), list[tuple[str, NoPhase]]()
    for log in options.logs:
        phases, others = slip_phases(log, meaning, standing, controls.stop, line.watch)
        used += [(log.name, phase) for phase in phases]
        without += [(log.name, event) for event in others]
    touch_pa = standing.touch_pa if options.touch_pa is None else options.touch_pa
    groups = {
        "power upshifts": [(log, phase) for log, phase in used if phase.sign > 0.0 and phase.is_powered],
        "other upshifts": [(log, phase) for log, phase in used if phase.sign > 0.0 and not phase.is_powered],
        "downshifts": [(log, phase) for log, phase in used if phase.sign < 0.0],
    }
    split = second_half if options.halves else each_log if options.each_log else each_left_out
    tests = {title: blind_test(group, touch_pa, split) for title, group in groups.items()}
    return Predicted(tests=tests, not_used=without, touch_pa=touch_pa)


def _record(title: str, test: BlindTest, touch_pa: float | None) -> dict[str, object]:
    why = test.why_refused
    return {
        "schema": PREDICT_SCHEMA,
        "group": title,
        "touch_pa": touch_pa,
        "refused": why or None,
        "unknown": [
            {"log": log, "number": phase.number, "reason": reason} for log, phase, reason in test.unknown
        ],
        "shifts": [
            {
                "log": shift.log, "number": shift.phase.number, "from_gear": shift.phase.from_gear,
                "to_gear": shift.phase.to_gear, "clutch": shift.phase.clutch, "t_s": shift.phase.t_s[1:].tolist(),
                "change_rad_s": shift.phase.change_rad_s.tolist(),
                "predictions": {
                    name: {"mean_rad_s": prediction.mean_rad_s.tolist(), "scale_rad_s": prediction.scale_rad_s.tolist(),
                           "freedom": prediction.freedom} for name, prediction in shift.predictions.items()
                },
            }
            for shift in test.shown if not why
        ],
        "scores": scores(test.shown) if test.shown else {},
    }  # fmt: skip


def learn_vehicle(options: LearnOptions, controls: Controls, line: ReadingLine = SILENT) -> LearnedVehicle:
    """Return what logs tell of their vehicle, and write its description if a file is named; raises as ``learn``."""
    if options.output is not None:
        check_replaceable(options.output, is_forced=options.force)
    named = options.calibration
    assumed = read_calibration(named) if isinstance(named, Path) else named or nominal_calibration()
    learned = _learned(options, controls.stop, line.watch)
    if options.output is not None:
        logs = ", ".join(legible(log.name) for log in options.logs)
        remarks = (
            f"The vehicle of {logs}, for analyze --vehicle-file.",
            f'Behind each value is where it is from: the log, or assumed as of the type "{assumed.name}".',
            'Change what you know better, and write "given" behind it. [learned] is for reading: nothing uses it.',
            *summary_lines(learned),
        )
        write_text(options.output, description_toml(learned, assumed, f"learned from {logs}", remarks))
    return learned


def _learned(options: LearnOptions, stop: Trigger, watch: Watch) -> LearnedVehicle:
    """Return what logs tell of their vehicle; raises ConfigError if they lack the speeds for it, StoppedError."""
    logs, columns = options.logs, options.columns
    config = diagnosis_config(replace(options, calibration=None))  # the logs tell, not the type that is assumed
    meaning = as_proposed(config, logs, lambda: stop.is_set).interpretation()
    if is_of_lockup(meaning.profile.sources.keys()):
        raise ConfigError("learn describes dual clutches: for a lock-up clutch, analyze takes --calibration lockup")
    signals = meaning.decoder().signals
    known = meaning.profile.gears
    over = known.over if known is not None else next((speed for speed in BEHIND if speed in signals), None)
    if over is None or Signal.ENGINE_SPEED not in signals:
        raise ConfigError("nothing can be learned without engine speed and output shaft speed or road speed")
    survey = VehicleSurvey(over)
    for log in logs:
        decoder = meaning.decoder()
        with closing(read_log(log, is_stopped=lambda: stop.is_set, watch=watch, columns=columns)) as reader:
            for samples in decoder.whole(reader):
                if stop.is_set:
                    raise StoppedError("stopped early: nothing is learned from a part of a log")
                survey.add(samples)
    learned = survey.learned()
    if (known is None and learned.ratios is None) or not {*PRESSURES.values()} <= signals:
        return learned
    meaning = meaning.with_gears(known or learned.ratios)
    slips = ((log, slip_phases(log, meaning, Standing(), stop, watch, columns)[0]) for log in logs)
    upshifts = [(str(log), one) for log, phases in slips for one in phases if one.sign > 0.0 and one.is_powered]
    return survey.learned([phase for _, phase in upshifts], [log for log, _ in upshifts])


def summary_lines(learned: LearnedVehicle) -> Iterator[str]:
    """Yield what was learned and what was not, a line each."""
    yield from filter(None, (learned.held_run,))
    yield f"{PLUS_MINUS}:"
    yield from _gear_lines(learned)
    if learned.is_swapped:
        yield "clutch 1 carries the even gears here: name the two pressures the other way round in the profile"
    for clutch in (1, 2):
        if (touch := learned.touch_point(clutch)) is not None:
            pressure = f"{plus_minus(bar_from_pa(touch.value), bar_from_pa(touch.std), '{:.2f}')} bar"
            yield f"clutch {clutch}: touch point {pressure} ({touch.origin})"
        else:
            yield f"clutch {clutch}: touch point assumed: the logs do not tell it"
        yield f"clutch {clutch}: {_lag_text(learned, clutch)}"
        if (gain := learned.gain_rad_s2_pa.get(clutch)) is not None:
            change = plus_minus(rpm_from_rad_s(gain.value), rpm_from_rad_s(gain.std), "{:.3g}", scale=pa_from_bar(1.0))
            yield f"clutch {clutch}: engine speed changes by {change} rpm/s a bar ({gain.origin})"


def _gear_lines(learned: LearnedVehicle) -> Iterator[str]:
    if not learned.gears:
        yield "gears: none was driven for long with its clutch closed"
    for number, gear in learned.gears.items():
        name = "the pressures do not tell its clutch" if gear.clutch is None else f"clutch {gear.clutch}"
        yield f"gear {number}: ratio {gear.ratio.ratio:.4g} ± {half_width(gear.ratio.std, '{:.2g}')}, {name}"
    if learned.gears and not learned.are_named:
        yield "gears are numbered from the highest ratio that was driven: no signal names them"
    for number, count in learned.unclosed.items():
        yield f"gear {number}: driven for {count} samples, in which its clutch was not closed for long: no ratio"
    if learned.gears and learned.ratios is None:
        yield "not every gear was driven for long: drive once more through all of them, or complete [gears] by hand"


def _lag_text(learned: LearnedVehicle, clutch: int) -> str:
    if (lag := learned.lag_s.get(clutch)) is not None:
        return f"pressure {plus_minus(lag.value, lag.std, '{:.0f}', scale=1e3)} ms behind the commanded one"
    if COMMANDS[clutch - 1] in learned.rates_hz:
        return "delay of its pressure unknown: the commanded pressure moves too little, or not as the pressure does"
    return "delay of its pressure unknown: the profile has no commanded pressure"


def learned_record(learned: LearnedVehicle) -> dict[str, object]:
    gears = {str(number): gear for number, gear in learned.gears.items()}
    clutches = {
        name: {
            str(clutch): {"value": value.value, "std": value.std, "origin": value.origin}
            for clutch, value in values.items()
        }
        for name, values in (
            ("touch_pressure_pa", learned.touch_pa),
            ("pressure_lag_s", learned.lag_s),
            ("gain_rad_s2_pa", learned.gain_rad_s2_pa),
        )
    }
    return {
        "schema": LEARN_SCHEMA,
        "over": learned.over.value,
        "gears": {number: {**gear.ratio._asdict(), "clutch": gear.clutch} for number, gear in gears.items()},
        "gears_are_named": learned.are_named,
        "held_run": learned.held_run or None,
        **clutches,
        "rates_hz": {signal.value: rate for signal, rate in learned.rates_hz.items()},
    }
