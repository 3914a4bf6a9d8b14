"""Public test cycles as speed traces: tables of whole seconds, each naming its source in its first line."""

from importlib.resources import files
from typing import Final

import numpy as np

from clutch_model.units import m_s_from_km_h
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.errors import ConfigError

PUBLIC_TRACES: Final = ("wltc", "udds", "hwfet", "us06")
_HEADER_LINES: Final = 2  # the source, and the names of the columns


def public_trace(name: str) -> SpeedTrace:
    """Return one of the public test cycles, on level ground.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    if name not in PUBLIC_TRACES:
        raise ConfigError(f"no speed trace {str(name)!r}: use one of {', '.join(PUBLIC_TRACES)}")
    with files("ecu_emulator").joinpath(f"driving/traces/{name}.csv").open(encoding="utf-8") as lines:
        t_s, speed_km_h = np.loadtxt(lines, delimiter=",", skiprows=_HEADER_LINES, unpack=True)
    return SpeedTrace(name=name, t_s=t_s, speed_m_s=m_s_from_km_h(speed_km_h), grade_ratio=np.zeros(len(t_s)))
