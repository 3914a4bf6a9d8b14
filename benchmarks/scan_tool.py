"""Tables as a scan tool writes them, from logs of the emulated car: few rows, uneven, columns apart within a row."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

import canlog
from canlog.arrays import FloatArray
from dbc.contract import load_contract

COLUMNS: Mapping[str, tuple[str, str, float]] = {  # column: signal, unit, step
    "Engine Speed": ("ECM_TorqueSpeed.EngineSpeed", "rpm", 1.0),
    "Engine Torque": ("ECM_TorqueSpeed.EngineTorque", "Nm", 1.0),
    "Accelerator Pedal": ("ECM_TorqueSpeed.Pedal", "%", 0.5),
    "Clutch 1 Pressure": ("TCU_Pressures.Clutch1Pressure", "kPa", 5.86),
    "Clutch 2 Pressure": ("TCU_Pressures.Clutch2Pressure", "kPa", 5.86),
    "Input Shaft 1 Speed": ("TCU_InputSpeeds.InputShaft1Speed", "rpm", 1.0),
    "Input Shaft 2 Speed": ("TCU_InputSpeeds.InputShaft2Speed", "rpm", 1.0),
    "Current Gear": ("TCU_Shift.CurrentGear", "", 1.0),
    "Target Gear": ("TCU_Shift.TargetGear", "", 1.0),
    "Output Shaft Speed": ("TCU_Output.OutputSpeed", "rpm", 0.25),
    "Clutch Hub Speed": ("TCU_InputSpeeds.ClutchHubSpeed", "rpm", 0.25),
    "Oil Temperature": ("TCU_Temperature.SumpOilTemperature", "degC", 1.0),
}
OF_FRICTION: Final = frozenset({"Clutch Hub Speed", "Oil Temperature"})
OUTPUT: Final = OF_FRICTION | {"Output Shaft Speed"}  # what a tool need not ask that knows the input shafts
KPA_PER_BAR = 100.0
SETTLED_S = 0.2  # behind the first frame: until then sensors tell that they have no value yet


def written(
    log: Path, table: Path, rng: np.random.Generator, *, rate_hz: float = 27.0, jitter_s: float = 0.01,
    skew_ratio: float = 1.0, left_out: frozenset[str] = OUTPUT,
) -> None:  # fmt: skip
    """Write a table of a log.

    Parameters
    ----------
    rate_hz, jitter_s
        Of the rows; the jitter is a standard deviation.
    skew_ratio
        By how much of a row's period columns are asked one after the other.
    left_out
        Columns that the tool does not have.
    """
    signals = canlog.read([log], load_contract()).signals()
    names = [name for name in COLUMNS if name not in left_out]
    found = {name: signals[COLUMNS[name][0]] for name in names}
    first_s = max(_seconds(one.t_ns)[0] for one in found.values()) + SETTLED_S
    last_s = min(_seconds(one.t_ns)[-1] for one in found.values()) - 1.0
    rows_s = np.arange(first_s, last_s, 1.0 / rate_hz)
    rows_s = np.sort(rows_s + rng.normal(0.0, jitter_s, len(rows_s)))
    cells = []
    for place, name in enumerate(names):
        asked_s = rows_s + skew_ratio / rate_hz * place / len(names)
        series, (_, unit, step) = found[name], COLUMNS[name]
        values = series.value[np.searchsorted(_seconds(series.t_ns), asked_s, side="right") - 1]
        values = values * (KPA_PER_BAR if unit == "kPa" else 1.0)
        cells.append(np.round(np.round(values / step) * step, 3))
    heads = [f"{name} [{unit}]" if (unit := COLUMNS[name][1]) else name for name in names]
    lines = [",".join(["Time [ms]", *heads])]
    times = np.round(1e3 * rows_s).astype(np.int64)
    lines += [
        ",".join(map(str, (t, *row))) for t, row in zip(times.tolist(), np.column_stack(cells).tolist(), strict=True)
    ]
    table.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _seconds(t_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> FloatArray:
    return t_ns / 1e9
