"""Tables as a scan tool writes them, from logs of the emulated car: `ecu-emulator record --table` for studies."""

from pathlib import Path
from typing import Final

import numpy as np

from ecu_emulator.log_formats.table import TableOptions, write_table

OF_FRICTION: Final = frozenset({"Clutch Hub Speed", "Oil Temperature"})
TYPICAL_NM, TYPICAL_RAD_S, IDLE_RAD_S, PULSE_STEP_MS = 150.0, 200.0, 60.0, 0.02
OUTPUT: Final = OF_FRICTION | {"Output Shaft Speed"}  # what a tool need not ask that knows the input shafts


def written(
    log: Path, table: Path, rng: np.random.Generator, *, rate_hz: float = 27.0, jitter_s: float = 0.01,
    skew_ratio: float = 1.0, left_out: frozenset[str] = OUTPUT,
) -> None:  # fmt: skip
    """Write a table of a log; what the arguments mean is said by `TableOptions`."""
    options = TableOptions(path=table, rate_hz=rate_hz, jitter_s=jitter_s, skew_ratio=skew_ratio, left_out=left_out)
    write_table(log, options, rng)


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
