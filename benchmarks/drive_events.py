"""Events that the service finds on the emulator's drives, beside the truth: which it misses, which it makes up.

Eight drives: the public traces and city traffic, warm and cold. A gear change or launch counts as found if an event of
the right sort overlaps it by half of the shorter of both. Slip under load is that of the plant, not of the sensors.

    python -m benchmarks.drive_events
    python -m benchmarks.drive_events us06 udds
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.accuracy import EPOCH_US, to_batch
from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_model.units import k_from_degc
from dbc.contract import load_contract
from diag_service.diagnosis.events import EndReason, Event, EventKind
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.build import build_vehicle
from ecu_emulator.drive_names import DriveName
from ecu_emulator.driving.public_traces import public_trace
from ecu_emulator.driving.trips import PlannedTrip, trips
from ecu_emulator.event_watcher import PRESSED_NM
from ecu_emulator.frames import merge
from ecu_emulator.plant import Col
from ecu_emulator.recording import Drive
from ecu_emulator.road import WHOLE_STAY_S, journey
from ecu_emulator.scenario import Ambient
from ecu_emulator.scenario_file import load_scenario
from ecu_emulator.truth import EventTruth

CITY_SEED: Final = 77
SLIP_RAD_S: Final = 5.0
STRETCH_S: Final = 60.0
ROW_S: Final = 1e-3
OVERLAP: Final = 0.5
NS_PER_S: Final = 1e9
NS_PER_US: Final = 1000
WARM_DEGC: Final = 80.0
WITHOUT_GEARS: Final = frozenset({"launch", "creep", "closing"})  # kinds of the truth
SLIP_KINDS: Final = frozenset({EventKind.LAUNCH, EventKind.CREEP, EventKind.CLOSING, EventKind.SLIP})
DRIVES: Final = {
    "wltc": WARM_DEGC, "udds": WARM_DEGC, "hwfet": WARM_DEGC, "us06": WARM_DEGC,
    "city": WARM_DEGC, "wltc cold": 0.0, "udds cold": -10.0, "city cold": 20.0,
}  # fmt: skip
LEAST: Final = {"gear changes found": 1.0, "launches to lock found": 0.98}  # least shares


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What was found of one drive."""

    name: str
    true: Counter[str]  # by kind
    found: Counter[str]  # of those
    same_kind: Counter[str]  # of those found
    made_up: Counter[str]  # events found where there was none, by kind
    launches_to_lock: tuple[int, int]  # found to lock, true
    slip_s: tuple[float, float]  # under load, within events, all
    slip_by_kind_s: Counter[str] = field(default_factory=Counter)  # within events, by kind found


def planned(name: str) -> PlannedTrip:
    """Return the trip of a drive."""
    trace = name.partition(" ")[0]
    if trace == DriveName.CITY:
        return next(trips(DriveName.CITY, CITY_SEED))
    return PlannedTrip(trace=public_trace(trace), parked_s=0.0)


def driven(name: str) -> tuple[list[Event], list[EventTruth], BoolArray]:
    """Return events found, true ones, and when a clutch slipped under load, every millisecond."""
    oil_k = k_from_degc(DRIVES[name])
    ambient = Ambient(temperature_k=min(oil_k, 293.15), oil_temperature_k=oil_k, coolant_temperature_k=oil_k)
    scenario = replace(load_scenario("noise_only"), drive=DriveName.CITY, ambient=ambient)
    drive = Drive(scenario, planned=iter([planned(name)]))
    again = journey(scenario, build_vehicle(scenario), WHOLE_STAY_S, iter([planned(name)]))  # the same, to look inside
    decoder = Decoder(load_contract(), load_profile())
    finder = DriveFinder(decoder.signals, nominal_calibration(), decoder.gears)
    events: list[Event] = []
    truths: list[EventTruth] = []
    slips: list[BoolArray] = []
    for stretch in drive.stretches(STRETCH_S):
        batch = to_batch(merge([stretch.frames]))
        events += [event for columns in decoder.stream(batch) for event in finder.feed(columns)]
        truths += [truth for truth in stretch.truths if isinstance(truth, EventTruth)]
        slips.append(slipping(again.advance(STRETCH_S)))
    return events + finder.flush(), truths, np.concatenate(slips)


def slipping(rows: FloatArray) -> BoolArray:
    """Return in which rows of the plant a pressed clutch slips."""
    hub = rows[:, Col.HUB_SPEED]
    first, second = (
        (np.abs(rows[:, torque] - rows[:, drag]) > PRESSED_NM) & (np.abs(hub - rows[:, shaft]) > SLIP_RAD_S)
        for torque, drag, shaft in (
            (Col.CLUTCH1_TORQUE, Col.VISCOUS1_TORQUE, Col.INPUT1_SPEED),
            (Col.CLUTCH2_TORQUE, Col.VISCOUS2_TORQUE, Col.INPUT2_SPEED),
        )
    )
    return first | second


def overlap_s(event: Event, truth: EventTruth, start_ns: int) -> float:
    """Return how long an event found and a true one last together [s]; below zero: how far they are apart."""
    first_s, last_s = (event.start_ns - start_ns) / NS_PER_S, (event.end_ns - start_ns) / NS_PER_S
    return min(last_s, truth.t_end_s) - max(first_s, truth.t_start_s)


