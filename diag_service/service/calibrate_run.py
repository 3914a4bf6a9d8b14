"""Self-calibration of one vehicle from recorded drives: what was found, and a calibration file of its own."""

import io
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Final

from canlog.errors import SourceError
from canlog.files import replacing
from clutch_model.calibration import Calibration, TorqueSource, calibration_toml
from clutch_model.units import NS_PER_S, bar_from_pa
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole, plain_table
from clutchdiag_io.people import PLUS_MINUS, half_width, plus_minus
from diag_service.console import ReadingLine
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.evidence import NUISANCE_NAMES, STATE_COUNT, Considered, State, prior_covariance
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.self_calibration import SelfCalibration, self_calibrate
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.diagnosis.summary import GAP_TEXT, Gap
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.decoder import Decoder
from diag_service.service.drive import DriveFrames, OpenLog, gaps_in, open_drive, warn_of_faults
from diag_service.service.stopping import Trigger
from diag_service.settings.config import UNNAMED_VEHICLE, DiagnosisConfig
from diag_service.settings.proposed import as_proposed
from fleet_contract import JsonObject

CALIBRATION_SCHEMA = "clutchdiag/self-calibration/v1"


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationEvents:
    """What drives hold for a self-calibration, in order of time."""

    shifts: tuple[Event, ...]
    run_ups: tuple[Event, ...]
    gaps: tuple[Gap, ...] = ()  # why the drives are not all there

    @property
    def last_day(self) -> date:
        """Day of the last event [UTC], from bus time."""
        last_ns = max([*(shift.end_ns for shift in self.shifts), *(run_up.end_ns for run_up in self.run_ups)])
        return datetime.fromtimestamp(last_ns / NS_PER_S, UTC).date()


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


def find_events(
    logs: Sequence[OpenLog], decoder: Decoder, calibration: Calibration, stop: Trigger
) -> CalibrationEvents:
    """Return the shifts and engine revs of some drives.

    Raises SourceError if there is no shift. Raises StoppedError if the search was stopped.
    """
    shift_finder, run_up_finder = ShiftFinder(), RunUpFinder(calibration)
    shifts: list[Event] = []
    run_ups: list[Event] = []
    drive = DriveFrames(logs, decoder.sources)
    for columns in decoder.whole(drive):
        _go_on(stop)
        shifts += shift_finder.feed(columns)
        run_ups += run_up_finder.feed(columns)
    shifts += shift_finder.flush()
    run_ups += run_up_finder.flush()
    warn_of_faults(logs, drive.contributions(decoder.named_channel))
    if not shifts:
        raise SourceError("no shift in these logs: nothing to calibrate from")
    shifts, run_ups = decoder.marked(shifts), decoder.marked(run_ups)
    return CalibrationEvents(shifts=tuple(shifts), run_ups=tuple(run_ups), gaps=gaps_in(logs, was_stopped=False))


def _go_on(stop: Trigger) -> None:
    if stop.is_set:
        raise StoppedError("stopped early: nothing was calibrated, no file was written")


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCalibration:
    """What the drives of a vehicle told about it, and from what they started."""

    self_calibration: SelfCalibration
    start: Calibration
    vehicle: str
    gaps: tuple[Gap, ...]  # why the drives are not all there


