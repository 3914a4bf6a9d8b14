"""Tables as a scan tool writes them, from logs of the emulated car: `ecu-emulator record --table` for studies."""

from pathlib import Path
from typing import Final

import numpy as np

from ecu_emulator.log_formats.table import TableOptions, write_table

OF_FRICTION: Final = frozenset({"Clutch Hub Speed", "Oil Temperature"})
OUTPUT: Final = OF_FRICTION | {"Output Shaft Speed"}  # what a tool need not ask that knows the input shafts


def written(
    log: Path, table: Path, rng: np.random.Generator, *, rate_hz: float = 27.0, jitter_s: float = 0.01,
    skew_ratio: float = 1.0, left_out: frozenset[str] = OUTPUT,
) -> None:  # fmt: skip
    """Write a table of a log; what the arguments mean is said by `TableOptions`."""
    options = TableOptions(path=table, rate_hz=rate_hz, jitter_s=jitter_s, skew_ratio=skew_ratio, left_out=left_out)
    write_table(log, options, rng)