def is_match(event: Event, truth: EventTruth, start_ns: int) -> bool:
    """Return whether an event found is a true one: both with a change of gears or both without, at the same time."""
    is_change = truth.event not in WITHOUT_GEARS
    if is_change is (event.kind in SLIP_KINDS) or event.from_gear != truth.from_gear:
        return False
    shorter_s = min((event.end_ns - event.start_ns) / NS_PER_S, truth.t_end_s - truth.t_start_s)
    return overlap_s(event, truth, start_ns) >= OVERLAP * shorter_s


def compared(name: str) -> Comparison:
    """Drive, find and compare."""
    events, truths, slips = driven(name)
    start_ns = EPOCH_US * NS_PER_US
    matches = [[event for event in events if is_match(event, truth, start_ns)] for truth in truths]
    pairs = [(truth, found) for truth, found in zip(truths, matches, strict=True) if found]
    used = {event.number for found in matches for event in found}
    to_lock = [(truth, found) for truth, found in zip(truths, matches, strict=True)
               if truth.event == "launch" and truth.is_locked]  # fmt: skip
    locked = sum(any(event.end_reason is EndReason.COMPLETE for event in found) for _, found in to_lock)
    within = np.zeros(len(slips), np.bool_)
    by_kind: Counter[str] = Counter()
    for event in events:
        first, last = (max(round((t_ns - start_ns) / NS_PER_S / ROW_S), 0) for t_ns in (event.start_ns, event.end_ns))
        within[first:last] = True
        by_kind[event.kind] += int(np.count_nonzero(slips[first:last]))
    return Comparison(
        name=name,
        true=Counter(truth.event for truth in truths),
        found=Counter(truth.event for truth, _ in pairs),
        same_kind=Counter(truth.event for truth, found in pairs if any(one.kind == truth.event for one in found)),
        made_up=Counter(event.kind.value for event in events if event.number not in used),
        launches_to_lock=(locked, len(to_lock)),
        slip_s=(float(np.count_nonzero(slips & within)) * ROW_S, float(np.count_nonzero(slips)) * ROW_S),
        slip_by_kind_s=Counter({kind: count * ROW_S for kind, count in by_kind.items()}),
    )


def shares(comparisons: Sequence[Comparison]) -> Iterator[tuple[str, int, int]]:
    """Yield what was to be found, how many of it were, and how many there are."""
    kinds = [kind for one in comparisons for kind in one.true if kind not in WITHOUT_GEARS]
    found, true = (sum(counts[kind] for counts in all_of for kind in set(kinds)) for all_of in (
        [one.found for one in comparisons], [one.true for one in comparisons]))  # fmt: skip
    yield "gear changes found", found, true
    locked = np.sum([one.launches_to_lock for one in comparisons], axis=0).tolist()
    yield "launches to lock found", locked[0], locked[1]


def tables(comparisons: Sequence[Comparison]) -> Iterator[Table]:
    """Yield a table of drives and one of kinds."""
    drives = Table("drive", "gear changes", "launches to lock", "slip under load", "within events", "made up",
                   title="Events found, of those true")  # fmt: skip
    for one in comparisons:
        (_, found, true), (_, locked, launches) = shares([one])
        made_up = ", ".join(f"{count} {kind}" for kind, count in one.made_up.items())
        share = one.slip_s[0] / one.slip_s[1]
        drives.add_row(
            one.name, f"{found} of {true}", f"{locked} of {launches}", f"{one.slip_s[1]:.1f} s", f"{share:.1%}",
            made_up or "none",
        )  # fmt: skip
    yield drives
    total: dict[str, Counter[str]] = {
        name: sum((getattr(one, name) for one in comparisons), Counter())
        for name in ("true", "found", "same_kind", "made_up", "slip_by_kind_s")
    }
    kinds = Table("kind", "true", "found", "of the same kind", "made up", "slip within", title="By kind, all drives")
    for kind in sorted(total["true"].keys() | total["made_up"].keys()):
        cells = (str(total[name][kind]) for name in ("true", "found", "same_kind", "made_up"))
        kinds.add_row(kind.replace("_", " "), *cells, f"{total['slip_by_kind_s'][kind]:.1f} s")
    yield kinds


def main() -> int:
    """Print both tables; return 1 if less was found than must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drives", nargs="*", default=list(DRIVES), metavar="drive", help=f"of {', '.join(DRIVES)}")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    if unknown := set(options.drives) - set(DRIVES):
        parser.error(f"no drive {min(unknown)}")
    with ProcessPoolExecutor(options.workers) as pool:
        comparisons = list(pool.map(compared, options.drives))
    console = Console(markup=False, width=130)
    for table in tables(comparisons):
        console.print(table)
    kept = True
    for name, found, true in shares(comparisons):
        is_met = found >= LEAST[name] * true
        console.print(f"{name}: {found} of {true}, at least {LEAST[name]:.0%}: {'met' if is_met else 'MISSED'}")
        kept &= is_met
    within_s, all_s = np.sum([one.slip_s for one in comparisons], axis=0).tolist()
    console.print(f"slip under load within events: {within_s:.0f} of {all_s:.0f} s, {within_s / all_s:.1%}")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
