"""Signals in the words of people: engine torque, oil temperature, commanded lock-up pressure."""

from collections.abc import Iterable, Mapping
from typing import Final

from clutch_model.units import for_people
from diag_service.diagnosis.columns import Signal

_COMMAND: Final = "command"
_PARTS: Final[Mapping[str, str]] = {  # of canonical names
    "clutch1": "clutch 1",
    "clutch2": "clutch 2",
    "input1": "input shaft 1",
    "input2": "input shaft 2",
    "input": "input shaft",
    "output": "output shaft",
    "hub": "clutch hub",
    "lockup": "lock-up",
    "sump": "oil",
    "vehicle": "road",
    "ambient": "outside",
}


def signal_words(signal: Signal) -> str:
    """Return what people call a signal: clutch 1 pressure, commanded lock-up pressure."""
    name, _, _ = for_people(signal.value, 0.0)
    parts = [_PARTS.get(part, part) for part in name.split("_")]
    if _COMMAND in parts:
        parts = ["commanded", *(part for part in parts if part != _COMMAND)]
    return " ".join(parts)


def listed(signals: Iterable[Signal], link: str = ", ") -> str:
    """Return signals in their own order."""
    wanted = set(signals)
    return link.join(signal_words(signal) for signal in Signal if signal in wanted)
