"""What studies build: a service that has met no vehicle, drives in memory, results, tables as a scan tool writes."""

import tempfile
from contextlib import redirect_stderr
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.frames import FrameBatch
from clutch_model.calibration import Calibration, nominal_calibration
from clutch_model.units import k_from_degc
from clutch_results.records import ShiftResult
from dbc.contract import load_contract
from diag_service import analyze
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.driving.journey import PlannedTrip, trips
from ecu_emulator.driving.traffic import public_trace
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import Ambient, FluidCondition, Scenario
from ecu_emulator.truth import TruthLog
from studies.scan_tool import TableOptions, write_table

EPOCH_US: Final = 1_767_225_600_000_000  # any bus time: 2026-01-01 UTC
STRETCH_S: Final = 60.0  # of a drive at a time
CITY_SEED: Final = 77
FLUIDS: Final = (FluidCondition.IDEAL, FluidCondition.CASE_1, FluidCondition.CASE_2)
TRACES: Final = ("wltc", "udds", "hwfet", "us06", "city")
OF_FRICTION: Final = frozenset({"Clutch Hub Speed", "Oil Temperature"})
OUTPUT: Final = OF_FRICTION | {"Output Shaft Speed"}  # what a tool need not ask that knows the input shafts
TYPICAL_NM, TYPICAL_RAD_S, IDLE_RAD_S, PULSE_STEP_MS = 150.0, 200.0, 60.0, 0.02


def to_batch(frames: EncodedFrames) -> FrameBatch:
    """Return emulated frames as a receiver with microsecond time stamps sees them."""
    return FrameBatch(
        t_ns=(EPOCH_US + np.rint(frames.t_s * 1e6).astype(np.int64)) * 1000,
        can_id=frames.can_id.astype(np.uint32),
        length=frames.length.astype(np.uint8),
        data=frames.data,
    )


def new_decoder() -> Decoder:
    """Return a decoder of the project's own messages."""
    return Decoder(load_contract(), load_profile())


def new_stages(calibration: Calibration | None = None) -> Stages:
    """Return a service that has never met the vehicle."""
    calibration = calibration or nominal_calibration()
    return Stages(new_decoder(), calibration)


def diagnose(scenario: Scenario, calibration: Calibration | None = None) -> tuple[list[Diagnosis], TruthLog]:
    """Drive a scenario in memory, frames and decoding included, and return what the service makes of its shifts."""
    frames, truth = frames_of(scenario)
    return new_stages(calibration).feed(to_batch(frames)), truth


def planned(trace: str) -> PlannedTrip:
    """Return the trip along a public trace, or in traffic of a city."""
    if trace == DriveName.CITY:
        return next(trips(DriveName.CITY, CITY_SEED))
    return PlannedTrip(trace=public_trace(trace), parked_s=0.0)


def in_oil(scenario: Scenario, oil_degc: float) -> Scenario:
    """Return the scenario with oil and coolant of one temperature at the start, and air of 20 degC at most."""
    oil_k = k_from_degc(oil_degc)
    ambient = Ambient(temperature_k=min(oil_k, 293.15), oil_temperature_k=oil_k, coolant_temperature_k=oil_k)
    return replace(scenario, ambient=ambient)


@cache
def _results() -> tuple[ShiftResult, ...]:
    """Return the results of one recorded shift cycle."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "drive.log"
        with redirect_stderr(StringIO()):
            emulator(["record", str(log), "--cycles", "1"])
        return tuple(analyze(log).results)


def shift_result(seq: int = 1, *, vehicle: str = "car1", stream: str | None = None) -> ShiftResult:
    """Return the result at a position of a stream: the shifts of a recorded cycle in turns, their courses left out."""
    result = _results()[seq % len(_results())]
    estimate = replace(result.estimate, number=seq, shift_quality=None)
    return replace(result, vehicle=vehicle, stream=stream or result.stream, seq=seq, estimate=estimate)


def written(log: Path, table: Path, rng: np.random.Generator, **how: Any) -> None:  # noqa: ANN401 - of all kinds
    """Write a table of a log without what a tool need not ask; how else is said by `TableOptions`."""
    write_table(log, TableOptions(**{"path": table, "left_out": OUTPUT, **how}), rng)


def with_fuel(table: Path, rng: np.random.Generator) -> None:
    """Put the injected fuel in place of the torque of a table, as engines of one type differ in it.

    Fuel goes with the torque and what the engine itself loses, along a curve; torque follows it after a while.
    """
    head, *rows = table.read_text(encoding="utf-8").splitlines()
    names = head.split(",")
    cells = np.array([row.split(",") for row in rows], np.float64)
    place, speed_rad_s = names.index("Engine Torque [Nm]"), cells[:, names.index("Engine Speed [rpm]")] * np.pi / 30.0
    whole_nm = np.maximum(cells[:, place] + rng.uniform(10.0, 22.0) + rng.uniform(0.06, 0.14) * speed_rad_s, 0.0)
    bent = (whole_nm / TYPICAL_NM) ** rng.uniform(0.92, 1.08)
    bent *= (np.maximum(speed_rad_s, IDLE_RAD_S) / TYPICAL_RAD_S) ** rng.uniform(-0.06, 0.06)
    lag_s, pulse_ms = rng.uniform(0.0, 0.04), rng.uniform(2.0, 5.0) * bent
    for row, step_s in enumerate(np.diff(cells[:, 0]) / 1e3, start=1):
        pulse_ms[row] = pulse_ms[row - 1] + (pulse_ms[row] - pulse_ms[row - 1]) * (1.0 - np.exp(-step_s / lag_s))
    names[place] = "Injector Pulsewidth [ms]"
    cells[:, place] = np.round(pulse_ms / PULSE_STEP_MS) * PULSE_STEP_MS
    lines = [",".join(names), *(",".join(f"{cell:.15g}" for cell in row) for row in cells.tolist()), ""]
    table.write_text("\n".join(lines), encoding="utf-8")
