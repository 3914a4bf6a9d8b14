"""Events that the service finds on the emulator's drives, beside the truth: which it misses, makes up and uses.

Eight drives, the public traces and city traffic, warm and cold, with three fluids each. A gear change or launch counts
as found if an event of the right sort overlaps it by half of the shorter of both. Slip under load is that of the plant,
not of the sensors; it is used within an event whose friction enters the running estimate. The torque of a downshift is
the mean of its slipping clutches over their slip.

    python -m studies.drive_events
    python -m studies.drive_events us06 udds --fluids ideal
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

from studies.accuracy import EPOCH_US, FLUIDS, to_batch
from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_model.units import k_from_degc
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.events import SLIPS_IN_GEAR, EndReason, Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import Status
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.build import WHOLE_STAY_S, build_vehicle, journey
from ecu_emulator.drive.recording import Drive
from ecu_emulator.driving.journey import PlannedTrip, trips
from ecu_emulator.driving.trace import public_trace
from ecu_emulator.plant import Col
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario import Ambient, FluidCondition
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import PRESSED_NM, EventTruth

CITY_SEED: Final = 77
SLIP_RAD_S: Final = 5.0
STRETCH_S: Final = 60.0
ROW_S: Final = 1e-3
OVERLAP: Final = 0.5
NS_PER_S: Final = 1e9
NS_PER_US: Final = 1000
WARM_DEGC: Final = 80.0
WITHOUT_GEARS: Final = frozenset({"launch", "creep", "closing"})  # kinds of the truth
DRIVES: Final = {
    "wltc": WARM_DEGC, "udds": WARM_DEGC, "hwfet": WARM_DEGC, "us06": WARM_DEGC,
    "city": WARM_DEGC, "wltc cold": 0.0, "udds cold": -10.0, "city cold": 20.0,
}  # fmt: skip
HIGH_NM: Final = 100.0  # of a downshift under power that must be used
DOWNSHIFTS: Final = frozenset({"power_on_downshift", "kickdown", "power_on_skip"})  # kinds of the truth
LEAST: Final = {  # least shares
    "gear changes found": 1.0,
    "launches to lock found": 0.98,
    "downshifts under power above 100 Nm used": 0.85,
    "seconds of slip under load used": 0.75,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What was found of one drive."""

    name: str
    true: Counter[str]  # by kind
    found: Counter[str]  # of those
    same_kind: Counter[str]  # of those found
    made_up: Counter[str]  # events found where there was none, by kind
    launches_to_lock: tuple[int, int]  # found to lock, true
    downshifts: tuple[int, int]  # under power, above 100 Nm: used, true
    slip_s: tuple[float, float, float]  # under load: within events that are used, within events, all
    window_s: float  # slip windows of the events that are used
    slip_by_kind_s: Counter[str] = field(default_factory=Counter)  # within events, by kind found


