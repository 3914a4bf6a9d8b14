"""What the sensors of the vehicle say, and when they are asked: the records between sensors and frame builder."""

from collections.abc import Mapping
from dataclasses import dataclass

from canlog.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """When one message is sent, by whom, and what it carries."""

    message: str
    sender: str
    cycle_ms: int
    phase_ms: int
    quantities: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """Values of one message at its send instants, keyed by quantity (SI); NaN: not available."""

    message: str  # DBC message name
    t_s: FloatArray  # (n,) scenario time
    values: Mapping[str, FloatArray]  # each (n,)
