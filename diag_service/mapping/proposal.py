"""A mapping profile proposed from names, units and statistics: a start for people who know their vehicle."""

import math
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.decode.signals import NO_INVALID, Decoded, InvalidCounts
from clutchdiag_io.people import PLUS_MINUS, digits, half_width
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.errors import ConfigError
from diag_service.mapping.mapped_messages import is_of_lockup
from diag_service.mapping.names import before_converter, named_signal, read_name
from diag_service.mapping.profile import BusSource, ColumnSource, SignalSource, to_si
from diag_service.mapping.units import (
    OF_THE_US,
    USUAL,
    Surroundings,
    UnitReading,
    conversion_name,
    kind_of_unit,
    reading_of,
    told_step,
)

TYPICAL_TORQUE_NM: Final = 200.0  # of the most fuel: some scale must be assumed
ASSUMED_FRICTION_NM: Final = 25.0  # of an engine without fuel
# Widths of the band in which the ratios of a closed clutch lie, as parts of them; rough ground or a tool that asks for
# one speed after the other scatters them. Neighbouring gears are three times the widest apart.
WINDOWS: Final = (0.01, 0.015, 0.02, 0.03, 0.045)
LEAST_SAMPLES: Final = 10
LEAST_SHARE: Final = 0.2  # of a gear's samples in that band: else its clutch was never closed for long
MOST_ODD: Final = 100  # values at either end, one of a thousand, that may be damage
MOST_DISTINCT: Final = 4096
LEAST_SPEED: Final = 0.1  # of the highest output speed: below, its steps are too coarse


class GearRatio(NamedTuple):
    """What a log shows of a gear: the ratio, its standard deviation, and from how many samples."""

    ratio: float
    std: float
    sample_count: int


def is_complete(ratios: Mapping[int, GearRatio]) -> bool:
    """Return whether there is every gear from the first on, each with a lower ratio than the one below it."""
    values = [ratios[gear].ratio for gear in sorted(ratios)]
    return (
        sorted(ratios) == list(range(1, len(ratios) + 1)) and len(values) > 1 and values == sorted(values, reverse=True)
    )


def densest(ratios: FloatArray, least_share: float = LEAST_SHARE) -> GearRatio | None:
    """Return the middle of the narrowest band that holds enough of the ratios; None if too few lie in any."""
    ordered = np.sort(ratios[ratios > 0.0])
    for window in WINDOWS if len(ordered) else ():
        counts = np.searchsorted(ordered, ordered * (1.0 + window), side="right") - np.arange(len(ordered))
        first = int(counts.argmax())
        band = ordered[first : first + int(counts[first])]
        if len(band) >= max(LEAST_SAMPLES, least_share * len(ratios)):
            return GearRatio(float(np.median(band)), float(band.std() / np.sqrt(len(band))), len(band))
    return None