def planned(name: str) -> PlannedTrip:
    """Return the trip of a drive."""
    trace = name.partition(" ")[0]
    if trace == DriveName.CITY:
        return next(trips(DriveName.CITY, CITY_SEED))
    return PlannedTrip(trace=public_trace(trace), parked_s=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Driven:
    """One drive."""

    events: list[Event]
    windows_s: list[float]  # slip window of each that is used, zero of the others
    truths: list[EventTruth]
    slips: BoolArray  # whether a clutch slips under load, every millisecond
    torque_nm: FloatArray  # of the clutch that does, likewise


def driven(name: str, fluid: FluidCondition) -> _Driven:
    """Drive, and diagnose what is driven."""
    oil_k = k_from_degc(DRIVES[name])
    ambient = Ambient(temperature_k=min(oil_k, 293.15), oil_temperature_k=oil_k, coolant_temperature_k=oil_k)
    base = load_scenario("noise_only")
    scenario = replace(base, drive=DriveName.CITY, ambient=ambient, fluid=replace(base.fluid, condition=fluid))
    drive = Drive(scenario, planned=iter([planned(name)]))
    again = journey(scenario, build_vehicle(scenario), WHOLE_STAY_S, iter([planned(name)]))  # the same, to look inside
    calibration = nominal_calibration()
    stages = Stages(
        Decoder(load_contract(), load_profile()), calibration, Posterior.fresh(calibration), ConditionMemory.fresh()
    )
    events: list[Event] = []
    windows_s: list[float] = []
    truths: list[EventTruth] = []
    parts: list[FloatArray] = []
    for stretch in drive.stretches(STRETCH_S):
        found = stages.segment(to_batch(merge([stretch.frames])))
        events += found
        windows_s += [_window_s(stages, event) for event in found]
        truths += [truth for truth in stretch.truths if isinstance(truth, EventTruth)]
        parts.append(slipping_nm(again.advance(STRETCH_S)))
    found = stages.flush()
    torque_nm = np.concatenate(parts)
    return _Driven(
        events=events + found,
        windows_s=windows_s + [_window_s(stages, event) for event in found],
        truths=truths,
        slips=torque_nm > 0.0,
        torque_nm=torque_nm,
    )


def _window_s(stages: Stages, event: Event) -> float:
    """Return the length of an event's slip window if its friction enters the running estimate, else 0 [s]."""
    estimate = stages.conclude(event).estimate
    return estimate.window_s if estimate.status is Status.VALID and not estimate.reasons else 0.0


def slipping_nm(rows: FloatArray) -> FloatArray:
    """Return what pressed clutches that slip carry together in rows of the plant [N m], zero where none does."""
    hub = rows[:, Col.HUB_SPEED]
    total_nm = np.zeros(len(rows))
    for torque, drag, shaft in (
        (Col.CLUTCH1_TORQUE, Col.VISCOUS1_TORQUE, Col.INPUT1_SPEED),
        (Col.CLUTCH2_TORQUE, Col.VISCOUS2_TORQUE, Col.INPUT2_SPEED),
    ):
        is_pressed = np.abs(rows[:, torque] - rows[:, drag]) > PRESSED_NM
        does_slip = np.abs(hub - rows[:, shaft]) > SLIP_RAD_S
        total_nm += np.where(is_pressed & does_slip, np.abs(rows[:, torque]), 0.0)
    return total_nm


def overlap_s(event: Event, truth: EventTruth, start_ns: int) -> float:
    """Return how long an event found and a true one last together [s]; below zero: how far they are apart."""
    first_s, last_s = (event.start_ns - start_ns) / NS_PER_S, (event.end_ns - start_ns) / NS_PER_S
    return min(last_s, truth.t_end_s) - max(first_s, truth.t_start_s)


def is_match(event: Event, truth: EventTruth, start_ns: int) -> bool:
    """Return whether an event found is a true one: both with a change of gears or both without, at the same time."""
    is_change = truth.event not in WITHOUT_GEARS
    if is_change is (event.kind in SLIPS_IN_GEAR) or event.from_gear != truth.from_gear:
        return False
    shorter_s = min((event.end_ns - event.start_ns) / NS_PER_S, truth.t_end_s - truth.t_start_s)
    return overlap_s(event, truth, start_ns) >= OVERLAP * shorter_s


def compared(case: tuple[str, FluidCondition]) -> Comparison:
    """Drive, find and compare."""
    name, fluid = case
    drive = driven(name, fluid)
    events, truths, slips = drive.events, drive.truths, drive.slips
    start_ns = EPOCH_US * NS_PER_US
    matches = [[event for event in events if is_match(event, truth, start_ns)] for truth in truths]
    pairs = [(truth, found) for truth, found in zip(truths, matches, strict=True) if found]
    matched = {event.number for found in matches for event in found}
    used = {event.number for event, window_s in zip(events, drive.windows_s, strict=True) if window_s > 0.0}
    to_lock = [(truth, found) for truth, found in zip(truths, matches, strict=True)
               if truth.event == "launch" and truth.is_locked]  # fmt: skip
    locked = sum(any(event.end_reason is EndReason.COMPLETE for event in found) for _, found in to_lock)
    down = [found for truth, found in zip(truths, matches, strict=True) if _is_high_downshift(drive, truth)]
    within, within_used = (np.zeros(len(slips), np.bool_) for _ in range(2))
    by_kind: Counter[str] = Counter()
    for event in events:
        first, last = (max(round((t_ns - start_ns) / NS_PER_S / ROW_S), 0) for t_ns in (event.start_ns, event.end_ns))
        within[first:last] = True
        within_used[first:last] |= event.number in used
        by_kind[event.kind] += int(np.count_nonzero(slips[first:last]))
    return Comparison(
        name=f"{name}, {fluid}",
        true=Counter(truth.event for truth in truths),
        found=Counter(truth.event for truth, _ in pairs),
        same_kind=Counter(truth.event for truth, found in pairs if any(one.kind == truth.event for one in found)),
        made_up=Counter(event.kind.value for event in events if event.number not in matched),
        launches_to_lock=(locked, len(to_lock)),
        downshifts=(sum(any(event.number in used for event in found) for found in down), len(down)),
        slip_s=(_seconds(slips & within_used), _seconds(slips & within), _seconds(slips)),
        window_s=sum(drive.windows_s),
        slip_by_kind_s=Counter({kind: count * ROW_S for kind, count in by_kind.items()}),
    )


def _seconds(is_so: BoolArray) -> float:
    return float(np.count_nonzero(is_so)) * ROW_S


def _is_high_downshift(drive: _Driven, truth: EventTruth) -> bool:
    """Return whether an event is a downshift under power whose clutches carry much while they slip."""
    if truth.event not in DOWNSHIFTS or truth.to_gear >= truth.from_gear:
        return False
    rows = slice(round(truth.t_start_s / ROW_S), round(truth.t_end_s / ROW_S))
    slips = drive.slips[rows]
    return bool(slips.any() and drive.torque_nm[rows][slips].mean() > HIGH_NM)


def shares(comparisons: Sequence[Comparison]) -> Iterator[tuple[str, float, float]]:
    """Yield what was to be found or used, how much of it was, and how much there is."""
    kinds = [kind for one in comparisons for kind in one.true if kind not in WITHOUT_GEARS]
    found, true = (sum(counts[kind] for counts in all_of for kind in set(kinds)) for all_of in (
        [one.found for one in comparisons], [one.true for one in comparisons]))  # fmt: skip
    changes, launches, downshifts, slip_used = LEAST
    yield changes, found, true
    yield launches, *np.sum([one.launches_to_lock for one in comparisons], axis=0).tolist()
    yield downshifts, *np.sum([one.downshifts for one in comparisons], axis=0).tolist()
    used_s, _, all_s = np.sum([one.slip_s for one in comparisons], axis=0).tolist()
    yield slip_used, used_s, all_s


def tables(comparisons: Sequence[Comparison]) -> Iterator[Table]:
    """Yield a table of drives and one of kinds."""
    drives = Table("drive, fluid", "gear changes", "launches to lock", "down above 100 Nm used", "slip under load",
                   "within events", "used", "windows", "made up", title="Events found, of those true")  # fmt: skip
    for one in comparisons:
        counts = [f"{found:.0f} of {true:.0f}" for _, found, true in list(shares([one]))[:3]]
        made_up = ", ".join(f"{count} {kind}" for kind, count in one.made_up.items())
        used_s, within_s, all_s = one.slip_s
        drives.add_row(
            one.name, *counts, f"{all_s:.1f} s", f"{within_s / all_s:.1%}", f"{used_s / all_s:.1%}",
            f"{one.window_s / all_s:.1%}", made_up or "none",
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
    parser.add_argument("--fluids", nargs="+", default=list(FLUIDS), choices=list(FLUIDS))
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    if unknown := set(options.drives) - set(DRIVES):
        parser.error(f"no drive {min(unknown)}")
    cases = [(name, FluidCondition(fluid)) for name in options.drives for fluid in options.fluids]
    with ProcessPoolExecutor(options.workers) as pool:
        comparisons = list(pool.map(compared, cases))
    console = Console(markup=False, width=150)
    for table in tables(comparisons):
        console.print(table)
    kept = True
    for name, found, true in shares(comparisons):
        is_met = found >= LEAST[name] * true
        console.print(
            f"{name}: {found:.0f} of {true:.0f}, {found / max(true, 1.0):.1%}, at least {LEAST[name]:.0%}: "
            f"{'met' if is_met else 'MISSED'}"
        )
        kept &= is_met
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
