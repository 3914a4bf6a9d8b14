"""Tables of signals as scan tools write them: few rows, uneven, columns apart; or each channel at its own rate."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

import canlog
from canlog.arrays import FloatArray, Int64Array, Series
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal

PRESSURE_STEP_KPA: Final = 5.86
KPA_PER_BAR: Final = 100.0
NS_PER_S: Final = 1e9
SETTLED_S: Final = 0.2  # behind the first frame: until then sensors tell that they have no value yet
ENDING_S: Final = 1.0  # before the last frame: no column is asked for what comes later
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
    left_out
        Columns that the tool does not have.
    """

    path: Path
    rate_hz: float = 27.0
    jitter_s: float = 0.01
    skew_ratio: float = 1.0
    left_out: frozenset[str] = frozenset()


def write_table(log: Path, options: TableOptions, seed: int | np.random.Generator) -> None:
    """Write a table of a log; the same seed makes the same table."""
    rng = np.random.default_rng(seed)
    signals = canlog.read([log], load_contract()).signals()
    names = [name for name in COLUMNS if name not in options.left_out]
    found = {name: signals[COLUMNS[name][0]] for name in names if COLUMNS[name][0] in signals}
    rows_s = _rows_s([one.t_ns for one in found.values()], options, rng)
    cells = []
    for place, name in enumerate(found):
        asked_s = rows_s + options.skew_ratio / options.rate_hz * place / len(found)
        series, (_, unit, step) = found[name], COLUMNS[name]
        values = series.value[np.searchsorted(series.t_ns / NS_PER_S, asked_s, side="right") - 1]
        if unit == "kPa":
            values = values * KPA_PER_BAR
        cells.append(np.round(np.round(values / step) * step, 3))
    heads = [f"{name} [{unit}]" if (unit := COLUMNS[name][1]) else name for name in found]
    times, values = np.round(1e3 * rows_s).astype(np.int64).tolist(), np.column_stack(cells).tolist()
    lines = [",".join(["Time [ms]", *heads])]
    lines += [",".join(map(str, [t_ms, *row])) for t_ms, row in zip(times, values, strict=True)]
    options.path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _rows_s(times_ns: list[Int64Array], options: TableOptions, rng: np.random.Generator) -> FloatArray:
    """Return the times of rows [s] at which all columns have been sent and go on."""
    first_s = max(int(one[0]) for one in times_ns) / NS_PER_S + SETTLED_S
    last_s = min(int(one[-1]) for one in times_ns) / NS_PER_S - ENDING_S
    rows_s = np.arange(first_s, last_s, 1.0 / options.rate_hz)
    rows_s = np.sort(rows_s + rng.normal(0.0, options.jitter_s, len(rows_s)))
    return rows_s[rows_s > first_s - SETTLED_S]  # before it some column has no value at all


RPM: Final = np.pi / 30.0
AUTOMATIC: Final[Mapping[Signal, tuple[float, float]]] = {  # of each channel: period [s], and steps of its values [SI]
    **dict.fromkeys((Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP, Signal.LOCKUP_SLIP_COMMAND), (0.03, 0.125 * RPM)),
    Signal.LOCKUP_PRESSURE_COMMAND: (0.03, 62.5),
    Signal.ENGINE_TORQUE: (0.03, 0.5),
    Signal.CURRENT_GEAR: (0.03, 1.0),
    Signal.SUMP_TEMPERATURE: (0.5, 1.0),
}


def of_automatic(columns: Mapping[Signal, Series], rng: np.random.Generator) -> dict[Signal, Series]:
    """Return what a scan tool makes of an automatic: each channel at uneven times of its own, in whole steps."""
    speed, turbine = columns[Signal.ENGINE_SPEED], columns[Signal.TURBINE_SPEED]
    columns = {**columns, Signal.LOCKUP_SLIP: replace(speed, value=speed.value - turbine.value)}
    told, end_s = dict[Signal, Series](), speed.t_ns[-1] / NS_PER_S - ENDING_S
    for signal, (period_s, step) in AUTOMATIC.items():
        rows_s = np.cumsum(rng.uniform(0.67, 1.37, int(end_s / period_s)) * period_s) + SETTLED_S
        rows_ns = np.round(1e3 * rows_s[rows_s < end_s]).astype(np.int64) * 1_000_000
        value = columns[signal].value[np.searchsorted(columns[signal].t_ns, rows_ns, side="right") - 1]
        value = np.round(value / step) * step
        told[signal] = Series(t_ns=rows_ns, sequence=np.full(len(rows_ns), -1), value=value)
    return told