MIN_SCORE: Final = 3.0
PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_NEVER: Final = re.compile(
    r"crc|check|chk|alive|counter|_bz$|status|qbit|fault|error|fehler|warn|lamp|req|anf(ord|_)|wunsch|begr|limit|max|min|grad"
    r"|offset|display|disp|anzeige|cluster|volt",
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
    is_column: bool = False  # of a table of signals: its message is the column
    count: int = 0  # valid values
    lowest: float = math.inf  # in the unit of the database
    highest: float = -math.inf
    is_integer: bool = True
    invalid: InvalidCounts = NO_INVALID  # values that are no measurements
    tails: FloatArray = field(default_factory=lambda: np.empty((2, 0)))  # the lowest values, and of their negatives
    distinct: FloatArray = field(default_factory=lambda: np.empty(0))  # different values, rising; the lowest of many

    @property
    def place(self) -> str:
        """Message and signal, or column."""
        return self.signal if self.is_column else f"{self.message}.{self.signal}"

    @property
    def source(self) -> SignalSource:
        if self.is_column:
            return ColumnSource(column=self.signal)
        return BusSource(message=self.message, signal=self.signal)

    @property
    def ends(self) -> FloatArray:
        """Between which nearly all values lie, whatever a few damaged ones are."""
        odd = min(-(-self.count // 1000), MOST_ODD)
        is_known = self.tails.shape[1] > MOST_ODD
        return self.tails[:, odd] * (1.0, -1.0) if is_known else np.array([self.lowest, self.highest])

    def add(self, decoded: Decoded) -> None:
        """Count more values."""
        self.invalid = self.invalid.plus(decoded.invalid)
        good = decoded.value if decoded.is_good is None else decoded.value[decoded.is_good]
        good = good[np.isfinite(good)]
        if len(good):
            self.count += len(good)
            self.tails = np.sort(np.hstack((self.tails, [good, -good])))[:, : MOST_ODD + 1]
            self.lowest, self.highest = float(self.tails[0, 0]), -float(self.tails[1, 0])
            self.is_integer &= bool(np.all(good == np.rint(good)))
            if self.is_column:
                self.distinct = np.unique(np.concatenate([self.distinct, good]))[:MOST_DISTINCT]


class Pattern(NamedTuple):
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
    reading: UnitReading  # in which unit: of a column that of its header, or what it must be
    score: float

    @property
    def unit(self) -> str:
        return self.reading.unit

    @property
    def source(self) -> SignalSource:
        """Where a profile finds it, and in which unit if it is a column."""
        source = self.statistics.source
        if isinstance(source, ColumnSource):
            return replace(source, unit=self.unit, or_unit=self.reading.other or None)
        return source


MARKS: Final = re.compile(r"\W+")
CALLED: Final = {
    "rad_s": "spe+d|spd|rpm|dreh",
    "m_s": "spe+d|spd|geschw",
    "pa": "press|prs|druck",
    "nm": "torque|trq|tq|mom",
    "k": "temp",
    "m": "odo|kilom|dist",
    "s": "pulse|width|time|pw|zeit|dauer",
    "ratio": "ped|throt|tps|dross|accel",
}
"""What a column without a unit must be called to be of a quantity, where its name is not listed."""
LEAST_PA: Final = 1e5  # that the highest pressure reaches, which tells units apart
_SPEED_RAD_S: Final = 1100.0
KINDS: Final[dict[Signal, Pattern]] = {
    Signal.ENGINE_SPEED: Pattern(r"eng\w*(spe+d|spd|rpm)|^n$|^rpm$|drehzahl|nmot|n_eng", 0, _SPEED_RAD_S),
    Signal.ENGINE_TORQUE: Pattern(r"eng\w*(torque|trq|tq)|mom_ist|crank\w*(torque|trq)", -1500, 4000),
    Signal.INJECTION_TIME: Pattern(r"inj\w*(pw|pulse|time|width|zeit|dauer)", 0, 0.1),
    Signal.PEDAL: Pattern(r"pedal|fahrped|accel\w*pos|^pv_av", 0, 1.1),
    Signal.THROTTLE: Pattern(r"throttle|drossel|^tps", 0, 1.1),
    Signal.HUB_SPEED: Pattern(r"hub\w*(spe+d|spd)|clutch\w*input\w*spe+d|drum\w*spe+d", 0, _SPEED_RAD_S),
    Signal.INPUT1_SPEED: Pattern(r"(input|shaft|in|inp|eingang)\w*1\w*|odd\w*(spe+d|spd)", 0, _SPEED_RAD_S),
    Signal.INPUT2_SPEED: Pattern(r"(input|shaft|in|inp|eingang)\w*2\w*|even\w*(spe+d|spd)", 0, _SPEED_RAD_S),
    Signal.INPUT_SPEED: Pattern(r"input(?!\w*[12])\w*spe+d|eingangsdreh|^n_tc$|turbine|input\w*rpm", 0, _SPEED_RAD_S),
    Signal.OUTPUT_SPEED: Pattern(r"output\w*(spe+d|spd|rpm)|abtrieb", 0, _SPEED_RAD_S),
    Signal.CLUTCH1_PRESSURE: Pattern(rf"{_CLUTCH1}\w*(press|druck|prs)", -1e5, 6e6),
    Signal.CLUTCH2_PRESSURE: Pattern(rf"{_CLUTCH2}\w*(press|druck|prs)", -1e5, 6e6),
    Signal.CLUTCH1_TORQUE_COMMAND: Pattern(rf"{_CLUTCH1}\w*(torque|trq|tq|mom)", -2000, 4000),
    Signal.CLUTCH2_TORQUE_COMMAND: Pattern(rf"{_CLUTCH2}\w*(torque|trq|tq|mom)", -2000, 4000),
    Signal.CLUTCH_TORQUE: Pattern(r"clutch\w*(torque|trq|tq)|aufnahmemom|kuppl\w*mom", -2000, 4000),
    Signal.CURRENT_GEAR: Pattern(r"(cur|act|engaged|ist)\w*(gear|gr|gang)$|gang_?ist|^gear$", -1, 16, is_integer=True),
    Signal.TARGET_GEAR: Pattern(
        r"(tar|tgt|target|next|ziel|selected|soll|command|desired)\w*(gear|gr|gang)$", -1, 16, is_integer=True
    ),
    Signal.SUMP_TEMPERATURE: Pattern(
        r"(sump|sumpf|trans|gear\w*box|oil|at)\w*temp|temp\w*(at|oil|sump)$|getriebe\w*temp", 230, 480
    ),
    Signal.VEHICLE_SPEED: Pattern(r"veh\w*(spe+d|spd)|v_?(signal|veh)|^vs$|geschw", 0, 120),
    Signal.ODOMETER: Pattern(r"odo|kilometerstand|total\w*dist", 0, 4e9),
}
"""What canonical signals look like whose names are not listed; the others are not proposed without."""
RANGES: Final[Mapping[Signal, tuple[float, float]]] = {
    **{signal: (pattern.lowest, pattern.highest) for signal, pattern in KINDS.items()},
    Signal.TURBINE_SPEED: (0, _SPEED_RAD_S),
    Signal.LOCKUP_SLIP: (-_SPEED_RAD_S, _SPEED_RAD_S),
    Signal.LOCKUP_SLIP_COMMAND: (-_SPEED_RAD_S, _SPEED_RAD_S),
    Signal.LOCKUP_PRESSURE: (-1e5, 6e6),
    Signal.LOCKUP_PRESSURE_COMMAND: (-1e5, 6e6),
    Signal.LINE_PRESSURE_COMMAND: (-1e5, 6e6),
    Signal.ENGINE_TORQUE_COMMAND: (-1500, 4000),
    Signal.COOLANT_TEMPERATURE: (230, 480),
}
LISTED_SCORE: Final = 5.0
LB_FT_NM: Final = 1.355818
TORQUES_ALIKE: Final = 0.05  # of two torques of an engine, filtered otherwise


def candidates(statistics: Iterable[SignalStatistics]) -> dict[Signal, list[Candidate]]:
    """Return for every canonical signal what may be it, the best first; no signal is proposed for two."""
    statistics = list(statistics)
    listed = {stat.place: signal for stat in statistics if stat.is_column and (signal := named_signal(stat.signal))}
    if is_of_lockup(set(listed.values())):
        listed |= {place: before_converter(signal) for place, signal in listed.items()}
    around = _surroundings(statistics, listed)
    named = ((stat, listed.get(stat.place)) for stat in statistics)
    pairs = ((stat, signal) for stat, name in named for signal in ([name] if name else KINDS))
    matches = [
        candidate
        for stat, signal in pairs
        if (candidate := _candidate(signal, stat, around, is_listed=stat.place in listed))
    ]
    matches.sort(
        key=lambda candidate: (
            -candidate.score,
            -candidate.statistics.count if candidate.statistics.place in listed else 0,
            candidate.statistics.place,
        )
    )
    taken: set[str] = set()
    best: dict[Signal, list[Candidate]] = {}
    for candidate in matches:
        if candidate.signal not in best and candidate.statistics.place in taken:
            continue
        if candidate.signal not in best:
            taken.add(candidate.statistics.place)
        best.setdefault(candidate.signal, []).append(candidate)
    _in_one_unit(best)
    return best


def _in_one_unit(best: dict[Signal, list[Candidate]]) -> None:
    """Read the pressures of both clutches in one unit: that of the header, else that of the higher one."""
    if len(pair := [best[signal][0] for signal in PRESSURES if signal in best]) < len(PRESSURES):
        return
    leader = max(pair, key=lambda one: (bool(one.statistics.unit), one.statistics.highest))
    for other in pair:
        if other.statistics.is_column and not other.statistics.unit and leader.statistics.is_column:
            best[other.signal][0] = replace(other, reading=leader.reading)


def _surroundings(statistics: Iterable[SignalStatistics], listed: Mapping[str, Signal]) -> Surroundings:
    """Return what all columns say of the units of each."""
    highest, is_of_the_us = dict[Signal, float](), False
    for stat in statistics:
        if not (signal := listed.get(stat.place)) or not stat.count:
            continue
        unit = stat.unit or read_name(stat.signal).unit
        kind = kind_of_unit(signal)
        step = None if kind is None else told_step(stat.distinct, kind)
        is_of_the_us |= (step.unit if step else conversion_name(unit)) in OF_THE_US
        with suppress(ConfigError):
            highest[signal] = float(to_si(signal, stat.source, unit or "rpm")(stat.ends)[1])
    return Surroundings(
        is_of_the_us=is_of_the_us,
        coolant_k=highest.get(Signal.COOLANT_TEMPERATURE),
        output_rad_s=highest.get(Signal.OUTPUT_SPEED),
    )


def questioned(best: Mapping[Signal, Sequence[Candidate]]) -> Iterator[str]:
    """Yield a sentence for each unit that something contradicts: steps, ranges, or another torque of the engine."""
    for first, *_ in best.values():
        if first.reading.other:
            place, reading = first.statistics.place, first.reading
            yield f"The unit of {place!r} is questioned: {reading.why}. It is read in {reading.unit}"
    torques = best.get(Signal.ENGINE_TORQUE, [])
    for other in torques[1:]:
        tops = [to_si(torque.signal, torque.source, None)(torque.statistics.ends)[1] for torque in (torques[0], other)]
        ratio = tops[0] / tops[1] if tops[1] else 0.0
        if min(abs(ratio - LB_FT_NM), abs(1.0 / ratio - LB_FT_NM) if ratio else 1.0) < LB_FT_NM * TORQUES_ALIKE:
            both = (f"{torque.statistics.place!r} in {torque.unit}" for torque in (torques[0], other))
            yield f"The engine's torque is questioned: {' and '.join(both)} would agree in one unit"


def engine_speed_is_sum(best: Mapping[Signal, Sequence[Candidate]]) -> bool:
    """Return whether engine speed is better told by turbine and slip: by itself it comes less than half as often."""
    count = {signal: candidates[0].statistics.count for signal, candidates in best.items()}
    both = min(count.get(Signal.TURBINE_SPEED, 0), count.get(Signal.LOCKUP_SLIP, 0))
    return both > 2 * count.get(Signal.ENGINE_SPEED, 0)


def profile_text(name: str, best: dict[Signal, list[Candidate]], remarks: Sequence[str]) -> str:
    """Return a profile as TOML, with what else was considered and the remarks as comments."""
    lines = [*(f"# {remark}".rstrip() for remark in remarks), f'name = "{_quoted(name)}"', "", "[signals]"]
    is_sum = engine_speed_is_sum(best)
    for signal in Signal:
        if signal is Signal.ENGINE_SPEED and is_sum:
            lines.append(f"# {signal.value} is turbine speed plus slip, which come more often than it does by itself")
        for rank, candidate in enumerate(best.get(signal, ())[:3], signal is Signal.ENGINE_SPEED and is_sum):
            unit = f', unit = "{_quoted(candidate.unit)}"' if candidate.statistics.is_column else ""
            unit += f', or_unit = "{candidate.reading.other}"' if candidate.reading.other else ""
            lines.append(
                f"{'# or: ' if rank else ''}{signal.value} = {{ {_place(candidate)}{unit} }}  # {_said(candidate)}"
            )
            if candidate.reading.other and not rank:
                swapped = f'unit = "{candidate.reading.other}"'
                lines.append(f"# questioned: {candidate.reading.why}. The other reading:")
                lines.append(f"# or: {signal.value} = {{ {_place(candidate)}, {swapped} }}")
    if Signal.ENGINE_TORQUE not in best and Signal.INJECTION_TIME in best:
        fuel = best[Signal.INJECTION_TIME][0]
        scale = f"scale = {TYPICAL_TORQUE_NM / fuel.statistics.highest:.3g}"
        source = f'{_place(fuel)}, unit = "Nm", {scale}, offset = {-ASSUMED_FRICTION_NM:g}, origin = "without_cut"'
        lines.append(
            "# Torque goes with the injected fuel, up to a scale. Where a shift takes away fuel, too, not only sparks:"
        )
        lines.append('# origin = "modelled"')
        lines.append(f"{Signal.ENGINE_TORQUE.value} = {{ {source} }}")
    return "\n".join(lines) + "\n"


def _place(one: Candidate) -> str:
    message, name = _quoted(one.statistics.message), _quoted(one.statistics.signal)
    return f'column = "{name}"' if one.statistics.is_column else f'message = "{message}", signal = "{name}"'


def gears_text(over: Signal, ratios: Mapping[int, GearRatio]) -> str:
    """Return the table of ratios of a profile as TOML, as far as a log shows them; empty if it shows none."""
    if not ratios:
        return ""
    shown = [
        f"# gear {gear}: {one.ratio:.4g} ± {half_width(one.std, '{:.2g}')}, {one.sample_count} samples"
        for gear, one in sorted(ratios.items())
    ]
    mark = "" if is_complete(ratios) else "# "
    missing = [] if not mark else ["# Complete it: not every gear shows its ratio."]
    values = ", ".join(f"{one.ratio:.4g}" for _, one in sorted(ratios.items()))
    shown = [f"# {PLUS_MINUS}:", *shown, *missing]
    lines = ["", *shown, f"{mark}[gears]", f'{mark}over = "{over.value}"', f"{mark}ratios = [{values}]"]
    return "\n".join(lines) + "\n"


def unfit_units(statistics: Iterable[SignalStatistics], known: Container[Signal]) -> Iterator[str]:
    """Yield a sentence for each column that its name makes a signal that is not known, but its unit does not."""
    for stat in (one for one in statistics if one.is_column and one.unit):
        bare, listed = replace(stat, unit=""), named_signal(stat.signal)
        called = [
            one
            for one in ([listed] if listed is not None else KINDS)
            if one not in known
            and (one is listed or _match(one, stat))
            and _reading(one, bare, Surroundings(), is_listed=one is listed)
        ]
        try:
            for signal in called:
                to_si(signal, stat.source, stat.unit)
        except ConfigError as error:
            yield str(error)


def _match(signal: Signal, stat: SignalStatistics) -> re.Match[str] | None:
    name = stat.signal.partition("\\")[0]  # behind it a measurement says of which controller it is
    return None if _NEVER.search(stat.signal) else re.search(KINDS[signal].names, MARKS.sub("_", name), re.IGNORECASE)


def _candidate(signal: Signal, stat: SignalStatistics, around: Surroundings, *, is_listed: bool) -> Candidate | None:
    """Return a signal as a candidate if unit, values and name allow it."""
    match = None if is_listed else _match(signal, stat)
    is_whole = signal not in KINDS or not KINDS[signal].is_integer or stat.is_integer
    if (match is None and not is_listed) or not stat.count or not is_whole:
        return None
    reading = _reading(signal, stat, around, is_listed=is_listed)
    if reading is None:
        return None
    score = LISTED_SCORE if match is None else 2.0 + 2.0 * len(match.group()) / len(match.string)
    score += 1.0 if stat.unit else 0.0
    score += 1.0 if stat.highest > stat.lowest else 0.0  # a signal that never changes tells little
    return None if score < MIN_SCORE else Candidate(signal=signal, statistics=stat, reading=reading, score=score)


def _reading(signal: Signal, stat: SignalStatistics, around: Surroundings, *, is_listed: bool) -> UnitReading | None:
    """Return in which unit a signal is read: of a column without one, what its name allows and its values can be."""
    kind = kind_of_unit(signal)
    if kind is None or not stat.is_column:
        return UnitReading(unit=stat.unit) if _is_possible(signal, stat, stat.unit) else None
    if not (stat.unit or is_listed or re.search(CALLED[kind], stat.signal, re.IGNORECASE)):
        return None
    stated = (stat.unit, read_name(stat.signal).unit)
    units = dict.fromkeys((*([stat.unit] if stat.unit else []), *USUAL[kind]))
    possible = {
        unit: to_si(signal, stat.source, unit)(stat.ends)
        for unit in units
        if (stat.unit in ("", unit) or conversion_name(unit) != conversion_name(stat.unit))
        and _is_possible(signal, stat, unit)
    }
    return reading_of(signal, stated, possible, stat.distinct, around)


def _is_possible(signal: Signal, stat: SignalStatistics, unit: str) -> bool:
    """Return whether the values of a signal can be those of a canonical one, in this unit."""
    try:
        convert = to_si(signal, stat.source, unit)
    except ConfigError:
        return False
    return _can_be(signal, convert(stat.ends), is_sure=unit == stat.unit)


def _can_be(signal: Signal, ends: FloatArray, *, is_sure: bool = False) -> bool:
    """Return whether a canonical signal can have this range [SI]; ``is_sure`` that of a unit that nobody assumed."""
    lowest, highest = ends.tolist()
    least, most = RANGES.get(signal, (-math.inf, math.inf))
    return least <= lowest <= highest <= most and (is_sure or kind_of_unit(signal) != "pa" or highest >= LEAST_PA)


class Ranges:
    """Notes what the columns of a table reach around events, and says which units of a profile cannot be right."""

    def __init__(self, sources: Mapping[Signal, SignalSource]) -> None:
        self._sources = {
            signal: source
            for signal, source in sources.items()
            if isinstance(source, ColumnSource) and signal in RANGES
        }
        self._ends: dict[Signal, FloatArray] = {}

    def add(self, event: Event) -> None:
        """Take up the values around an event."""
        for signal in self._sources.keys() & event.columns.keys():
            values = event.columns[signal].value
            if len(values):
                ends = np.append(self._ends.get(signal, values[:1]), [values.min(), values.max()])
                self._ends[signal] = np.array([ends.min(), ends.max()])

    def doubts(self) -> Iterator[str]:
        """Yield a sentence for each column whose values can hardly be in its unit, and whose unit is questioned."""
        for signal, ends in self._ends.items():
            if _can_be(signal, ends):
                continue
            source = self._sources[signal]
            said = to_si(signal, source, None)
            own = (ends - said.offset) / said.factor
            fitting = [
                unit
                for unit in USUAL[kind_of_unit(signal) or "ratio"]
                if _can_be(signal, to_si(signal, replace(source, unit=None), unit)(own))
            ]
            hint = f", but in {' or '.join(map(repr, fitting))}" if fitting else "; is it another column?"
            place = f"values from {digits(own[0])} to {digits(own[1])} of column {source.column!r}"
            yield f"{signal.value}: {place} can hardly be in {source.unit!r}{hint}"
        for signal, source in self._sources.items():
            if source.or_unit:
                what = (
                    f"column {source.column!r} is read in {source.unit!r}, but something speaks for {source.or_unit!r}"
                )
                yield f"{signal.value}: {what}"


def _said(candidate: Candidate) -> str:
    stat = candidate.statistics
    why = candidate.reading.why if not candidate.reading.other else ""
    unit = f"{candidate.unit} ({why})" if why else candidate.unit
    span = f"{digits(stat.lowest)} to {digits(stat.highest)} {unit}".rstrip()
    return f"{span}, {stat.count} values, score {candidate.score:.1f}"


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
