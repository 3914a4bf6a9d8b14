"""Speed traces: what a driver shall follow; the public test cycles, each naming its source in its first line."""

from dataclasses import dataclass
from importlib.resources import files
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.units import m_s_from_km_h
from ecu_emulator.errors import ConfigError

FASTEST_M_S = 70.0
STEEPEST_RATIO = 0.25
PUBLIC_TRACES: Final = ("wltc", "udds", "hwfet", "us06")
_HEADER_LINES: Final = 2  # the source, and the names of the columns


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedTrace:
    """Speed and grade over time; straight lines between the points, the last one is the end of the drive.

    Raises
    ------
    ConfigError
        On construction, if it is not a trace: times that do not rise from 0, speeds or grades out of range.
    """

    name: str
    t_s: FloatArray  # (n,), n >= 2, rises from 0
    speed_m_s: FloatArray  # (n,)
    grade_ratio: FloatArray  # (n,), rise over way, positive uphill

    def __post_init__(self) -> None:
        columns = (self.t_s, self.speed_m_s, self.grade_ratio)
        if any(column.shape != (self.t_s.size,) for column in columns) or self.t_s.size < 2:
            raise ConfigError(f"trace {self.name}: needs two or more points, each with time, speed and grade")
        if not all(np.isfinite(column).all() for column in columns):
            raise ConfigError(f"trace {self.name}: every number must be finite")
        if self.t_s[0] != 0.0 or (np.diff(self.t_s) <= 0.0).any():
            raise ConfigError(f"trace {self.name}: times must begin at 0 and rise")
        if self.speed_m_s.min() < 0.0 or self.speed_m_s.max() > FASTEST_M_S:
            raise ConfigError(f"trace {self.name}: speeds must be 0..{FASTEST_M_S:g} m/s")
        if np.abs(self.grade_ratio).max() > STEEPEST_RATIO:
            raise ConfigError(f"trace {self.name}: grades must be within {STEEPEST_RATIO:g}")

    @property
    def duration_s(self) -> float:
        """Length of the trace [s]."""
        return float(self.t_s[-1])

    @property
    def distance_m(self) -> float:
        """Way it leads [m]."""
        return float(np.trapezoid(self.speed_m_s, self.t_s))


def public_trace(name: str) -> SpeedTrace:
    """Return one of the public test cycles, on level ground; raises ConfigError if there is none of that name."""
    if name not in PUBLIC_TRACES:
        raise ConfigError(f"no speed trace {str(name)!r}: use one of {', '.join(PUBLIC_TRACES)}")
    with files("ecu_emulator").joinpath(f"driving/traces/{name}.csv").open(encoding="utf-8") as lines:
        t_s, speed_km_h = np.loadtxt(lines, delimiter=",", skiprows=_HEADER_LINES, unpack=True)
    return SpeedTrace(name=name, t_s=t_s, speed_m_s=m_s_from_km_h(speed_km_h), grade_ratio=np.zeros(len(t_s)))
