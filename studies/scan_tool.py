"""A table of signals beside a log, as a scan tool writes it: few rows, uneven, columns apart within a row."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

import canlog
from canlog.arrays import FloatArray, Int64Array
from canlog.errors import CanlogError
from clutchdiag_io.files import until_whole
from dbc.contract import load_contract
from ecu_emulator.errors import EmulatorConfigError, RecordError

PRESSURE_STEP_KPA: Final = 5.86
KPA_PER_BAR: Final = 100.0
NS_PER_S: Final = 1e9
SETTLED_S: Final = 0.2  # behind the first frame: until then sensors tell that they have no value yet
ENDING_S: Final = 1.0  # before the last frame: no column is asked for what comes later
LEAST_ROWS: Final = 3
COLUMNS: Final[Mapping[str, tuple[str, str, float]]] = {  # column: signal, unit, step
    "Engine Speed": ("ECM_TorqueSpeed.EngineSpeed", "rpm", 1.0),
    "Engine Torque": ("ECM_TorqueSpeed.EngineTorque", "Nm", 1.0),
    "Accelerator Pedal": ("ECM_TorqueSpeed.Pedal", "%", 0.5),
    "Clutch 1 Pressure": ("TCU_Pressures.Clutch1Pressure", "kPa", PRESSURE_STEP_KPA),
    "Clutch 2 Pressure": ("TCU_Pressures.Clutch2Pressure", "kPa", PRESSURE_STEP_KPA),
    "Input Shaft 1 Speed": ("TCU_InputSpeeds.InputShaft1Speed", "rpm", 1.0),
    "Input Shaft 2 Speed": ("TCU_InputSpeeds.InputShaft2Speed", "rpm", 1.0),
    "Current Gear": ("TCU_Shift.CurrentGear", "", 1.0),
    "Target Gear": ("TCU_Shift.TargetGear", "", 1.0),
    "Output Shaft Speed": ("TCU_Output.OutputSpeed", "rpm", 0.25),
    "Clutch Hub Speed": ("TCU_InputSpeeds.ClutchHubSpeed", "rpm", 0.25),
    "Oil Temperature": ("TCU_Temperature.SumpOilTemperature", "degC", 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """Which table is written, and how.

    Attributes
    ----------
    rate_hz, jitter_s
        Of the rows; the jitter is a standard deviation, and the times of the rows tell it.
    skew_ratio
        By how much of a row's period columns are asked one after the other.
    held_rows
        For so many rows a column keeps its value before it is refreshed; each column at rows of its own.
    pressure_step_kpa
        Resolution of pressures.
    left_out
        Columns that the tool does not have.
    """

    path: Path
    rate_hz: float = 27.0
    jitter_s: float = 0.01
    skew_ratio: float = 1.0
    held_rows: int = 1
    pressure_step_kpa: float = PRESSURE_STEP_KPA
    left_out: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if unknown := self.left_out - COLUMNS.keys():
            raise EmulatorConfigError(f"the table has no column {min(unknown)!r}: there are {', '.join(COLUMNS)}")
        if self.left_out >= COLUMNS.keys():
            raise EmulatorConfigError("a table without columns tells nothing")


def write_table(
    log: Path, options: TableOptions, seed: int | np.random.Generator, transmission: str = "nominal"
) -> int:
    """Write a table of a log, and return how many rows it has; the same seed makes the same table.

    Raises
    ------
    RecordError
        If the log is too short, cannot be read, or the table cannot be written.
    """
    rng = np.random.default_rng(seed)
    try:
        signals = canlog.read([log], load_contract(transmission)).signals()
    except CanlogError as exc:
        raise RecordError(f"{log} cannot be made a table: {exc}") from exc
    names = [name for name in COLUMNS if name not in options.left_out]
    found = {name: signals[COLUMNS[name][0]] for name in names if COLUMNS[name][0] in signals}
    rows_s = _rows_s([one.t_ns for one in found.values()], options, rng)
    if len(rows_s) < LEAST_ROWS:
        raise RecordError(f"{log} is too short for a table of signals")
    cells = []
    for place, name in enumerate(found):
        rows = np.arange(len(rows_s))
        refreshed = np.maximum(rows - (rows + place) % options.held_rows, 0)
        asked_s = rows_s[refreshed] + options.skew_ratio / options.rate_hz * place / len(found)
        series, (_, unit, step) = found[name], COLUMNS[name]
        values = series.value[np.searchsorted(series.t_ns / NS_PER_S, asked_s, side="right") - 1]
        if unit == "kPa":
            values, step = values * KPA_PER_BAR, options.pressure_step_kpa
        cells.append(np.round(np.round(values / step) * step, 3))
    heads = [f"{name} [{unit}]" if (unit := COLUMNS[name][1]) else name for name in found]
    times, values = np.round(1e3 * rows_s).astype(np.int64).tolist(), np.column_stack(cells).tolist()
    rows_of_cells = ([t, *row] for t, row in zip(times, values, strict=True))
    lines = [",".join(["Time [ms]", *heads]), *(",".join(map(str, row)) for row in rows_of_cells), ""]
    try:
        with until_whole(options.path) as file:
            file.write_text("\n".join(lines), encoding="utf-8")
    except OSError as exc:
        raise RecordError(f"cannot write {options.path}: {exc.strerror or exc}") from exc
    return len(rows_s)


def _rows_s(times_ns: list[Int64Array], options: TableOptions, rng: np.random.Generator) -> FloatArray:
    """Return the times of rows [s] at which all columns have been sent and go on."""
    if not times_ns or not all(map(len, times_ns)):
        return np.empty(0)
    first_s = max(int(one[0]) for one in times_ns) / NS_PER_S + SETTLED_S
    last_s = min(int(one[-1]) for one in times_ns) / NS_PER_S - ENDING_S
    rows_s = np.arange(first_s, last_s, 1.0 / options.rate_hz)
    rows_s = np.sort(rows_s + rng.normal(0.0, options.jitter_s, len(rows_s)))
    return rows_s[rows_s > first_s - SETTLED_S]  # before it some column has no value at all
