"""Value tables of signals, compiled: from raw values to the codes of their texts."""

import numpy as np
import numpy.typing as npt
from cantools.database.can.signal import Signal

from canlog.decode.bit_fields import PayloadWords
from canlog.decode.signal_table import SignalTable
from canlog.decode.value_codes import FloatCode

Int32Array = npt.NDArray[np.int32]
NAMELESS = -1


class ValueTexts:
    """The value table of one signal, compiled: a code for each value, and the names that codes stand for."""

    def __init__(self, signal: Signal, table: SignalTable) -> None:
        low, high = table.field.raw_limits
        choices = {raw: str(text) for raw, text in (signal.choices or {}).items()}
        self._table = table
        self._raws = sorted(raw for raw in choices if isinstance(table.code, FloatCode) or low <= raw <= high)
        self.names = tuple(dict.fromkeys(choices[raw] for raw in self._raws))
        self._codes = np.array([self.names.index(choices[raw]) for raw in self._raws], np.int32)

    def codes(self, words: PayloadWords) -> Int32Array:
        """Return for every payload the place of its text in ``names``, NAMELESS where the value has none."""
        raw = self._table.field.raw(words)
        if not self._raws:
            return np.full(len(raw), NAMELESS, np.int32)
        code = self._table.code
        number = code.raw_number(raw.view(np.uint64)) if isinstance(code, FloatCode) else raw
        known = np.array(self._raws, number.dtype)
        place = np.minimum(np.searchsorted(known, number), len(known) - 1)
        return np.where(known[place] == number, self._codes[place], np.int32(NAMELESS))
