"""Units of the columns of a table: what its header says, what names end in, or what physics allows.

Where they contradict each other, the likelier reading is taken and the other one kept beside it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.units import k_from_degc, m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from diag_service.diagnosis.columns import Signal


@dataclass(frozen=True, slots=True)
class Conversion:
    """From decoded values to SI: ``factor * value + offset``."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: FloatArray) -> FloatArray:
        """Return values in SI, of the same shape."""
        return value * self.factor + self.offset

    def after(self, scale: float, offset: float) -> "Conversion":
        """Return the conversion of values that are to be scaled and moved first."""
        return Conversion(self.factor * scale, self.factor * offset + self.offset)


SAME: Final = Conversion()
TO_SI: Final[Mapping[str, Mapping[str, Conversion]]] = {
    "rad_s": {
        **dict.fromkeys(
            ("rpm", "1/min", "/min", "min-1", "r/min", "rev/min", "u/min", "unit_minutinver"),
            Conversion(rad_s_from_rpm(1.0)),
        ),
        **dict.fromkeys(
            ("min^-1", "min⁻¹", "revs/min", "tr/min", "obr/min", "об/мин"), Conversion(rad_s_from_rpm(1.0))
        ),
        "rad/s": SAME,
    },
    "m_s": {
        **dict.fromkeys(
            ("km/h", "km/hr", "kmh", "kph", "kmph", "unit_kilometerperhour"), Conversion(m_s_from_km_h(1.0))
        ),
        **dict.fromkeys(("mph", "mi/h"), Conversion(0.44704)),
        "m/s": SAME,
    },
    "pa": {
        **dict.fromkeys(("bar", "unit_bar"), Conversion(pa_from_bar(1.0))),
        **dict.fromkeys(("mbar", "hpa", "unit_millibar"), Conversion(100.0)),
        **dict.fromkeys(("psi", "psig"), Conversion(6894.757)),
        **dict.fromkeys(("mpa", "n/mm2", "n/mm²"), Conversion(1e6)),  # nobody tells millipascal
        **dict.fromkeys(("kgf/cm2", "kgf/cm²", "kgf/cm^2", "kg/cm2", "kg/cm²", "kg/cm^2"), Conversion(98_066.5)),
        "atm": Conversion(101_325.0),
        "kpa": Conversion(1e3),
        "pa": SAME,
    },
    "nm": dict.fromkeys(("nm", "n.m", "n·m", "n*m", "n-m", "unit_newtometer"), SAME)
    | dict.fromkeys(
        ("lbft", "lb-ft", "lb·ft", "lb.ft", "lbf·ft", "lbf-ft", "ftlb", "ft-lb", "ft·lb", "ft-lbs", "ftlbf", "lbfft"),
        Conversion(1.355818),
    )
    | dict.fromkeys(("kgf·m", "kgfm", "kgf-m", "kgf.m", "kgf*m", "kg·m", "kgm"), Conversion(9.80665)),
    "ratio": {**dict.fromkeys(("%", "percent", "unit_percent"), Conversion(0.01)), "": SAME},
    "k": {
        **dict.fromkeys(
            ("degc", "°c", "℃", "c", "deg", "degreesc", "celsius", "unit_degrecelsi"),
            Conversion(offset=k_from_degc(0.0)),
        ),
        **dict.fromkeys(("degf", "°f", "℉", "f", "fahrenheit"), Conversion(5.0 / 9.0, k_from_degc(-160.0 / 9.0))),
        "k": SAME,
    },
    "s": {"ms": Conversion(1e-3), "us": Conversion(1e-6), "s": SAME},
    "m": {
        **dict.fromkeys(("km", "unit_kilometer"), Conversion(1e3)),
        **dict.fromkeys(("m", "unit_meter"), SAME),
        "mi": Conversion(1609.344),
    },
}
"""Spellings of units, without blanks and in lower case, by the unit that ends a canonical signal's name."""

DEGREE: Final = re.compile(r"(?:[^\w/%]|[âïº½]|deg\.?|grad)+(?=[cf]$)")  # before C or F, damaged or as others write it
DAMAGE: Final = re.compile(r"â(?=[²³·°µ])")  # UTF-8 that was read as the code page of Windows
KINDS_OF_UNITS: Final = ("rad_s", "m_s", "ratio", "nm", "pa", "k", "m", "s")  # longest first
SCALED: Final = re.compile(r"(\d+(?:\.\d+)?)(\D.*)")  # 0.1kpa


