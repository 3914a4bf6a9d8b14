"""What the emulator's commands do, once arguments are read and signals are in hand; live sending is in ``live``."""

import os
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Event
from typing import Any

from clutch_model.units import NS_PER_S, k_from_degc
from clutchdiag_io.command_line import STANDARD_STREAM
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.files import until_whole
from clutchdiag_io.program import refusal
from dbc.contract import dbc_path
from ecu_emulator.drive.recording import LONG_STRETCH_S, Drive
from ecu_emulator.errors import EmulatorConfigError, EmulatorStoppedError, RecordError
from ecu_emulator.log_formats import DEFAULT_START_NS, RecordFormat, open_log
from ecu_emulator.progress import driven_text, people, print_json
from ecu_emulator.scenario import MASS_RANGE_KG, MOST_PARKED_S, OIL_RANGE_DEGC, DriveName
from ecu_emulator.scenario.faults import CauseKind, CheckedRecord, Degradation, ranged
from ecu_emulator.scenario.scenario import Ambient, FluidCondition, Scenario, WorkshopRoutine
from ecu_emulator.scenario.scenario_file import load_scenario, shipped_scenarios
from ecu_emulator.truth import Totals, TruthWriter, truth_path


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions(CheckedRecord):
    """What is driven: a scenario, and what of it is overridden; ``None`` is as the scenario has it."""

    scenario: str | Scenario  # its name or file, unless it is one
    fluid: str | None = None
    cause: str | None = None  # faults of the car: NAME:STRENGTH:CLUTCH, commas between them
    seed: int | None = None
    vehicle_seed: int | None = None
    drive_seed: int | None = None
    drive: str | None = None
    cycles: int | None = None
    is_endless: bool = False
    oil_degc: float | None = ranged(None, *OIL_RANGE_DEGC)  # coolant and air are at most as warm: the car has stood
    mass_kg: float | None = ranged(None, *MASS_RANGE_KG)
    odometer_m: float | None = None
    routine: tuple[int, int] | None = None  # revs with open and with closed clutches
    is_in_workshop: bool = False  # the car waits for a tester to start the routine


@dataclass(frozen=True, slots=True, kw_only=True)
class LogOptions:
    """Which log is written, and how."""

    path: Path
    log_format: str | None = None  # None: as the suffix says
    start_ns: int = DEFAULT_START_NS
    channel: str = "vcan0"
    truth: Path | None = None  # None: beside the log
    longest_stay_s: float = MOST_PARKED_S


def ns_of(instant: datetime) -> int:
    """Return nanoseconds since the epoch, whole microseconds; UTC unless it has a zone."""
    aware = instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
    return int(aware.replace(microsecond=0).timestamp()) * NS_PER_S + aware.microsecond * 1000


def choose_scenario(options: DriveOptions) -> Scenario:
    """Return the scenario with what is overridden; raises ConfigError if it or an override cannot be used."""
    scenario = options.scenario if isinstance(options.scenario, Scenario) else load_scenario(options.scenario)
    overrides: dict[str, Any] = {
        name: value
        for name in ("seed", "vehicle_seed", "drive_seed", "cycles", "odometer_m")
        if (value := getattr(options, name)) is not None
    }
    if options.fluid is not None:
        overrides["fluid"] = replace(scenario.fluid, condition=FluidCondition(options.fluid))
    if options.cause is not None:
        overrides["causes"] = (*scenario.causes, *(_cause(text.strip()) for text in options.cause.split(",")))
    if options.drive is not None:
        overrides["drive"] = DriveName(options.drive)
    if options.oil_degc is not None:
        oil_k = float(k_from_degc(options.oil_degc))
        overrides["ambient"] = Ambient(
            temperature_k=min(scenario.ambient.temperature_k, oil_k),
            oil_temperature_k=oil_k,
            coolant_temperature_k=min(scenario.ambient.coolant_temperature_k, oil_k),
        )
    if options.mass_kg is not None:
        plant = {**scenario.truth.plant, "vehicle.mass_kg": options.mass_kg}
        overrides["truth"] = replace(scenario.truth, plant=plant)
    scenario = replace(scenario, endless=scenario.endless or options.is_endless, **overrides)
    if options.routine is not None:
        scenario = replace(
            scenario, routine=WorkshopRoutine(open_revs=options.routine[0], closed_revs=options.routine[1])
        )
    if options.is_in_workshop:
        scenario = replace(scenario, routine=replace(scenario.routine, on_request=True))
    return scenario


def _cause(text: str) -> Degradation:
    """Return a cause from NAME, NAME:STRENGTH or NAME:STRENGTH:CLUTCH; raises ConfigError."""
    kind, strength, clutch, *more = [*text.split(":"), "", ""]
    if any(more) or kind not in list(CauseKind):
        raise EmulatorConfigError(f"no cause {text!r}: NAME[:STRENGTH[:CLUTCH]], NAME one of {', '.join(CauseKind)}")
    try:
        return Degradation(kind=CauseKind(kind), strength=float(strength or 1.0), clutch=int(clutch or 0))
    except ValueError as exc:
        raise EmulatorConfigError(f"no cause {text!r}: strength and clutch must be numbers") from exc


def list_scenarios() -> None:
    PeopleConsole().print_all(f"{name:<12} {load_scenario(name).description}" for name in shipped_scenarios())


