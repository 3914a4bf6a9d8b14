"""The truth beside a recording: what only the emulator knows, for tests and demos; it never goes onto the bus.

One JSON object per line: the drive (scenario, seed, built vehicle), every trip, every event of a drive on the road,
every completed shift, every rev of a workshop routine, and the totals.
"""

import json
import math
import os
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self, TextIO

import msgspec
import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.files import read_small_file
from clutch_model.calibration import clutch_of_gear
from ecu_emulator.driving.indices import LockUpState, ManoeuvreKind
from ecu_emulator.errors import RecordError
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS

MAX_TRUTH_BYTES: Final = 64 * 2**20  # a shift or an event takes half a kilobyte
ROTATED_BYTES: Final = 32 * 2**20  # of an endless drive, some days
_DRIVE: Final = "drive"
_TOTALS: Final = "totals"


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseTruth:
    """Something that is wrong with the car throughout a drive."""

    kind: str
    strength: float  # 1: the smallest that matters
    clutch: int | None  # 1 or 2; None: it is of no single clutch
    changes: Mapping[str, float]  # what it makes of the car: factors, of names in *_pa, *_n and *_nm what it adds


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTruth:
    """What is true for the whole drive."""

    scenario: str
    vehicle: str
    seed: int
    vehicle_seed: int  # what stays with the car was drawn from this one
    drive_seed: int  # what changes from drive to drive from this one
    cycles: int
    fluid: str
    mu_c: tuple[float, float]  # per clutch, at the start
    mu_s: tuple[float, float]
    drawn: Mapping[str, float]  # production scatter of this vehicle
    effects: Mapping[str, float] = field(default_factory=dict)  # unknown to the service's model, if switched on
    drive: str = "cycle"
    odometer_m: float | None = None  # at its start; None in older files
    mu_at_slip_rpm: Mapping[int, float] = field(default_factory=dict)  # of a lock-up clutch, as the drive begins
    causes: tuple[CauseTruth, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TripTruth:
    """One trip on the road, as it begins."""

    number: int  # 1, 2, ... within the drive
    trace: str  # name of its speed trace
    t_start_s: float
    parked_s: float  # before it
    distance_m: float  # that the trace leads
    oil_temperature_k: float
    coolant_temperature_k: float
    mu_c: tuple[float, float]  # per clutch
    mu_s: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftTruth:
    """One completed shift and the friction of the clutch that engaged in it."""

    number: int  # 1, 2, ... within the drive
    t_start_s: float  # first millisecond with target gear != current gear
    t_end_s: float  # first millisecond with both equal again
    from_gear: int
    to_gear: int
    clutch: int  # 1 or 2, the on-coming one
    mu_c: float
    mu_s: float
    clutch_temperature_k: float  # mean over the shift


@dataclass(frozen=True, slots=True, kw_only=True)
class EventTruth:
    """One event that has ended. Slip counts while the clutch is pressed; a drag of open plates is none."""

    number: int  # 1, 2, ... within the drive
    event: str  # name of its `EventKind`
    t_start_s: float  # its first millisecond
    t_end_s: float  # the first millisecond after it
    from_gear: int
    to_gear: int  # of a launch, a creep and an aborted change: the gear it began with
    clutch: int  # 1 or 2, the one that did more work of friction
    peak_slip_rad_s: float  # of that clutch, as are the next two
    slip_energy_j: float
    reslip_rad_s: float  # largest slip after it had ended once: stick-slip, or a load that pulls the clutch open
    other_slip_energy_j: float
    is_locked: bool  # the clutch of the gear reached sticks at the end, or slips by less than 1 rad/s under load
    is_aborted: bool
    mu_c: float
    mu_s: float
    clutch_temperature_k: float  # at the start
    clutch_end_temperature_k: float
    oil_temperature_k: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ShudderTruth:
    """One stretch of shudder of a lock-up clutch that slips under control."""

    number: int  # 1, 2, ... within the drive
    t_start_s: float
    t_end_s: float
    gear: int
    frequency_hz: float
    amplitude_rad_s: float  # of the slip, the largest one


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultTruth:
    """One scripted fault that has begun."""

    what: str  # quantity or message that it concerns, or the whole bus
    kind: str
    size: float  # of a sensor fault in the quantity's unit, of a drift per second; of a bus fault the share of frames
    t_start_s: float
    t_end_s: float | None  # None: to the end of the drive
    count: int  # readings that it touched, frames that it struck or added


@dataclass(frozen=True, slots=True, kw_only=True)
class RevTruth:
    """One rev in neutral of the workshop routine."""

    number: int  # 1, 2, ... within the drive
    t_start_s: float  # first millisecond with the pedal down
    t_end_s: float  # first millisecond with the engine slow again
    are_clutches_closed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Totals:
    """What a whole drive amounted to."""

    shifts: int
    events: int = 0
    duration_s: float  # of scenario time
    slipping_s: float = 0.0  # of a lock-up clutch, under control
    driven_s: float = 0.0  # without the time for which the car was parked
    frames: int
    faults: tuple[FaultTruth, ...] = ()
    odometer_m: float | None = None  # at its end, from which the next drive may go on; None in older files


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthLog:
    """The whole truth of one drive; ``totals`` is None if the drive did not end in order."""

    drive: DriveTruth
    shifts: tuple[ShiftTruth, ...]
    totals: Totals | None
    revs: tuple[RevTruth, ...] = ()
    trips: tuple[TripTruth, ...] = ()
    events: tuple[EventTruth, ...] = ()
    shudders: tuple[ShudderTruth, ...] = ()


Happened = ShiftTruth | RevTruth | EventTruth | TripTruth | ShudderTruth
_KINDS: Final[Mapping[type[Happened], str]] = {
    ShiftTruth: "shift", RevTruth: "rev", EventTruth: "event", TripTruth: "trip", ShudderTruth: "shudder",
}  # fmt: skip


def known_at_s(truth: Happened) -> float:
    """Return the scenario time [s] at which something can be told: a trip as it begins, all else when it has ended."""
    return truth.t_start_s if isinstance(truth, TripTruth) else truth.t_end_s


class TruthWriter:
    """Writes a truth file line by line, each flushed: a reader may follow, and a crash loses nothing.

    Parameters
    ----------
    path
        The file.
    most_bytes
        From this size on a new file is begun, with the line of the drive at its head; the one before is kept with
        ``.1`` behind its name, those before that are gone. None: one file, however long.
    place
        Where it is written instead, until somebody lets that take its place.

    Raises
    ------
    RecordError
        On construction or writing, if the file system refuses.
    """

    def __init__(self, path: Path, *, most_bytes: int | None = None, place: Path | None = None) -> None:
        self._path, self._place = path, place or path
        self._drive: DriveTruth | None = None
        self._open()
        is_file = stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)  # and no pipe or device, which must stay
        self._most_bytes = math.inf if most_bytes is None or not is_file else most_bytes

    def _open(self) -> None:
        self._byte_count = 0
        try:
            self._file: TextIO = self._place.open("w", encoding="utf-8")
        except OSError as exc:
            raise RecordError(f"cannot write truth {self._path}: {exc.strerror}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def drive(self, drive: DriveTruth) -> None:
        self._drive = drive
        self._line(_DRIVE, asdict(drive))

    def write(self, truths: Iterable[Happened]) -> None:
        """Write one line for each of what has happened."""
        for truth in truths:
            if self._byte_count >= self._most_bytes:
                self._begin_anew()
            self._line(_KINDS[type(truth)], asdict(truth))

    def totals(self, totals: Totals) -> None:
        self._line(_TOTALS, asdict(totals))

    def close(self) -> None:
        self._file.close()

    def _begin_anew(self) -> None:
        self.close()
        try:
            self._path.replace(self._path.with_name(f"{self._path.name}.1"))
        except OSError as exc:
            raise RecordError(f"cannot write truth {self._path}: {exc.strerror}") from exc
        self._open()
        if self._drive is not None:
            self.drive(self._drive)

    def _line(self, kind: str, content: Mapping[str, object]) -> None:
        line = json.dumps({"kind": kind, **content}) + "\n"
        self._byte_count += len(line)
        try:
            self._file.write(line)
            self._file.flush()
        except OSError as exc:
            with suppress(OSError):  # closing flushes once more what the disk has refused
                self._file.close()
            raise RecordError(f"cannot write truth {self._path}: {exc.strerror}") from exc


def truth_path(recording: Path) -> Path:
    """Return where the truth of a recording lives: ``drive.log`` -> ``drive.log.truth.jsonl``."""
    return recording.with_name(f"{recording.name}.truth.jsonl")


def truth_log(drive: DriveTruth, truths: Iterable[Happened], totals: Totals | None) -> TruthLog:
    """Return the whole truth of a drive, sorted by what kind of thing happened."""
    kept: dict[str, list[Any]] = {f"{kind}s": [] for kind in _KINDS.values()}
    for truth in truths:
        kept[f"{_KINDS[type(truth)]}s"].append(truth)
    return TruthLog(drive=drive, totals=totals, **{name: tuple(found) for name, found in kept.items()})


def read_truth(path: Path) -> TruthLog:
    """Read a truth file.

    Raises
    ------
    RecordError
        If the file is missing or is not a truth file.
    """
    try:
        lines = [json.loads(line) for line in read_small_file(path, MAX_TRUTH_BYTES).decode("utf-8").splitlines()]
        (drive,) = (line for line in lines if line["kind"] == _DRIVE)
        seeds = dict.fromkeys(("vehicle_seed", "drive_seed"), drive["seed"])  # older files have one for both
        totals = [msgspec.convert(line, Totals) for line in lines if line["kind"] == _TOTALS]
        happened = [
            msgspec.convert(line, record) for record, kind in _KINDS.items() for line in lines if line["kind"] == kind
        ]
        return truth_log(msgspec.convert({**seeds, **drive}, DriveTruth), happened, totals[0] if totals else None)
    except OSError as exc:
        raise RecordError(f"cannot read truth {path}: {exc.strerror or exc}") from exc
    except (ValueError, KeyError, TypeError) as exc:
        raise RecordError(f"{path} is not a truth file: {exc}") from exc


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
            event=ManoeuvreKind(int(last[Col.EVENT_KIND])).name.lower(),
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


BLOCK_ROWS: Final = 500  # in which shudder is looked for
SHUDDER_HZ: Final = (5.0, 20.0)
SHUDDER_RAD_S: Final = 1.0  # 10 rpm: less is not felt


class ShudderWatcher:
    """Finds shudder in plant rows of a lock-up clutch: its slip, while it is under control, swings in the band."""

    def __init__(self) -> None:
        self._block = np.empty((0, len(Col)))  # rows of the block that has begun
        self._running: list[tuple[float, float, float]] = []  # begin [s], frequency, amplitude of each block
        self._gear = 0
        self._count = 0
        self.slipping_s = 0.0

    def feed(self, rows: FloatArray) -> list[ShudderTruth]:
        """Return the shudder that ends within these rows, shape (n, len(Col)), following those of the call before."""
        rows, ended = np.concatenate((self._block, rows)), []
        whole = len(rows) // BLOCK_ROWS * BLOCK_ROWS
        for start in range(0, whole, BLOCK_ROWS):
            ended += self._look(rows[start : start + BLOCK_ROWS])
        self._block = rows[whole:].copy()
        return ended

    def finish(self) -> list[ShudderTruth]:
        """Return the shudder that a trip's end cuts off, if there is one."""
        self._block = self._block[:0]
        return self._ended()

    def _look(self, block: FloatArray) -> list[ShudderTruth]:
        is_slipping = block[:, Col.LOCKUP_STATE] == LockUpState.SLIPPING
        self.slipping_s += float(is_slipping.sum()) * _ROW_S
        place = np.linspace(-1.0, 1.0, BLOCK_ROWS)
        slip_rad_s = block[:, Col.HUB_SPEED] - block[:, Col.INPUT1_SPEED]
        swing = slip_rad_s - np.polyval(np.polyfit(place, slip_rad_s, 2), place)
        amplitude_rad_s = math.sqrt(2.0) * float(swing.std())
        frequency_hz = np.count_nonzero(np.diff(np.signbit(swing))) / (2.0 * BLOCK_ROWS * _ROW_S)
        is_in_band = SHUDDER_HZ[0] <= frequency_hz <= SHUDDER_HZ[1]
        if not (is_slipping.all() and is_in_band and amplitude_rad_s > SHUDDER_RAD_S):
            return self._ended()
        ended = self._ended() if self._gear != block[0, Col.CURRENT_GEAR] else []
        self._gear = int(block[0, Col.CURRENT_GEAR])
        self._running.append((round(float(block[0, Col.T_S]), 3), frequency_hz, amplitude_rad_s))
        return ended

    def _ended(self) -> list[ShudderTruth]:
        running, self._running = self._running, []
        if not running:
            return []
        self._count += 1
        starts_s, frequencies_hz, amplitudes_rad_s = zip(*running, strict=True)
        return [
            ShudderTruth(
                number=self._count,
                t_start_s=starts_s[0],
                t_end_s=round(starts_s[-1] + BLOCK_ROWS * _ROW_S, 3),
                gear=self._gear,
                frequency_hz=float(np.mean(frequencies_hz)),
                amplitude_rad_s=max(amplitudes_rad_s),
            )
        ]
