"""Shifts of the cycle and revs of the workshop routine, found in the plant's rows."""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.gears import clutch_of_gear
from ecu_emulator.plant.columns import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS
from ecu_emulator.truth.records import RevTruth, ShiftTruth

_NEUTRAL: Final = 0
_TEMPERATURE: Final = (Col.CLUTCH1_TEMPERATURE, Col.CLUTCH2_TEMPERATURE)
_MU_C: Final = (Col.MU_C1, Col.MU_C2)
_MU_S: Final = (Col.MU_S1, Col.MU_S2)


class ShiftWatcher:
    """Finds the completed shifts in plant rows, however these are cut into chunks."""

    def __init__(self) -> None:
        self._open = np.empty((0, len(Col)))  # rows of the shift that has begun
        self._count = 0

    def feed(self, rows: FloatArray) -> list[ShiftTruth]:
        """Return the shifts that end within these rows, shape (n, len(Col)), which follow those of the call before."""
        rows = np.concatenate((self._open, rows))
        current, target = rows[:, Col.CURRENT_GEAR], rows[:, Col.TARGET_GEAR]
        is_shifting = (target != current) & (current != _NEUTRAL)
        edges = np.flatnonzero(np.diff(is_shifting, prepend=False))
        spans = zip(edges[::2], edges[1::2], strict=False)
        shifts = [
            self._shift(rows[start:stop], rows[stop])
            for start, stop in spans
            if current[stop] not in {_NEUTRAL, current[start]}
        ]
        self._open = rows[edges[-1] :] if edges.size % 2 else rows[:0]
        return shifts

    def finish(self) -> list[ShiftTruth]:
        """Forget the shift that the end of a trip cuts off."""
        self._open = self._open[:0]
        return []

    def _shift(self, during: FloatArray, after: FloatArray) -> ShiftTruth:
        self._count += 1
        to_gear = int(after[Col.CURRENT_GEAR])
        index = clutch_of_gear(to_gear) - 1
        return ShiftTruth(
            number=self._count,
            t_start_s=round(float(during[0, Col.T_S]), 3),
            t_end_s=round(float(after[Col.T_S]), 3),
            from_gear=int(during[0, Col.CURRENT_GEAR]),
            to_gear=to_gear,
            clutch=index + 1,
            mu_c=float(during[-1, _MU_C[index]]),
            mu_s=float(during[-1, _MU_S[index]]),
            clutch_temperature_k=float(np.mean(during[:, _TEMPERATURE[index]])),
        )


class RevWatcher:
    """Finds the revs of the workshop routine in plant rows, however these are cut into chunks."""

    def __init__(self) -> None:
        self._rev = 0.0  # number within its stage of the rev that has begun, 0 if none has
        self._start_s = 0.0
        self._is_closed = False
        self._count = 0

    def feed(self, rows: FloatArray) -> list[RevTruth]:
        """Return the revs that end within these rows, shape (n, len(Col)), which follow those of the call before."""
        revs = []
        for row in rows[np.diff(rows[:, Col.REV], prepend=self._rev) != 0.0]:
            t_s = round(float(row[Col.T_S]), 3)
            if self._rev != 0.0:
                self._count += 1
                revs.append(
                    RevTruth(
                        number=self._count, t_start_s=self._start_s, t_end_s=t_s, are_clutches_closed=self._is_closed
                    )
                )
            self._rev = float(row[Col.REV])
            self._start_s = t_s
            self._is_closed = bool(row[Col.ROUTINE] == CLOSED_REVS)
        return revs

    def finish(self) -> list[RevTruth]:
        """Return nothing: a rev that is not over is none."""
        return []