def calibrated(
    config: DiagnosisConfig, logs: Sequence[Path], stop: Trigger, line: ReadingLine | None = None
) -> FoundCalibration:
    """Return what the logs of a vehicle say about it; the line tells how far that is, where there is one.

    Raises ConfigError if the drives do not suffice, StoppedError if it was stopped.
    """
    config = as_proposed(config, logs, lambda: stop.is_set)
    start = config.calibration
    if start.torque is not TorqueSource.MEASURED:
        raise ConfigError("no self-calibration: without measured engine torque nothing tells the scale of friction")
    if start.converter is not None:
        raise ConfigError("no self-calibration: a lock-up clutch needs none, each run learns more of its converter")
    with (
        line or ReadingLine(io.StringIO()) as shown,
        open_drive(logs, is_stopped=lambda: stop.is_set, watch=shown.watch, columns=config.columns) as drive,
    ):
        events = find_events(drive, config.interpretation().decoder(), start, stop)
        shown.show(f"calibrating from {len(events.shifts)} shifts and {len(events.run_ups)} revs in neutral")
        version = f"{start.version}-{config.vehicle}-{events.last_day.isoformat()}"
        outcome = self_calibrate(events.shifts, events.run_ups, start, version)
    if isinstance(outcome, str):
        raise ConfigError(f"no self-calibration: {outcome}")
    owner = None if config.vehicle == UNNAMED_VEHICLE else config.vehicle
    calibration = replace(outcome.calibration, made_on=events.last_day, vehicle=owner)
    _go_on(stop)
    return FoundCalibration(
        self_calibration=replace(outcome, calibration=calibration),
        start=start,
        vehicle=config.vehicle,
        gaps=events.gaps,
    )


def run_calibrate(config: DiagnosisConfig, logs: Sequence[Path], path: Path, stop: Trigger, *, as_json: bool) -> None:
    """Calibrate a vehicle from its logs, write its own calibration file and show what was found.

    Raises ConfigError if the drives do not suffice, or the file cannot be written. Raises StoppedError if it was
    stopped before the file was written.
    """
    outcome = calibrated(config, logs, stop, ReadingLine())
    write_calibration(path, outcome.self_calibration.calibration)
    if as_json:
        sys.stdout.write(dump(record(outcome)) + "\n")
    else:
        show(outcome, path, PeopleConsole())


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration file whole or not at all; raises ConfigError if the disk does not take it."""
    with replacing(path, ConfigError) as part:
        part.write_text(calibration_toml(calibration), encoding="utf-8")
        part.replace(path)


def show(outcome: FoundCalibration, path: Path, console: PeopleConsole) -> None:
    for gap in outcome.gaps:
        console.print(f"{GAP_TEXT[gap]}: calibrated from what there is", style="bold red")
    table = plain_table(("parameter", "found", "±", "± before", ""), {"parameter", ""}, PLUS_MINUS)
    for name, value, std, before in _rows(outcome):
        label, unit, factor = _UNITS[name]
        cells = (half_width(number, "{:.3g}", scale=factor) for number in (std, before))
        table.add_row(label, f"{factor * value:+.3g}", *cells, unit)
    console.print(table)
    console.print_all(_lines(outcome.self_calibration, path))


def _lines(calibration: SelfCalibration, path: Path) -> Iterator[str]:
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


def record(outcome: FoundCalibration) -> JsonObject:
    """Return what was found, for machines; SI units."""
    calibration = outcome.self_calibration
    frictions = {clutch: friction_of(calibration.state, clutch) for clutch in (1, 2)}
    return {
        "schema": CALIBRATION_SCHEMA,
        "vehicle": outcome.vehicle,
        "complete": not outcome.gaps,
        "incomplete": [gap.value for gap in outcome.gaps],
        "calibration_version": calibration.calibration.version,
        "parameters": {
            name: {"value": value, "std": std, "std_before": before} for name, value, std, before in _rows(outcome)
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


def _rows(outcome: FoundCalibration) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, value, std and the type's std of each parameter; ratios and states as they are kept."""
    calibration, start = outcome.self_calibration, outcome.start
    before = prior_covariance(start).diagonal() ** 0.5
    for row, name in enumerate((*State, *Considered)):
        key = name.name.lower()
        if key not in NUISANCE_NAMES:
            continue
        value = float(calibration.mean[row])
        if row >= STATE_COUNT and name is Considered.TORQUE_LATENCY:
            value += start.bias.torque_latency_s
        if row >= STATE_COUNT and name is Considered.PRESSURE_LATENCY:
            value += start.bias.pressure_latency_s
        yield key, value, calibration.std(key), float(before[row])
