"""The truth found in the plant's rows: shifts of the cycle, revs of the workshop routine, events on the road."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import clutch_of_gear
from ecu_emulator.driving.indices import EventKind
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS
from ecu_emulator.truth.records import EventTruth, RevTruth, ShiftTruth

_NEUTRAL: Final = 0
_TEMPERATURE: Final = (Col.CLUTCH1_TEMPERATURE, Col.CLUTCH2_TEMPERATURE)
_MU_C: Final = (Col.MU_C1, Col.MU_C2)
_MU_S: Final = (Col.MU_S1, Col.MU_S2)
PRESSED_NM: Final = 2.0  # contact torque from which a clutch counts as slipping under load
BEGUN_SLIP_RAD_S: Final = 5.0  # beyond it slip has begun: a clutch may stick or hardly slip as its event starts
STOPPED_SLIP_RAD_S: Final = 1.0  # below it the slip counts as ended; what comes after it is slip once more
_ROW_S: Final = 1e-3
_TORQUE: Final = (Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE)
_DRAG: Final = (Col.VISCOUS1_TORQUE, Col.VISCOUS2_TORQUE)
_SHAFT_SPEED: Final = (Col.INPUT1_SPEED, Col.INPUT2_SPEED)
_STICK: Final = (Col.STICK1, Col.STICK2)


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


@dataclass(slots=True)
class _Slip:
    """What one clutch has done in the event that is running."""

    peak_rad_s: float = 0.0
    energy_j: float = 0.0
    reslip_rad_s: float = 0.0
    has_begun: bool = False
    has_ended: bool = False

    def feed(self, rows: FloatArray, clutch: int) -> None:
        slip_rad_s = np.abs(rows[:, Col.HUB_SPEED] - rows[:, _SHAFT_SPEED[clutch]])
        torque_nm = rows[:, _TORQUE[clutch]]
        is_pressed = np.abs(torque_nm - rows[:, _DRAG[clutch]]) > PRESSED_NM
        pressed_rad_s = np.where(is_pressed, slip_rad_s, 0.0)
        self.peak_rad_s = max(self.peak_rad_s, float(pressed_rad_s.max()))
        self.energy_j += float(np.abs(torque_nm) @ pressed_rad_s) * _ROW_S
        self.reslip_rad_s = max(self.reslip_rad_s, float(self._slip_again(pressed_rad_s, is_pressed).max(initial=0.0)))

    def _slip_again(self, pressed_rad_s: FloatArray, is_pressed: BoolArray) -> FloatArray:
        """Return the slip from when it had begun and ended, none before that."""
        start = 0
        if not self.has_begun:
            begun = pressed_rad_s > BEGUN_SLIP_RAD_S
            self.has_begun = bool(begun.any())
            start = int(begun.argmax()) if self.has_begun else len(begun)
        if not self.has_ended:
            ended = is_pressed[start:] & (pressed_rad_s[start:] < STOPPED_SLIP_RAD_S)
            self.has_ended = bool(ended.any())
            start += int(ended.argmax()) if self.has_ended else len(ended)
        return pressed_rad_s[start:]


@dataclass(slots=True)
class _Running:
    """An event that has begun."""

    first: FloatArray  # its first row
    last: FloatArray
    slips: tuple[_Slip, _Slip] = field(default_factory=lambda: (_Slip(), _Slip()))

    def feed(self, rows: FloatArray) -> None:
        for clutch, slip in enumerate(self.slips):
            slip.feed(rows, clutch)
        self.last = rows[-1].copy()


class EventWatcher:
    """Finds the events in plant rows, however these are cut into chunks; memory does not grow with an event."""

    def __init__(self) -> None:
        self._running: _Running | None = None
        self._count = 0

    def feed(self, rows: FloatArray) -> list[EventTruth]:
        """Return the events that end within these rows, shape (n, len(Col)), which follow those of the call before."""
        if not len(rows):
            return []
        numbers = rows[:, Col.EVENT_NUMBER]
        edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(rows)]
        ended = []
        for start, stop in pairwise(edges):
            stretch = rows[start:stop]
            if self._running is not None and self._running.first[Col.EVENT_NUMBER] != stretch[0, Col.EVENT_NUMBER]:
                ended.append(self._finished(self._running, stretch[0]))
                self._running = None
            if stretch[0, Col.EVENT_NUMBER] == 0.0:
                continue
            if self._running is None:
                self._running = _Running(first=stretch[0].copy(), last=stretch[-1])
            self._running.feed(stretch)
        return ended

    def finish(self) -> list[EventTruth]:
        """Return the event that a trip's end cuts off, if there is one."""
        running, self._running = self._running, None
        return [] if running is None else [self._finished(running, running.last)]

    def _finished(self, running: _Running, after: FloatArray) -> EventTruth:
        self._count += 1
        first, last, slips = running.first, running.last, running.slips
        to_gear = int(after[Col.CURRENT_GEAR])
        index = int(slips[1].energy_j > slips[0].energy_j)
        return EventTruth(
            number=self._count,
            event=EventKind(int(last[Col.EVENT_KIND])).name.lower(),
            t_start_s=round(float(first[Col.T_S]), 3),
            t_end_s=round(float(after[Col.T_S]), 3),
            from_gear=int(first[Col.CURRENT_GEAR]),
            to_gear=to_gear,
            clutch=index + 1,
            peak_slip_rad_s=slips[index].peak_rad_s,
            slip_energy_j=slips[index].energy_j,
            reslip_rad_s=slips[index].reslip_rad_s,
            other_slip_energy_j=slips[1 - index].energy_j,
            is_locked=to_gear > 0 and _is_locked(after, clutch_of_gear(to_gear) - 1),
            is_aborted=bool(last[Col.IS_ABORTED]),
            mu_c=float(last[_MU_C[index]]),
            mu_s=float(last[_MU_S[index]]),
            clutch_temperature_k=float(first[_TEMPERATURE[index]]),
            clutch_end_temperature_k=float(last[_TEMPERATURE[index]]),
            oil_temperature_k=float(first[Col.SUMP_TEMPERATURE]),
        )


def _is_locked(row: FloatArray, clutch: int) -> bool:
    """Tell whether a pressed clutch sticks, or is about to."""
    is_pressed = abs(row[_TORQUE[clutch]] - row[_DRAG[clutch]]) > PRESSED_NM
    slip_rad_s = abs(row[Col.HUB_SPEED] - row[_SHAFT_SPEED[clutch]])
    return bool(row[_STICK[clutch]]) or bool(is_pressed and slip_rad_s < STOPPED_SLIP_RAD_S)
