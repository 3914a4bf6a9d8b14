"""Names of columns, as programs for owners of cars write them: which quantity each is, and the unit it may end in."""

import re
import tomllib
from functools import cache
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

from diag_service.diagnosis.columns import Signal

NAMES_PATH: Final = Path(__file__).with_name("names.toml")
WORD: Final = re.compile(r"\d+|[A-ZÄÖÜ]+(?![a-zäöü])|[A-ZÄÖÜ]?[a-zäöü]+")
BRACKETS: Final = re.compile(r"\([^)]*\)|\[[^\]]*\]")
UNITS: Final = {
    "rpm": "rpm", "nm": "Nm", "lbft": "lb·ft", "ftlb": "lb·ft", "psi": "psi", "kpa": "kPa", "bar": "bar",
    "mbar": "mbar", "c": "degC", "degc": "degC", "f": "degF", "degf": "degF", "kph": "km/h", "kmh": "km/h",
    "mph": "mph", "pct": "%", "percent": "%", "ms": "ms", "km": "km",
}  # fmt: skip
"""Units that names end in, such as ``tcc_slip_rpm``."""

Words = frozenset[str]


class Name(NamedTuple):
    """What a name of a column says."""

    words: Words
    unit: str  # at its end; empty if there is none


class NameTable(NamedTuple):
    """The table of names, ready to be looked up in."""

    phrases: dict[str, str]
    idle: frozenset[str]
    words: dict[str, str]  # what a word stands for
    signals: dict[Words, Signal]


@cache
def name_table() -> NameTable:
    """Return the shipped table."""
    table = tomllib.loads(NAMES_PATH.read_text(encoding="utf-8"))
    signals = dict[Words, Signal]()
    for signal, names in table["names"].items():
        for name in names:
            choices = [(word[:-1], "") if word.endswith("?") else (word,) for word in name.split()]
            for words in product(*choices):
                signals[frozenset(words) - {""}] = Signal(signal)
    spellings = {spelling: word for word, variants in table["words"].items() for spelling in variants}
    return NameTable(table["phrases"], frozenset(table["idle"]), spellings, signals)


@cache
def read_name(text: str) -> Name:
    """Return the words of a name and the unit at its end."""
    table = name_table()
    text = BRACKETS.sub(" ", text.partition("\\")[0])  # behind a backslash a measurement names the controller
    parts = [word.lower() for word in WORD.findall(text.replace("lb-ft", "lbft").replace("ft-lb", "ftlb"))]
    spelled = " ".join(parts)
    for phrase, word in table.phrases.items():
        spelled = spelled.replace(phrase, word)
    parts = spelled.split()
    unit = UNITS.get(parts[-1], "") if len(parts) > 1 else ""
    bare = parts[:-1] if unit else parts
    if unit == "rpm" and not {"speed", "slip", "spd"} & set(bare):
        bare = parts  # rpm is the quantity, too
    words = frozenset(bare) - table.idle
    if words != {"rpm"}:
        words = frozenset(table.words.get(word, word) for word in words)
    return Name(words, unit)


def named_signal(text: str) -> Signal | None:
    """Return the quantity that a name is listed for, None if it is not."""
    return name_table().signals.get(read_name(text).words)


def before_converter(signal: Signal) -> Signal:
    """Return which quantity it is in a vehicle with a torque converter: the input of its gearbox is the turbine."""
    return Signal.TURBINE_SPEED if signal is Signal.INPUT_SPEED else signal
