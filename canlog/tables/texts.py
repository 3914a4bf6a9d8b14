"""The texts of value tables, column by column: a code for each value and the names that codes stand for."""

from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt
from cantools.database.can.signal import Signal

from canlog.decode.bit_fields import PayloadWords
from canlog.decode.signal_table import SignalTable
from canlog.decode.value_codes import FloatCode

Int32Array = npt.NDArray[np.int32]
NAMELESS: Final = -1


class Values(StrEnum):
    """What is written for a value that has a name in the database."""

    NUMBERS = "numbers"  # the number
    TEXTS = "texts"  # the name
    BOTH = "both"


class ValueTexts:
    """The value table of one signal, compiled.

    Parameters
    ----------
    signal : Signal
        One with a value table.
    table : SignalTable
        The same signal, compiled.
    """

    def __init__(self, signal: Signal, table: SignalTable) -> None:
        low, high = table.field.raw_limits
        choices = {raw: str(text) for raw, text in (signal.choices or {}).items()}
        raws = sorted(raw for raw in choices if isinstance(table.code, FloatCode) or low <= raw <= high)
        self._table = table
        self._raws = raws
        self.names: tuple[str, ...] = tuple(dict.fromkeys(choices[raw] for raw in raws))
        place = {name: code for code, name in enumerate(self.names)}
        self._codes = np.array([place[choices[raw]] for raw in raws], np.int32)

    def codes(self, words: PayloadWords) -> Int32Array:
        """Return for every payload the place of its text in ``names``, NAMELESS where the value has none."""
        if not self._raws:
            return np.full(len(words), NAMELESS, np.int32)
        raw = self._table.field.raw(words)
        code = self._table.code
        number = code.raw_number(raw.view(np.uint64)) if isinstance(code, FloatCode) else raw
        known = np.array(self._raws, number.dtype)
        place = np.minimum(np.searchsorted(known, number), len(known) - 1)
        return np.where(known[place] == number, self._codes[place], np.int32(NAMELESS))
