"""One shift alone: how far the estimate of a single shift may be from the truth, and what becomes of lying sensors.

Clean shifts: noise only, and with production scatter. Faulty shifts: a second run of a drive in which one sensor at a
time is frozen, offset, drifts or spikes around a shift, each shift estimated from the running state that the clean
drive has reached, so that no fault helps or hides another. "Far" is farther than four stated standard deviations from
the truth in mu_C or mu_S; the total deviation is the stated one, the random one leaves out what all shifts of a vehicle
share and therefore holds without scatter only.

    python -m studies.single_shift
"""

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.accuracy import to_batch
from studies.study import over_drives
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import FrictionEstimate, ShiftEstimate, Status
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario import FluidCondition, Scenario
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import ShiftTruth, TruthLog

DATABASE, PROFILE, CALIBRATION = load_contract(), load_profile(), nominal_calibration()
NOISE_ONLY, SCATTERED = "noise_only", "ideal"
FLUIDS = (FluidCondition.IDEAL, FluidCondition.CASE_1, FluidCondition.CASE_2)  # in turn, seed by seed
FIRST_SEED = 110_000  # checks, limits and priors were chosen on seeds below
CLEAN_CYCLES = 1
FAULTY_CYCLES = 2  # the first shifts of a drive have little to be held against, the last ones enough
FAULT_EVERY = 3  # shifts: a fault ends before the next one begins
FAR_STD = 4.0
NOISE_STD = {
    "engine_torque_nm": 3.0,
    "engine_speed_rad_s": 0.21,
    "hub_speed_rad_s": 0.21,
    "input1_speed_rad_s": 0.21,
    "input2_speed_rad_s": 0.21,
    "clutch1_pressure_pa": 5.0e3,
    "clutch2_pressure_pa": 5.0e3,
}
KINDS = (SensorFaultKind.FROZEN, SensorFaultKind.OFFSET, SensorFaultKind.DRIFT, SensorFaultKind.SPIKE)
SIZES_STD = (3.0, 100.0)  # log-uniform, times the noise; of a drift per second
BEFORE_S, REMAINING_S = 0.6, 0.25  # a fault begins from this long before a shift to this long before its end
NOT_FOUND = "not_found"  # a wrong speed may hide a shift
BRIEF_S, LASTING_S = (0.2, 1.0), 2.0  # half of the faults pass, half outlast the shift


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One drive, with faults or without."""

    scenario: str
    seed: int
    is_faulty: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of one shift."""

    scenario: str
    kind: SensorFaultKind | None
    quantity: str
    size_std: float
    reasons: tuple[str, ...]  # why it was not accepted; empty if it was
    off_random_std: float  # largest error of mu_C and mu_S in stated random deviations; NaN without an estimate
    off_total_std: float

    @property
    def is_accepted(self) -> bool:
        """Whether the shift entered the running state."""
        return not self.reasons

    def is_far(self, *, random: bool) -> bool:
        """Return whether an estimate was accepted that is far from the truth."""
        off = self.off_random_std if random else self.off_total_std
        return self.is_accepted and off > FAR_STD


def stages_from(state: Posterior) -> Stages:
    """Return the stages of the service with a running state."""
    return Stages(Decoder(DATABASE, PROFILE), CALIBRATION, state, ConditionMemory.fresh())


def shifts_of(scenario: Scenario) -> tuple[list[Event], TruthLog]:
    """Drive a scenario in memory and return its shifts as the service finds them."""
    frames, truth = frames_of(scenario)
    return stages_from(Posterior.fresh(CALIBRATION)).segment(to_batch(frames)), truth


def scenario_of(case: Case) -> Scenario:
    """Return the drive of a case, without faults."""
    plain = load_scenario(case.scenario)
    fluid = replace(plain.fluid, condition=FLUIDS[case.seed % len(FLUIDS)])
    cycles = FAULTY_CYCLES if case.is_faulty else CLEAN_CYCLES
    return replace(plain, seed=case.seed, cycles=cycles, fluid=fluid)


def drawn_fault(shift: ShiftTruth, rng: np.random.Generator) -> SensorFault:
    """Draw a fault of any kind and sensor that touches a shift."""
    kind = KINDS[rng.integers(len(KINDS))]
    quantity = list(NOISE_STD)[rng.integers(len(NOISE_STD))]
    size_std = math.exp(rng.uniform(*np.log(SIZES_STD))) * rng.choice((-1.0, 1.0))
    start_s = rng.uniform(max(0.0, shift.t_start_s - BEFORE_S), shift.t_end_s - REMAINING_S)
    duration_s = rng.uniform(*BRIEF_S) if rng.random() < 0.5 else LASTING_S
    return SensorFault(
        quantity=quantity,
        kind=kind,
        size=0.0 if kind is SensorFaultKind.FROZEN else float(size_std * NOISE_STD[quantity]),
        start_s=float(start_s),
        duration_s=float(duration_s),
    )


def errors_std(friction: FrictionEstimate | None, truth: ShiftTruth) -> tuple[float, float]:
    """Return the larger error of both parameters in stated random and total deviations."""
    if friction is None:
        return math.nan, math.nan
    errors = (abs(friction.mu_c - truth.mu_c), abs(friction.mu_s - truth.mu_s))
    random, total = (
        max(error / std for error, std in zip(errors, stds, strict=True))
        for stds in (
            (friction.random_std_mu_c, friction.random_std_mu_s),
            (friction.std_mu_c, friction.std_mu_s),
        )
    )
    return random, total