def kind_of_unit(signal: Signal) -> str | None:
    """Return the SI unit that ends the name of a canonical signal; None of a mere number."""
    return next((kind for kind in KINDS_OF_UNITS if signal.value.endswith(f"_{kind}")), None)


def conversion(kind: str, unit: str) -> Conversion | None:
    """Return the conversion from a unit or a multiple such as ``0.1 kPa``; None if it is of another kind."""
    spelled = DEGREE.sub("°", DAMAGE.sub("", "".join(unit.split()).lower()))
    if (exact := TO_SI[kind].get(spelled)) is not None:
        return exact
    scaled = SCALED.fullmatch(spelled)
    base = TO_SI[kind].get(scaled[2]) if scaled else None
    return base.after(float(scaled[1]), 0.0) if scaled and base else None


USUAL: Final[Mapping[str, tuple[str, ...]]] = {
    "rad_s": ("rpm", "rad/s"),
    "m_s": ("km/h", "mph", "m/s"),
    "pa": ("kPa", "bar", "psi", "Pa"),
    "nm": ("Nm", "lb·ft"),
    "k": ("degC", "degF", "K"),
    "m": ("km",),
    "s": ("ms",),
    "ratio": ("%",),
}
"""Units that a column may be in where nothing says which, the usual one first."""
OF_THE_US: Final = frozenset({"mph", "psi", "lb·ft", "degF"})
LEAST_STEPS: Final = 5
STEP_TOLERANCE: Final = 3e-4  # of a step: what rounding to a few digits leaves of it
STEP_SCATTER, MOST_OFF = 0.05, 0.02  # of a step, by rounding, and of all steps that are none
FEW: Final = 5  # steps from one value to the next: more of them say little of one
SIMPLE_STEPS: Final = np.array(
    [*(2.0**power for power in range(-10, 6)), *(digit * 10.0**power for power in range(-4, 3) for digit in (1, 2, 5))]
)  # of controllers
HOTTEST_K: Final = k_from_degc(110.0)  # that oil is not always above: coolers hold 70 to 100 degC
MOST_ABOVE_COOLANT_K: Final = 15.0  # of oil that is always hotter than the coolant ever is
ROLLING_M: Final = (0.045, 0.18)  # of a car for a radian of the output shaft: .27 m over 5.9 to .5 m over 2.8
LEAST_OUTPUT_RAD_S: Final = 50.0
SLOWEST_IDLE_RAD_S: Final = 40.0  # 380 rpm: no engine of a car or truck idles slower
MOST_SLOW: Final = 0.5  # of the different speeds: an engine that starts or stalls passes few


class ToldStep(NamedTuple):
    """That values are whole steps of a controller's unit, and were told in another one."""

    unit: str  # in which they are told
    size: float  # in it
    native: str  # the same step in the controller's unit


def told_step(values: FloatArray, kind: str) -> ToldStep | None:
    """Return which unit the steps between values show, as .6214 shows whole km/h told in mph; None if none or several.

    Parameters
    ----------
    values : (n,) array
        Different values, rising.
    """
    steps = np.diff(values)
    steps = steps[steps > 1e-9 * np.abs(values).max(initial=0.0)]
    if len(steps) < LEAST_STEPS:
        return None
    counts = np.rint(steps / steps.min())
    short, few = steps[counts <= FEW], counts[counts <= FEW]
    step = float(np.median(short / few))
    is_off = np.abs(short / step - few) > STEP_SCATTER
    if 2 * len(short) < len(steps) or np.mean(is_off) > MOST_OFF or _is_simple(step) is not None:
        return None
    shown = list[ToldStep]()
    for unit in USUAL[kind]:
        for native in USUAL[kind]:
            scale, native_scale = TO_SI[kind]["".join(unit.split()).lower()], TO_SI[kind][native.lower()]
            if unit != native and (simple := _is_simple(step * scale.factor / native_scale.factor)) is not None:
                shown.append(ToldStep(unit, step, f"{simple:g} {native}"))
    return shown[0] if len({step.unit for step in shown}) == 1 else None


