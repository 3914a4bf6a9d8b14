"""The truth beside a recording: what only the emulator knows, for tests and demos; it never goes onto the bus.

One JSON object per line: the drive (scenario, seed, built vehicle), every trip, every event of a drive on the road,
every completed shift, every rev of a workshop routine, and the totals.
"""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, Self, TextIO, TypeVar

import msgspec
import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.files import read_small_file
from clutch_model.calibration import clutch_of_gear
from ecu_emulator.driving.indices import LockUpState, ManoeuvreKind
from ecu_emulator.errors import RecordError
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS

MAX_TRUTH_BYTES: Final = 512 * 2**20  # a shift or an event takes half a kilobyte


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
    """One fault that has begun: a scripted one, or one that somebody asked for."""

    what: str  # quantity, message or clutch that it concerns, or the whole bus or transmission
    kind: str
    size: float  # in the unit, of a drift per second; share of frames; strength of what is wrong with the car
    t_start_s: float
    t_end_s: float | None  # None: to the end of the drive
    count: int  # readings that it touched, frames that it struck or added; 0 of what is wrong with the car itself


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
_HAPPENED: Final[Mapping[type[Any], str]] = {
    ShiftTruth: "shift", RevTruth: "rev", EventTruth: "event", TripTruth: "trip", ShudderTruth: "shudder",
}  # fmt: skip
_KINDS: Final[Mapping[type[Any], str]] = {DriveTruth: "drive", Totals: "totals", **_HAPPENED}


def known_at_s(truth: Happened) -> float:
    """Return the scenario time [s] at which something can be told: a trip as it begins, all else when it has ended."""
    return truth.t_start_s if isinstance(truth, TripTruth) else truth.t_end_s