def save_dbc(path: Path | None, *, is_forced: bool, transmission: str = "nominal") -> int:
    """Write the database of the vehicle with a transmission, to standard output without a path; return its size.

    Raises ConfigError or RecordError if the file is there already or cannot be written.
    """
    database = dbc_path(transmission).read_bytes()
    if path is None:
        return sys.stdout.buffer.write(database)
    if text := refusal(path, is_forced=is_forced):
        raise EmulatorConfigError(text)
    try:
        with until_whole(path) as place:
            return place.write_bytes(database)
    except OSError as exc:
        raise RecordError(f"cannot write {path}: {exc.strerror or exc}") from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A drive in a log; with its seeds the same drive can be recorded again."""

    path: Path  # the log
    truth: Path  # the truth about it; the null device if there is none
    is_finished: bool  # whether it was driven to its end
    endless_shift: str  # what there is to say of a shift that did not end; empty: there was none
    totals: Totals
    took_s: float  # how long it took to make
    vehicle_seed: int
    drive_seed: int

    @property
    def speed_ratio(self) -> float:
        """Time of driving over the time it took to make."""
        return self.totals.driven_s / self.took_s

    def to_record(self) -> dict[str, object]:
        """Return what ``--json`` prints."""
        return {
            "file": str(self.path),
            "truth": str(self.truth),
            "finished": self.is_finished,
            "frames": self.totals.frames,
            "shifts": self.totals.shifts,
            "events": self.totals.events,
            "duration_s": self.totals.duration_s,
            "odometer_m": self.totals.odometer_m,
            "speed_ratio": round(self.speed_ratio, 2),
            "vehicle_seed": self.vehicle_seed,
            "drive_seed": self.drive_seed,
        }


def write_log(
    scenario: Scenario,
    options: LogOptions,
    stop: Event,
    show: Callable[[Totals], None] = lambda _: None,
) -> Recording:
    """Write a drive to a log, or to standard output, and the truth beside it; a request to stop ends both in order.

    Standard output has no truth beside it unless ``truth`` names a file.

    ``show`` is called now and then with what has been driven.

    Raises ConfigError, RecordError if the scenario waits for a tester or its truth is not possible, or a file cannot be
    written.
    """
    if scenario.routine.on_request:
        raise EmulatorConfigError("a log has no tester who would start the routine: give the number of revs instead")
    path = options.path
    truth_file = options.truth or (Path(os.devnull) if path == STANDARD_STREAM else truth_path(path))
    if truth_file.absolute() == path.absolute():
        raise EmulatorConfigError(f"log and truth cannot both be {path}")
    log_format = RecordFormat(options.log_format) if options.log_format else None
    drive = Drive(scenario, options.longest_stay_s)
    began_s = time.perf_counter()
    with (  # nobody needs the truth of a log that is not there, nor loses that of the one before
        nullcontext(truth_file) if path == STANDARD_STREAM else until_whole(truth_file) as place,
        open_log(path, log_format=log_format, start_ns=options.start_ns, channel=options.channel) as log,
        TruthWriter(truth_file, place=place) as writer,
    ):
        writer.write(drive.truth)
        has_driven = False
        try:
            for stretch in drive.stretches(LONG_STRETCH_S):
                log.write(stretch.frames)
                writer.write(*stretch.truths)
                has_driven = True
                show(drive.totals)
                if stop.is_set():
                    break
        except EmulatorStoppedError:  # while kernels were compiled that the drive had not needed before
            if not has_driven:
                raise
        writer.write(drive.totals)
    return Recording(
        path=path,
        truth=truth_file,
        is_finished=drive.finished and not drive.endless_shift,
        endless_shift=drive.endless_shift,
        totals=drive.totals,
        took_s=time.perf_counter() - began_s,
        vehicle_seed=scenario.seed_of_vehicle,
        drive_seed=scenario.seed_of_drive,
    )


def record(scenario: Scenario, options: LogOptions, stop: Event, *, is_json: bool, is_forced: bool = False) -> bool:
    """Write a drive to a log and say what it holds; return whether it is the whole drive.

    Raises what ``write_log`` raises.

    Raises ConfigError, too, if a file is there already, or results would get among the frames on standard output.
    """
    path, truth = options.path, options.truth
    is_piped = path == STANDARD_STREAM
    if is_piped and is_json:
        raise EmulatorConfigError("the log goes to standard output: --json cannot be used")
    outputs = (truth,) if is_piped else (path, truth or truth_path(path))
    if text := refusal(*outputs, is_forced=is_forced):
        raise EmulatorConfigError(text)
    console = people()
    with console.status("preparing the plant") as status:
        recording = write_log(
            scenario,
            options,
            stop,
            lambda so_far: status.update(driven_text(so_far.driven_s, so_far.shifts, so_far.events)),
        )
    totals = recording.totals
    state = (
        "" if recording.is_finished else f"stopped early: {recording.endless_shift and recording.endless_shift + '; '}"
    )
    name, beside = ("standard output", truth) if is_piped else (path, recording.truth)
    console.print(
        f"{state}{name}: {totals.frames} frames, {totals.shifts} shifts, {totals.driven_s:.1f} s of driving "
        f"in {recording.took_s:.1f} s{f'; truth in {beside}' if beside else ''}",
        markup=False,
    )
    if is_json:
        print_json(recording.to_record())
    return recording.is_finished
