"""Self-calibration of one vehicle from recorded drives: ``calibrate``, and what it finds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from typing import Unpack

from canlog.errors import SourceError
from clutch_model.calibration import Calibration, TorqueSource, calibration_toml
from clutch_model.units import NS_PER_S
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, named, optional_path, path_list
from diag_service.console import SILENT, ReadingLine, collected_notices
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.evidence import NUISANCE_NAMES, STATE_COUNT, Considered, State, prior_covariance
from diag_service.diagnosis.friction.self_calibration import SelfCalibration, self_calibrate
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.diagnosis.summary import Gap
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.decoder import Decoder
from diag_service.service.drive import DriveFrames, OpenLog, gaps_in, open_drive, warn_of_faults
from diag_service.settings.config import UNNAMED_VEHICLE, write_text
from diag_service.settings.options import LearnOptions, as_proposed, check_replaceable, diagnosis_config
from diag_service.stopping import Controls, Trigger


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationEvents:
    """Events of some drives for a self-calibration, in order of time."""

    shifts: tuple[Event, ...]
    run_ups: tuple[Event, ...]
    gaps: tuple[Gap, ...] = ()  # why the drives are not all there

    @property
    def last_day(self) -> date:
        """Day of the last event [UTC], from bus time."""
        last_ns = max([*(shift.end_ns for shift in self.shifts), *(run_up.end_ns for run_up in self.run_ups)])
        return datetime.fromtimestamp(last_ns / NS_PER_S, UTC).date()


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

    def parameters(self) -> Iterator[tuple[str, float, float, float]]:
        """Yield name, value, std and the type's std of each parameter; ratios and states as they are kept."""
        calibration, start = self.self_calibration, self.start
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


def calibrate(paths: AnyPaths, *, output: AnyPath | None = None, **meaning: Unpack[LogMeaning]) -> SelfCalibration:
    """Find one vehicle's sensor errors and inertia from its logs, as ``diag-service calibrate`` does.

    Parameters
    ----------
    output
        TOML file to write.
    paths, vehicle, dbc, profile, calibration, columns
        As of ``analyze``; the logs may be of several drives of the one vehicle.

    Returns
    -------
    SelfCalibration
        ``.calibration`` is what ``analyze(calibration=...)`` takes; ``.std(name)`` is how sure each parameter is.

    Raises
    ------
    ConfigError, DefinitionError, CalibrationError
        If an argument cannot be used, the drives do not suffice, or the file cannot be written.
    SourceError
        If a log cannot be read, or there is no shift in them.
    """
    options = LearnOptions(logs=path_list(paths), output=optional_path(output), force=True, **named(meaning))
    with collected_notices():
        return calibrate_vehicle(options, Controls()).self_calibration


def calibrate_vehicle(options: LearnOptions, controls: Controls, line: ReadingLine = SILENT) -> FoundCalibration:
    """Return what logs say of their vehicle, and write its calibration if a file is named; raises as ``calibrate``."""
    stop = controls.stop
    if options.output is not None:
        check_replaceable(options.output, is_forced=options.force)
    config = as_proposed(diagnosis_config(options), options.logs, lambda: stop.is_set)
    start = config.calibration
    if start.torque is not TorqueSource.MEASURED:
        raise ConfigError("no self-calibration: without measured engine torque nothing tells the scale of friction")
    if start.converter is not None:
        raise ConfigError("no self-calibration: a lock-up clutch needs none, each run learns more of its converter")
    with open_drive(options.logs, is_stopped=lambda: stop.is_set, watch=line.watch, columns=config.columns) as drive:
        events = find_events(drive, config.interpretation().decoder(), start, stop)
        line.show(f"calibrating from {len(events.shifts)} shifts and {len(events.run_ups)} revs in neutral")
        version = f"{start.version}-{config.vehicle}-{events.last_day.isoformat()}"
        outcome = self_calibrate(events.shifts, events.run_ups, start, version)
    if isinstance(outcome, str):
        raise ConfigError(f"no self-calibration: {outcome}")
    owner = None if config.vehicle == UNNAMED_VEHICLE else config.vehicle
    calibration = replace(outcome.calibration, made_on=events.last_day, vehicle=owner)
    _go_on(stop)
    if options.output is not None:
        write_text(options.output, calibration_toml(calibration))
    return FoundCalibration(
        self_calibration=replace(outcome, calibration=calibration),
        start=start,
        vehicle=config.vehicle,
        gaps=events.gaps,
    )