class TruthWriter:
    """Writes a truth file line by line, each flushed: a reader may follow, and a crash loses nothing.

    Parameters
    ----------
    path
        The file.
    place
        Where it is written instead, until somebody lets that take its place.

    Raises
    ------
    RecordError
        On construction or writing, if the file system refuses.
    """

    def __init__(self, path: Path, *, place: Path | None = None) -> None:
        self._path = path
        try:
            self._file: TextIO = (place or path).open("w", encoding="utf-8")
        except OSError as exc:
            raise RecordError(f"cannot write truth {path}: {exc.strerror}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, *truths: Happened | DriveTruth | Totals) -> None:
        """Write one line for each."""
        try:
            for truth in truths:
                self._file.write(json.dumps({"kind": _KINDS[type(truth)], **asdict(truth)}) + "\n")
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
    by_kind: dict[str, list[Any]] = {f"{kind}s": [] for kind in _HAPPENED.values()}
    for truth in truths:
        by_kind[f"{_HAPPENED[type(truth)]}s"].append(truth)
    return TruthLog(drive=drive, totals=totals, **{name: tuple(records) for name, records in by_kind.items()})


def read_truth(path: Path) -> TruthLog:
    """Read a truth file.

    Raises
    ------
    RecordError
        If the file is missing or is not a truth file.
    """
    try:
        lines = [json.loads(line) for line in read_small_file(path, MAX_TRUTH_BYTES).decode("utf-8").splitlines()]
        (drive,) = (line for line in lines if line["kind"] == "drive")
        seeds = dict.fromkeys(("vehicle_seed", "drive_seed"), drive["seed"])  # older files have one for both
        totals = [msgspec.convert(line, Totals) for line in lines if line["kind"] == "totals"]
        records = _HAPPENED.items()
        happened = [msgspec.convert(line, record) for record, kind in records for line in lines if line["kind"] == kind]
        return truth_log(msgspec.convert({**seeds, **drive}, DriveTruth), happened, totals[0] if totals else None)
    except OSError as exc:
        raise RecordError(f"cannot read truth {path}: {exc.strerror or exc}") from exc
    except (ValueError, KeyError, TypeError) as exc:
        raise RecordError(f"{path} is not a truth file: {exc}") from exc


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
TruthT = TypeVar("TruthT", ShiftTruth, RevTruth, EventTruth)


class _SpanWatcher(ABC, Generic[TruthT]):
    """Finds spans of plant rows, in which a label stays the same and is not 0, however the rows are cut into chunks."""

    def __init__(self) -> None:
        self._span: list[FloatArray] = []  # rows of the span that has begun
        self._label = 0.0
        self._count = 0

    def feed(self, rows: FloatArray) -> list[TruthT]:
        """Return what ends within these rows, shape (n, len(Col)), which follow those of the call before."""
        labels: FloatArray = self._labels(rows)
        truths: list[TruthT] = []
        edges = [*np.flatnonzero(np.diff(labels, prepend=math.nan)).tolist(), len(rows)]
        for start, stop in pairwise(edges):
            if self._span and labels[start] != self._label:
                truths += self._ended(rows[start])
            self._label = float(labels[start])
            if self._label != 0.0:
                self._span.append(rows[start:stop])
        return truths

    def finish(self) -> list[TruthT]:
        """Return what the end of a trip cuts off, if that counts."""
        return self._ended(self._span[-1][-1]) if self._span else []

    def _ended(self, after: FloatArray) -> list[TruthT]:
        truth = self._truth(self._count + 1, np.concatenate(self._span), after)
        self._span = []
        self._count += truth is not None
        return [] if truth is None else [truth]

    @abstractmethod
    def _labels(self, rows: FloatArray) -> FloatArray:
        """Return the label of each row, shape (n,)."""

    @abstractmethod
    def _truth(self, number: int, during: FloatArray, after: FloatArray) -> TruthT | None:
        """Return the truth of a span by its rows, shape (n, len(Col)), and the row behind it; None if it is none."""


class ShiftWatcher(_SpanWatcher[ShiftTruth]):
    """Finds the completed shifts."""

    def _labels(self, rows: FloatArray) -> FloatArray:
        current, target = rows[:, Col.CURRENT_GEAR], rows[:, Col.TARGET_GEAR]
        return np.where(current != 0.0, target != current, 0.0)

    def _truth(self, number: int, during: FloatArray, after: FloatArray) -> ShiftTruth | None:
        from_gear, to_gear = int(during[0, Col.CURRENT_GEAR]), int(after[Col.CURRENT_GEAR])
        if to_gear in {0, from_gear}:
            return None
        index = clutch_of_gear(to_gear) - 1
        return ShiftTruth(
            number=number,
            t_start_s=round(float(during[0, Col.T_S]), 3),
            t_end_s=round(float(after[Col.T_S]), 3),
            from_gear=from_gear,
            to_gear=to_gear,
            clutch=index + 1,
            mu_c=float(during[-1, _MU_C[index]]),
            mu_s=float(during[-1, _MU_S[index]]),
            clutch_temperature_k=float(np.mean(during[:, _TEMPERATURE[index]])),
        )


class RevWatcher(_SpanWatcher[RevTruth]):
    """Finds the revs of the workshop routine."""

    def _labels(self, rows: FloatArray) -> FloatArray:
        return rows[:, Col.REV]

    def _truth(self, number: int, during: FloatArray, after: FloatArray) -> RevTruth:
        return RevTruth(
            number=number,
            t_start_s=round(float(during[0, Col.T_S]), 3),
            t_end_s=round(float(after[Col.T_S]), 3),
            are_clutches_closed=bool(during[0, Col.ROUTINE] == CLOSED_REVS),
        )


class EventWatcher(_SpanWatcher[EventTruth]):
    """Finds the events of a drive on the road."""

    def _labels(self, rows: FloatArray) -> FloatArray:
        return rows[:, Col.EVENT_NUMBER]

    def _truth(self, number: int, during: FloatArray, after: FloatArray) -> EventTruth:
        first, last, slips = during[0], during[-1], (_slip(during, 0), _slip(during, 1))
        to_gear = int(after[Col.CURRENT_GEAR])
        index = int(slips[1].energy_j > slips[0].energy_j)
        return EventTruth(
            number=number,
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


class _Slip(NamedTuple):
    """What one clutch does in an event."""

    peak_rad_s: float
    energy_j: float
    reslip_rad_s: float  # largest slip after it had begun and ended


def _slip(rows: FloatArray, clutch: int) -> _Slip:
    slip_rad_s = np.abs(rows[:, Col.HUB_SPEED] - rows[:, _SHAFT_SPEED[clutch]])
    torque_nm = rows[:, _TORQUE[clutch]]
    is_pressed = np.abs(torque_nm - rows[:, _DRAG[clutch]]) > PRESSED_NM
    pressed_rad_s = np.where(is_pressed, slip_rad_s, 0.0)
    begin = _first(pressed_rad_s > BEGUN_SLIP_RAD_S)
    end = begin + _first(is_pressed[begin:] & (pressed_rad_s[begin:] < STOPPED_SLIP_RAD_S))
    return _Slip(
        peak_rad_s=float(pressed_rad_s.max()),
        energy_j=float(np.abs(torque_nm) @ pressed_rad_s) * _ROW_S,
        reslip_rad_s=float(pressed_rad_s[end:].max(initial=0.0)),
    )


def _first(flags: BoolArray) -> int:
    """Return the place of the first flag that is set, the number of flags if none is."""
    return int(flags.argmax()) if flags.any() else len(flags)


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
