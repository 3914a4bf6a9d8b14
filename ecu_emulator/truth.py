"""The truth beside a recording: what only the emulator knows, for tests and demos; it never goes onto the bus.

One JSON object per line: the drive (scenario, seed, built vehicle), every completed shift, every rev of a workshop
routine, and the totals.
"""

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TextIO

import numpy as np

from canlog.plain_files import read_small_file
from clutch_model.gears import clutch_of_gear
from ecu_emulator.errors import RecordError
from ecu_emulator.plant.columns import Col
from ecu_emulator.readings import FloatArray
from ecu_emulator.tcu_data import CLOSED_REVS

MAX_TRUTH_BYTES: Final = 64 * 2**20  # a shift takes half a kilobyte
_DRIVE: Final = "drive"
_SHIFT: Final = "shift"
_REV: Final = "rev"
_TOTALS: Final = "totals"
_NEUTRAL: Final = 0
_TEMPERATURE: Final = (Col.CLUTCH1_TEMPERATURE, Col.CLUTCH2_TEMPERATURE)
_MU_C: Final = (Col.MU_C1, Col.MU_C2)
_MU_S: Final = (Col.MU_S1, Col.MU_S2)


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
    duration_s: float
    frames: int
    faults: tuple[FaultTruth, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthLog:
    """The whole truth of one drive; ``totals`` is None if the drive did not end in order."""

    drive: DriveTruth
    shifts: tuple[ShiftTruth, ...]
    totals: Totals | None
    revs: tuple[RevTruth, ...] = ()


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
        shifts = [
            self._shift(rows[start:stop], rows[stop]) for start, stop in zip(edges[::2], edges[1::2], strict=False)
        ]
        self._open = rows[edges[-1] :] if edges.size % 2 else rows[:0]
        return shifts

    def _shift(self, during: FloatArray, after: FloatArray) -> ShiftTruth:
        self._count += 1
        to_gear = int(during[0, Col.TARGET_GEAR])
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


class TruthWriter:
    """Writes a truth file line by line, each flushed: a reader may follow, and a crash loses nothing.

    Raises
    ------
    RecordError
        On construction or writing, if the file system refuses.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file: TextIO = path.open("w", encoding="utf-8")
        except OSError as exc:
            raise RecordError(f"cannot write truth {path}: {exc.strerror}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def drive(self, drive: DriveTruth) -> None:
        """Write the first line."""
        self._line(_DRIVE, asdict(drive))

    def shifts(self, shifts: Iterable[ShiftTruth]) -> None:
        """Write one line per shift."""
        for shift in shifts:
            self._line(_SHIFT, asdict(shift))

    def revs(self, revs: Iterable[RevTruth]) -> None:
        """Write one line per rev."""
        for rev in revs:
            self._line(_REV, asdict(rev))

    def totals(self, totals: Totals) -> None:
        """Write the last line."""
        self._line(_TOTALS, asdict(totals))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _line(self, kind: str, content: Mapping[str, object]) -> None:
        try:
            self._file.write(json.dumps({"kind": kind, **content}) + "\n")
            self._file.flush()
        except OSError as exc:
            with suppress(OSError):  # closing flushes once more what the disk has refused
                self._file.close()
            raise RecordError(f"cannot write truth {self._path}: {exc.strerror}") from exc


def truth_path(recording: Path) -> Path:
    """Return where the truth of a recording lives: ``drive.log`` -> ``drive.log.truth.jsonl``."""
    return recording.with_name(f"{recording.name}.truth.jsonl")


def read_truth(path: Path) -> TruthLog:
    """Read a truth file.

    Raises
    ------
    RecordError
        If the file is missing or is not a truth file.
    """
    try:
        lines = [json.loads(line) for line in read_small_file(path, MAX_TRUTH_BYTES).decode("utf-8").splitlines()]
        by_kind = {
            kind: [_content(line) for line in lines if line["kind"] == kind] for kind in (_DRIVE, _SHIFT, _REV, _TOTALS)
        }
        (drive,) = by_kind[_DRIVE]
        seeds = dict.fromkeys(("vehicle_seed", "drive_seed"), drive["seed"])  # older files have one for both
        totals = [
            Totals(**{**line, "faults": tuple(FaultTruth(**fault) for fault in line.get("faults", ()))})
            for line in by_kind[_TOTALS]
        ]
        return TruthLog(
            drive=DriveTruth(**{**seeds, **drive, "mu_c": tuple(drive["mu_c"]), "mu_s": tuple(drive["mu_s"])}),
            shifts=tuple(ShiftTruth(**line) for line in by_kind[_SHIFT]),
            totals=totals[0] if totals else None,
            revs=tuple(RevTruth(**line) for line in by_kind[_REV]),
        )
    except OSError as exc:
        raise RecordError(f"cannot read truth {path}: {exc.strerror or exc}") from exc
    except (ValueError, KeyError, TypeError) as exc:
        raise RecordError(f"{path} is not a truth file: {exc}") from exc


def _content(line: dict[str, Any]) -> dict[str, Any]:  # JSON is untyped
    return {key: value for key, value in line.items() if key != "kind"}