def outcome(case: Case, estimate: ShiftEstimate, truth: ShiftTruth, fault: SensorFault | None) -> Outcome:
    """Compare the estimate of one shift with its truth."""
    random, total = errors_std(estimate.friction, truth)
    is_plain = estimate.status is Status.VALID and not estimate.reasons
    return Outcome(
        scenario=case.scenario,
        kind=fault.kind if fault else None,
        quantity=fault.quantity if fault else "",
        size_std=fault.size / NOISE_STD[fault.quantity] if fault else 0.0,
        reasons=() if is_plain else estimate.reasons,
        off_random_std=random,
        off_total_std=total,
    )


def unseen(case: Case, fault: SensorFault) -> Outcome:
    """Return what became of a shift that its fault hid."""
    return Outcome(
        scenario=case.scenario,
        kind=fault.kind,
        quantity=fault.quantity,
        size_std=fault.size / NOISE_STD[fault.quantity],
        reasons=(NOT_FOUND,),
        off_random_std=math.nan,
        off_total_std=math.nan,
    )


def outcomes(case: Case) -> list[Outcome]:
    """Make one drive, and one with faults if the case asks for it, and return what became of its shifts."""
    scenario = scenario_of(case)
    events, truth = shifts_of(scenario)
    stages = stages_from(Posterior.fresh(CALIBRATION))
    diagnoses = [stages.conclude(event) for event in events]
    if not case.is_faulty:
        pairs = zip(diagnoses, truth.shifts, strict=True)
        return [outcome(case, diagnosis.estimate, shift, None) for diagnosis, shift in pairs]
    states = [Posterior.fresh(CALIBRATION), *(diagnosis.state for diagnosis in diagnoses)]
    rng = np.random.default_rng(case.seed)
    faults = {row: drawn_fault(truth.shifts[row], rng) for row in range(case.seed % FAULT_EVERY, len(events), 3)}
    faulty, _ = shifts_of(replace(scenario, sensor_faults=tuple(faults.values())))
    found = {row: _same(events[row], faulty) for row in faults}
    return [
        unseen(case, fault)
        if (event := found[row]) is None
        else outcome(case, stages_from(states[row]).conclude(event).estimate, truth.shifts[row], fault)
        for row, fault in faults.items()
    ]


def _same(event: Event, others: Sequence[Event]) -> Event | None:
    """Return what was found of an event although a sensor was wrong; None: nothing."""
    overlapping = (one for one in others if one.start_ns < event.end_ns and event.start_ns < one.end_ns)
    return next(overlapping, None)


def cases_of(clean: int, faulty: int, first_seed: int) -> list[Case]:
    """Return drives enough for so many clean shifts of each scenario, and so many faulty ones of each."""
    clean_drives = math.ceil(clean / (10 * CLEAN_CYCLES))
    faulty_drives = math.ceil(faulty / (10 * FAULTY_CYCLES // FAULT_EVERY))
    return [
        Case(scenario=scenario, seed=first_seed + k + 1000 * is_faulty, is_faulty=is_faulty)
        for scenario in (NOISE_ONLY, SCATTERED)
        for is_faulty, count in ((False, clean_drives), (True, faulty_drives))
        for k in range(count)
    ]


def share(rows: Sequence[Outcome], tells: Callable[[Outcome], bool]) -> str:
    """Return a count and its percentage."""
    count = sum(map(tells, rows))
    return f"{count} ({100.0 * count / max(1, len(rows)):.2f} %)"


def line(name: str, rows: Sequence[Outcome]) -> str:
    """Return one line of the table."""
    return (
        f"{name:<34}{len(rows):>6}  {share(rows, lambda one: not one.is_accepted):>15}"
        f"  {share(rows, lambda one: one.is_far(random=False)):>13}"
        f"  {share(rows, lambda one: one.is_far(random=True)):>13}"
    )


def reasons_line(rows: Iterable[Outcome]) -> str:
    """Return how often each reason was given."""
    given = [reason for row in rows for reason in row.reasons]
    return ", ".join(f"{reason} {given.count(reason)}" for reason in sorted(set(given))) or "none"


def report(rows: Sequence[Outcome]) -> Iterator[str]:
    """Yield the lines of the report."""
    head = f"{'shifts':>40}  {'not accepted':>15}  {'far, total':>13}  {'far, random':>13}"
    for scenario in (NOISE_ONLY, SCATTERED):
        own = [row for row in rows if row.scenario == scenario]
        clean, faulty = ([row for row in own if (row.kind is None) is is_clean] for is_clean in (True, False))
        yield from ("", f"Scenario {scenario}", head, line("clean", clean), line("with a sensor fault", faulty))
        yield from (line(f"  {kind}", [row for row in faulty if row.kind is kind]) for kind in KINDS)
        yield from (line(f"  {name}", [row for row in faulty if row.quantity == name]) for name in NOISE_STD)
        yield f"reasons, clean: {reasons_line(clean)}"
        yield f"reasons, faulty: {reasons_line(faulty)}"


def main() -> int:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clean", type=int, default=2000, help="clean shifts of each scenario")
    parser.add_argument("--faulty", type=int, default=600, help="faulty shifts of each scenario")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    rows = over_drives(outcomes, cases_of(arguments.clean, arguments.faulty, arguments.first_seed), arguments.jobs)
    print(
        f"Single shifts, seeds from {arguments.first_seed}; faults of {SIZES_STD[0]:.0f} to {SIZES_STD[1]:.0f} times "
        f"the noise; far: accepted, and more than {FAR_STD:.0f} stated deviations from the truth in mu_C or mu_S"
    )
    print("\n".join(report(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
