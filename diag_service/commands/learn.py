"""``diag-service learn`` and ``calibrate``: what logs tell of one vehicle, for a person to complete, or as a file."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Final

from canlog.files import replacing
from canlog.logs import read_log
from canlog.logs.reading import Watch
from clutch_model.calibration import Calibration, nominal_calibration, read_calibration
from clutch_model.units import bar_from_pa, pa_from_bar, rpm_from_rad_s
from clutchdiag_io.people import PLUS_MINUS, half_width, plus_minus
from clutchdiag_io.program import legible, replacement_refusal
from diag_service.commands.predict import slip_phases
from diag_service.console import ReadingLine, write_record
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.prediction import PRESSURES, Standing
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.mapping.learning import COMMANDS, LearnedVehicle, VehicleSurvey
from diag_service.mapping.vehicle_file import description_toml
from diag_service.service import calibrate_run
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.config import diagnosis_config
from diag_service.settings.proposed import asked_meaning

SCHEMA: Final = "clutchdiag/learn/v1"
BEHIND: Final = (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)


def learned_from(
    logs: Sequence[Path], meaning: Interpretation, *, stop: Trigger, columns: str = "", watch: Watch | None = None
) -> LearnedVehicle:
    """Return what logs tell of their vehicle; raises ConfigError if they lack the speeds for it, StoppedError."""
    signals = meaning.decoder().signals
    known = meaning.profile.gears
    over = known.over if known is not None else next((one for one in BEHIND if one in signals), None)
    if over is None or Signal.ENGINE_SPEED not in signals:
        raise ConfigError(
            "nothing can be learned without engine_speed_rad_s and output_speed_rad_s or vehicle_speed_m_s"
        )
    survey = VehicleSurvey(over)
    for log in logs:
        decoder = meaning.decoder()
        with closing(read_log(log, is_stopped=lambda: stop.is_set, watch=watch, columns=columns)) as reader:
            for batch in reader:
                if stop.is_set:
                    raise StoppedError("stopped early: nothing is learned from a part of a log")
                for one in decoder.stream(batch):
                    survey.add(one)
    learned = survey.learned()
    if (known is None and learned.ratios is None) or not {*PRESSURES.values()} <= signals:
        return learned
    meaning = meaning.with_gears(known or learned.ratios)
    phases = [one for log in logs for one in slip_phases(log, meaning, Standing(), stop, watch, columns)[0]]
    return survey.learned([one for one in phases if one.sign > 0.0 and one.is_powered])


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Learn a vehicle, and write and show its description."""
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    meaning = asked_meaning(options, lambda: controls.stop.is_set)
    assumed = nominal_calibration() if options.calibration is None else read_calibration(options.calibration)
    with ReadingLine() as line:
        learned = learned_from(
            options.logs, meaning, stop=controls.stop, columns=options.columns or "", watch=line.watch
        )
    write_description(options.output, learned, assumed, options.logs)
    last = f"description in {options.output}: what is assumed there, a drawing or a data sheet tells better"
    told = {**record(learned), "output": str(options.output)}
    write_record(told, (*said(learned), last), as_json=options.json)


def write_description(path: Path, learned: LearnedVehicle, assumed: Calibration, paths: Sequence[Path]) -> None:
    """Write a description whole or not at all; raises ConfigError if the disk does not take it."""
    logs = ", ".join(legible(one.name) for one in paths)
    remarks = (
        f"The vehicle of {logs}, for analyze --vehicle-file.",
        f'Behind each value is where it is from: the log, or assumed as of the type "{assumed.name}".',
        'Change what you know better, and write "given" behind it. [learned] is for reading: nothing uses it.',
        *said(learned),
    )
    with replacing(path, ConfigError) as part:
        part.write_text(description_toml(learned, assumed, f"learned from {logs}", remarks), encoding="utf-8")
        part.replace(path)


def said(learned: LearnedVehicle) -> Iterator[str]:
    """Yield what was learned and what was not, a line each."""
    yield f"{PLUS_MINUS}:"
    if not learned.gears:
        yield "gears: none was driven for long with its clutch closed"
    for gear, one in learned.gears.items():
        by = "the pressures do not tell its clutch" if one.clutch is None else f"clutch {one.clutch}"
        yield f"gear {gear}: ratio {one.ratio.ratio:.4g} ± {half_width(one.ratio.std, '{:.2g}')}, {by}"
    if learned.gears and not learned.are_named:
        yield "gears are numbered from the highest ratio that was driven: no signal names them"
    if learned.gears and learned.ratios is None:
        yield "a gear between them was not driven: complete [gears] by hand"
    if learned.is_swapped:
        yield "clutch 1 carries the even gears here: name the two pressures the other way round in the profile"
    for clutch in (1, 2):
        if (touch := learned.touch_point(clutch)) is not None:
            pressure = f"{plus_minus(bar_from_pa(touch.value), bar_from_pa(touch.std), '{:.2f}')} bar"
            yield f"clutch {clutch}: touch point {pressure} ({touch.origin})"
        else:
            yield f"clutch {clutch}: touch point not in the logs, assumed"
        yield f"clutch {clutch}: {_lag_said(learned, clutch)}"
        if (gain := learned.gain_rad_s2_pa.get(clutch)) is not None:
            change = plus_minus(rpm_from_rad_s(gain.value), rpm_from_rad_s(gain.std), "{:.3g}", scale=pa_from_bar(1.0))
            yield f"clutch {clutch}: engine speed changes by {change} rpm/s a bar ({gain.origin})"


def _lag_said(learned: LearnedVehicle, clutch: int) -> str:
    if (lag := learned.lag_s.get(clutch)) is not None:
        return f"pressure {plus_minus(lag.value, lag.std, '{:.0f}', scale=1e3)} ms behind its command"
    if COMMANDS[clutch - 1] in learned.rates_hz:
        return "lag of the pressure not told: its command moves too little, or not as the pressure does"
    return "lag of the pressure not told: the profile names no commanded pressure"


def record(learned: LearnedVehicle) -> dict[str, object]:
    clutches = {
        name: {str(clutch): {"value": one.value, "std": one.std, "origin": one.origin} for clutch, one in found.items()}
        for name, found in (
            ("touch_pressure_pa", learned.touch_pa),
            ("pressure_lag_s", learned.lag_s),
            ("gain_rad_s2_pa", learned.gain_rad_s2_pa),
        )
    }
    return {
        "schema": SCHEMA,
        "over": learned.over.value,
        "gears": {str(gear): {**one.ratio._asdict(), "clutch": one.clutch} for gear, one in learned.gears.items()},
        "gears_are_named": learned.are_named,
        **clutches,
        "rates_hz": {one.value: rate for one, rate in learned.rates_hz.items()},
    }


def calibrate(options: SimpleNamespace, controls: Controls) -> None:
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    config = diagnosis_config(options)
    calibrate_run.run_calibrate(config, options.logs, options.output, controls.stop, as_json=options.json)
