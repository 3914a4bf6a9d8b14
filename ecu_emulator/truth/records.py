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
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TextIO

import msgspec

from canlog.files import read_small_file
from ecu_emulator.errors import RecordError

MAX_TRUTH_BYTES: Final = 64 * 2**20  # a shift or an event takes half a kilobyte
ROTATED_BYTES: Final = 32 * 2**20  # of an endless drive, some days
_DRIVE: Final = "drive"
_TOTALS: Final = "totals"


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


Happened = ShiftTruth | RevTruth | EventTruth | TripTruth
_KINDS: Final[Mapping[type[Happened], str]] = {
    ShiftTruth: "shift", RevTruth: "rev", EventTruth: "event", TripTruth: "trip"
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

    Raises
    ------
    RecordError
        On construction or writing, if the file system refuses.
    """

    def __init__(self, path: Path, *, most_bytes: int | None = None) -> None:
        self._path = path
        self._drive: DriveTruth | None = None
        self._open()
        is_file = stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)  # and no pipe or device, which must stay
        self._most_bytes = math.inf if most_bytes is None or not is_file else most_bytes

    def _open(self) -> None:
        self._byte_count = 0
        try:
            self._file: TextIO = self._path.open("w", encoding="utf-8")
        except OSError as exc:
            raise RecordError(f"cannot write truth {self._path}: {exc.strerror}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def drive(self, drive: DriveTruth) -> None:
        """Write the first line."""
        self._drive = drive
        self._line(_DRIVE, asdict(drive))

    def write(self, truths: Iterable[Happened]) -> None:
        """Write one line for each of what has happened."""
        for truth in truths:
            if self._byte_count >= self._most_bytes:
                self._begin_anew()
            self._line(_KINDS[type(truth)], asdict(truth))

    def totals(self, totals: Totals) -> None:
        """Write the last line."""
        self._line(_TOTALS, asdict(totals))

    def close(self) -> None:
        """Close the file."""
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
    kept: dict[type[Happened], list[Any]] = {record: [] for record in _KINDS}
    for truth in truths:
        kept[type(truth)].append(truth)
    return TruthLog(
        drive=drive,
        totals=totals,
        shifts=tuple(kept[ShiftTruth]),
        revs=tuple(kept[RevTruth]),
        trips=tuple(kept[TripTruth]),
        events=tuple(kept[EventTruth]),
    )


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
