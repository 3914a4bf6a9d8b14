"""A mapping profile proposed from names, units and statistics: a start for people who know their vehicle."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.decode.signal_table import NO_INVALID, Decoded, InvalidCounts
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.profile import SignalSource, to_si

MIN_SCORE: Final = 3.0
_NEVER: Final = re.compile(
    r"crc|check|chk|alive|counter|_bz$|status|qbit|fault|error|fehler|warn|lamp|req|anf(ord|_)|wunsch|begr|limit|max|min|grad"
    r"|offset|display|disp|anzeige|cluster",
    re.IGNORECASE,
)
_CLUTCH1: Final = r"(clutch|kuppl\w*|clt|k)[_ ]?(1|a|odd)"
_CLUTCH2: Final = r"(clutch|kuppl\w*|clt|k)[_ ]?(2|b|even)"


@dataclass(slots=True, kw_only=True)
class SignalStatistics:
    """One signal of a database as it occurred in a log."""

    message: str
    signal: str
    unit: str
    count: int = 0  # valid values
    lowest: float = math.inf  # in the unit of the database
    highest: float = -math.inf
    is_integer: bool = True
    invalid: InvalidCounts = NO_INVALID  # values that are no measurements

    @property
    def place(self) -> str:
        """Message and signal."""
        return f"{self.message}.{self.signal}"

    def add(self, decoded: Decoded) -> None:
        """Count more values."""
        self.invalid = self.invalid.plus(decoded.invalid)
        good = decoded.value if decoded.is_good is None else decoded.value[decoded.is_good]
        good = good[np.isfinite(good)]
        if len(good):
            self.count += len(good)
            self.lowest = min(self.lowest, float(good.min()))
            self.highest = max(self.highest, float(good.max()))
            self.is_integer &= bool(np.all(good == np.rint(good)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """What a canonical signal looks like: its names, and where its values can lie [SI]."""

    names: str  # pattern; more of its groups, more certainty
    lowest: float
    highest: float
    is_integer: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A signal that may be a canonical one."""

    signal: Signal
    statistics: SignalStatistics
    score: float


_SPEED_RAD_S: Final = 1100.0
KINDS: Final[dict[Signal, Kind]] = {
    Signal.ENGINE_SPEED: Kind(
        names=r"eng\w*(spe+d|spd|rpm)|^n$|^rpm$|drehzahl|nmot|n_eng", lowest=0, highest=_SPEED_RAD_S
    ),
    Signal.ENGINE_TORQUE: Kind(names=r"eng\w*(torque|trq|tq)|mom_ist|crank\w*(torque|trq)", lowest=-1500, highest=4000),
    Signal.PEDAL: Kind(names=r"pedal|fahrped|accel\w*pos|^pv_av", lowest=0, highest=1.1),
    Signal.THROTTLE: Kind(names=r"throttle|drossel|^tps", lowest=0, highest=1.1),
    Signal.HUB_SPEED: Kind(
        names=r"hub\w*(spe+d|spd)|clutch\w*input\w*spe+d|drum\w*spe+d", lowest=0, highest=_SPEED_RAD_S
    ),
    Signal.INPUT1_SPEED: Kind(
        names=r"(input|shaft|in|inp|eingang)\w*1\w*|odd\w*(spe+d|spd)", lowest=0, highest=_SPEED_RAD_S
    ),
    Signal.INPUT2_SPEED: Kind(
        names=r"(input|shaft|in|inp|eingang)\w*2\w*|even\w*(spe+d|spd)", lowest=0, highest=_SPEED_RAD_S
    ),
    Signal.INPUT_SPEED: Kind(
        names=r"input(?!\w*[12])\w*spe+d|eingangsdreh|^n_tc$|turbine|input\w*rpm", lowest=0, highest=_SPEED_RAD_S
    ),
    Signal.OUTPUT_SPEED: Kind(names=r"output\w*(spe+d|spd|rpm)|abtrieb", lowest=0, highest=_SPEED_RAD_S),
    Signal.CLUTCH1_PRESSURE: Kind(names=rf"{_CLUTCH1}\w*(press|druck|prs)", lowest=-1e5, highest=6e6),
    Signal.CLUTCH2_PRESSURE: Kind(names=rf"{_CLUTCH2}\w*(press|druck|prs)", lowest=-1e5, highest=6e6),
    Signal.CLUTCH1_TORQUE_COMMAND: Kind(names=rf"{_CLUTCH1}\w*(torque|trq|tq|mom)", lowest=-2000, highest=4000),
    Signal.CLUTCH2_TORQUE_COMMAND: Kind(names=rf"{_CLUTCH2}\w*(torque|trq|tq|mom)", lowest=-2000, highest=4000),
    Signal.CLUTCH_TORQUE: Kind(names=r"clutch\w*(torque|trq|tq)|aufnahmemom|kuppl\w*mom", lowest=-2000, highest=4000),
    Signal.CURRENT_GEAR: Kind(
        names=r"(cur|act|engaged|ist)\w*(gear|gr|gang)$|gang_?ist|^gear$", lowest=-1, highest=16, is_integer=True
    ),
    Signal.TARGET_GEAR: Kind(
        names=r"(tar|tgt|target|next|ziel|selected|soll)\w*(gear|gr|gang)$", lowest=-1, highest=16, is_integer=True
    ),
    Signal.SUMP_TEMPERATURE: Kind(
        names=r"(sump|sumpf|trans|gear\w*box|oil|at)\w*temp|temp\w*(at|oil|sump)$|getriebe\w*temp",
        lowest=230,
        highest=480,
    ),
    Signal.VEHICLE_SPEED: Kind(names=r"veh\w*(spe+d|spd)|v_?(signal|veh)|^vs$|geschw", lowest=0, highest=120),
    Signal.ODOMETER: Kind(names=r"odo|kilometerstand|total\w*dist", lowest=0, highest=4e9),
}
"""Canonical signals that are proposed; the others add nothing to the diagnosis."""