def _is_simple(step: float) -> float | None:
    """Return the round number that a step is; None if it is none."""
    nearest = float(SIMPLE_STEPS[np.abs(np.log(SIMPLE_STEPS / step)).argmin()])
    return nearest if abs(step / nearest - 1.0) < STEP_TOLERANCE else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What other columns of a table say of a unit."""

    is_of_the_us: bool = False
    coolant_k: float | None = None  # the highest
    output_rad_s: float | None = None  # likewise

    def doubt(self, signal: Signal, ends: FloatArray) -> str:
        """Return why a signal hardly has this range [SI]; empty if it may."""
        lowest, highest = ends.tolist()
        if signal is Signal.SUMP_TEMPERATURE:
            if self.coolant_k is not None and lowest > self.coolant_k + MOST_ABOVE_COOLANT_K:
                return "it would always be far hotter than the coolant"
            return "it would never be below 110 degC" if lowest > HOTTEST_K else ""
        if signal is Signal.VEHICLE_SPEED and (self.output_rad_s or 0.0) > LEAST_OUTPUT_RAD_S:
            rolled_m = highest / (self.output_rad_s or 1.0)
            is_possible = ROLLING_M[0] < rolled_m < ROLLING_M[1]
            return "" if is_possible else f"a radian of the output shaft would move the car by {rolled_m:.2g} m"
        return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitReading:
    """In which unit a column is read, and which other one is not excluded."""

    unit: str
    why: str = ""  # what speaks for it, where the header does not say it
    other: str = ""  # which contradicts it; empty if nothing does


def reading_of(
    signal: Signal,
    stated_units: tuple[str, str],
    possible: Mapping[str, FloatArray],
    values: FloatArray,
    around: Surroundings,
) -> UnitReading | None:
    """Return in which unit a column is read; None if it is possible in none.

    Parameters
    ----------
    signal
        Which it is.
    stated_units
        The unit in its header, and that at the end of its name; empty if there is none.
    possible
        The range [SI] of its values by each unit in which they are possible.
    values : (n,) array
        Different values, rising.
    around
        What other columns say.
    """
    header, name = stated_units
    step, doubts = told_step(values, kind_of_unit(signal) or "ratio"), dict[str, str]()
    for unit, ends in possible.items():
        is_against = step is not None and conversion_name(unit) != conversion_name(step.unit)
        steps = f"its steps of {step.size:.4g} are {step.native} told in {step.unit}" if step is not None else ""
        doubts[unit] = steps if is_against else around.doubt(signal, ends) or _slow_engine(signal, unit, values)
    sound = [unit for unit in possible if not doubts[unit]]
    stated = header or (name if name in possible else "")
    if stated in possible and not doubts[stated]:
        return UnitReading(unit=stated, why="" if header else "as the name says")
    preferred = [unit for unit in sound if (unit in OF_THE_US) == around.is_of_the_us] or sound or list(possible)
    if stated in possible:
        other = next((unit for unit in preferred if unit != stated), "")
        what = f"{'the header' if header else 'the name'} says {stated}, but {doubts[stated]}"
        if header or not sound:  # whoever wrote a unit row meant it
            return UnitReading(unit=stated, why=what, other=other)
        return UnitReading(unit=other, why=what, other=stated)
    if stated or not preferred:
        return None
    by_steps = step is not None and preferred[0] == step.unit
    why = f"assumed: its steps are {step.native}" if by_steps and step is not None else "assumed: nothing says the unit"
    return UnitReading(unit=preferred[0], why=why)


def _slow_engine(signal: Signal, unit: str, values: FloatArray) -> str:
    """Return why an engine's speeds are hardly in a unit: most of them would be below any idle; empty if they may."""
    convert = conversion("rad_s", unit) if signal is Signal.ENGINE_SPEED else None
    turning = np.empty(0) if convert is None else convert(values[values > 0.0])
    is_slow = len(turning) > LEAST_STEPS and np.mean(turning < SLOWEST_IDLE_RAD_S) > MOST_SLOW
    return "the engine would mostly turn slower than any idles" if is_slow else ""


def conversion_name(unit: str) -> str:
    """Return one spelling for all of a unit."""
    for kind, units in USUAL.items():
        for usual in units:
            if conversion(kind, unit) is not None and conversion(kind, unit) == conversion(kind, usual):
                return usual
    return unit
