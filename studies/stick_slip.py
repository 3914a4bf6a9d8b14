"""Launches that judder: how many of those in which the clutch truly slips again are seen, and how many are made up.

Vehicles are drawn as ``studies.drive_accuracy`` draws them, and driven along public traces with each fluid. A
launch juddered if its clutch slipped by more than 5 rad/s under load after its slip had once ended: in the plant for
the truth, in the sensors' speeds for the service.

    python -m studies.stick_slip
    python -m studies.stick_slip --vehicles 12 us06
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from rich.console import Console
from rich.table import Table

from studies.accuracy import EPOCH_US, to_batch
from studies.drive_accuracy import STRETCH_S, Case, scenario_of
from studies.drive_events import NS_PER_US, is_match, planned
from studies.study import over_drives
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.shift_quality import measure
from diag_service.diagnosis.condition.verdict import JUDDER_RAD_S
from diag_service.diagnosis.events import EndReason, Event, EventKind
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive
from ecu_emulator.truth import EventTruth

FIRST_SEED: Final = 92_000
TRACES: Final = ("udds", "us06", "wltc")
TRUE_RAD_S: Final = 5.0
LEAST_SEEN: Final = 0.90  # of the launches that juddered
MOST_MADE_UP: Final = 0.01  # of those that did not


@dataclass(frozen=True, slots=True, kw_only=True)
class Launch:
    """One launch to lock: largest slip after it had ended once [rad/s], in the plant and as the sensors tell it."""

    fluid: str
    true_rad_s: float
    found_rad_s: float | None  # None: not found as a launch to lock


def launches(case: Case) -> list[Launch]:
    """Drive, and return the launches to lock."""
    scenario, _ = scenario_of(case)
    drive = Drive(scenario, planned=iter([planned(case.trace)]))
    decoder, calibration = Decoder(load_contract(), load_profile()), nominal_calibration()
    finder = DriveFinder(decoder.signals, calibration, decoder.gears)
    events: list[Event] = []
    truths: list[EventTruth] = []
    for stretch in drive.stretches(STRETCH_S):
        batch = to_batch(merge([stretch.frames]))
        events += [event for columns in decoder.stream(batch) for event in finder.feed(columns)]
        truths += [truth for truth in stretch.truths if isinstance(truth, EventTruth)]
    events += finder.flush()
    mine = [one for one in events if one.kind is EventKind.LAUNCH and one.end_reason is EndReason.COMPLETE]
    found = []
    for truth in truths:
        if truth.event == "launch" and truth.is_locked:
            event = next((one for one in mine if is_match(one, truth, EPOCH_US * NS_PER_US)), None)
            found_rad_s = None if event is None else measure(event, calibration).reslip_rad_s
            fluid = scenario.fluid.condition
            found.append(Launch(fluid=fluid, true_rad_s=truth.reslip_rad_s, found_rad_s=found_rad_s))
    return found


def counts(some: Sequence[Launch]) -> tuple[int, int, int, int]:
    """Return how many launches truly juddered, how many of these were seen, how many did not, how many were made up."""
    juddered = [one for one in some if one.true_rad_s > TRUE_RAD_S]
    others = [one for one in some if one.true_rad_s <= TRUE_RAD_S]
    seen, made_up = (sum((one.found_rad_s or 0.0) > JUDDER_RAD_S for one in part) for part in (juddered, others))
    return len(juddered), seen, len(others), made_up


def rows(found: Sequence[Launch]) -> Iterator[tuple[str, ...]]:
    """Yield the table's rows, one for each fluid."""
    for fluid in dict.fromkeys(one.fluid for one in found):
        some = [one for one in found if one.fluid == fluid]
        juddered, seen, others, made_up = counts(some)
        lost = sum(one.found_rad_s is None for one in some)
        yield fluid, str(len(some)), str(lost), f"{seen} of {juddered}", f"{made_up} of {others}"


def main() -> int:
    """Drive all vehicles and print the table; return 1 if too few were seen or too many made up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("traces", nargs="*", default=list(TRACES), metavar="trace", help=f"of {', '.join(TRACES)}")
    parser.add_argument("--vehicles", type=int, default=6, help="for each trace")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first vehicle")
    parser.add_argument("--oil-degc", type=float, default=80.0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    case = partial(Case, oil_degc=options.oil_degc, is_plain=False, has_mismatch=False, loss_ratio=0.0)
    seeds = range(options.seed, options.seed + options.vehicles)
    found = over_drives(
        launches, [case(trace=trace, seed=seed) for trace in options.traces for seed in seeds], options.workers
    )
    table = Table("fluid", "launches to lock", "not found", "juddered, seen", "did not, made up",
                  title=f"Slip above {TRUE_RAD_S:g} rad/s after it had ended once")  # fmt: skip
    for row in rows(found):
        table.add_row(*row)
    console = Console(markup=False, width=110)
    console.print(table)
    juddered, seen, others, made_up = counts(found)
    console.print(f"seen: {seen} of {juddered}, at least {LEAST_SEEN:.0%} wanted")
    console.print(f"made up: {made_up} of {others}, at most {MOST_MADE_UP:.0%} wanted")
    return 0 if seen >= LEAST_SEEN * juddered and made_up <= MOST_MADE_UP * others else 1


if __name__ == "__main__":
    sys.exit(main())