def candidates(statistics: Iterable[SignalStatistics]) -> dict[Signal, list[Candidate]]:
    """Return for every canonical signal what may be it, the best first; no signal is proposed for two."""
    found = [one for signal in KINDS for stat in statistics if (one := _candidate(signal, stat)) is not None]
    found.sort(key=lambda one: (-one.score, one.statistics.place))
    taken: set[str] = set()
    best: dict[Signal, list[Candidate]] = {}
    for one in found:
        if one.signal not in best and one.statistics.place in taken:
            continue
        if one.signal not in best:
            taken.add(one.statistics.place)
        best.setdefault(one.signal, []).append(one)
    return best


def profile_text(name: str, best: dict[Signal, list[Candidate]], remarks: Sequence[str]) -> str:
    """Return a profile as TOML, with what else was considered and the remarks as comments."""
    lines = [*(f"# {remark}".rstrip() for remark in remarks), f'name = "{_quoted(name)}"', "", "[signals]"]
    for signal in Signal:
        for rank, one in enumerate(best.get(signal, ())[:3]):
            place = f'message = "{_quoted(one.statistics.message)}", signal = "{_quoted(one.statistics.signal)}"'
            lines.append(f"{'# or: ' if rank else ''}{signal.value} = {{ {place} }}  # {_said(one)}")
    return "\n".join(lines) + "\n"


def _candidate(signal: Signal, stat: SignalStatistics) -> Candidate | None:
    """Return a signal as a candidate if unit, values and name allow it."""
    kind = KINDS[signal]
    if not stat.count or _NEVER.search(stat.signal) or (kind.is_integer and not stat.is_integer):
        return None
    try:
        convert = to_si(signal, SignalSource(message=stat.message, signal=stat.signal), stat.unit)
    except ConfigError:
        return None
    lowest, highest = convert(np.array([stat.lowest, stat.highest])).tolist()
    if not kind.lowest <= lowest <= highest <= kind.highest:
        return None
    match = re.search(kind.names, stat.signal, re.IGNORECASE)
    if match is None:
        return None
    score = 2.0 + 2.0 * len(match.group()) / len(stat.signal) + (1.0 if stat.unit else 0.0)
    score += 1.0 if highest > lowest else 0.0  # a signal that never changes tells little
    return Candidate(signal=signal, statistics=stat, score=score) if score >= MIN_SCORE else None


def _said(one: Candidate) -> str:
    stat = one.statistics
    return f"{stat.lowest:g} to {stat.highest:g} {stat.unit}, {stat.count} values, score {one.score:.1f}".replace(
        " ,", ","
    )


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
