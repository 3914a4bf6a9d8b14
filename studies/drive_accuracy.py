"""Friction found on drives of vehicles that nobody has calibrated: error, stated deviation and coverage as events come.

Each vehicle is drawn as ``studies.self_calibration`` draws it (torque gain, offset, inertia, piston areas, pressure
zeros, touch points, latencies) and driven once along a trace, with one of three fluids. It goes the whole way in
memory: plant, sensors, frames, decoding, events, estimate, verdict, beginning with what is known of the type. Moments
are counted in events that were used. *Scale-free* is friction times gain and piston area, which driving can tell.
*Slip under load* is that of the plant, in seconds; it is used within an event whose friction enters the estimate.

    python -m studies.drive_accuracy --vehicles 30                   # warm UDDS, uncalibrated
    python -m studies.drive_accuracy --trace wltc --oil-degc -10
    python -m studies.drive_accuracy --mismatch --loss 0.05
    python -m studies.drive_accuracy --row "w_S x 1.5" --oil-degc 85  # one effect of studies.mismatch
    python -m studies.drive_accuracy --other-laws --oil-degc -10     # open packs, oil and film obey other laws
    python -m studies.drive_accuracy --loss 0.05 --burst 3           # three frames of a message are lost in a row
    python -m studies.drive_accuracy --transmission gs7              # a seven-speed transmission
"""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import BoolArray, FloatArray
from canlog.frames import FrameBatch
from clutch_model.calibration import SHIPPED, shipped_calibration
from clutch_results.records import Condition, FrictionEstimate, ScaleFreeFriction, ShiftEstimate, Status
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.friction.posterior import friction, scale_free
from diag_service.service.stages import Diagnosis
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive
from ecu_emulator.driving.journey import Trip
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import Scenario, WorkshopRoutine
from ecu_emulator.truth import BEGUN_SLIP_RAD_S, PRESSED_NM
from studies.builders import EPOCH_US, STRETCH_S, TRACES, in_oil, new_stages, planned, to_batch
from studies.drawn_vehicle import Vehicle, draw, with_other_laws
from studies.mismatch_rows import BY_NAME, MATCHED
from studies.run import over_drives, parsed, root_mean_square, study_parser

FIRST_SEED: Final = 95_000  # seeds below were looked at while priors and gates were chosen
MOMENTS: Final = (2, 5, 10, 30)  # events used, of the table by moments
END: Final = 0
FAR_STD: Final = 4.0
US_PER_ROW: Final = 1000  # of the plant
TORQUE: Final = [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]
DRAG: Final = [Col.VISCOUS1_TORQUE, Col.VISCOUS2_TORQUE]
SHAFTS: Final = [Col.INPUT1_SPEED, Col.INPUT2_SPEED]
WRONG: Final = {  # verdicts that would be wrong
    "ideal": {Condition.WATCH, Condition.CHANGE_FLUID},
    "case1": {Condition.GOOD},
    "case2": {Condition.GOOD},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One drive of one vehicle."""

    seed: int
    trace: str
    oil_degc: float
    has_mismatch: bool
    loss_ratio: float
    burst: int = 1  # frames of one message that are lost in a row
    has_other_laws: bool = False  # of open packs, oil and film
    transmission: str = "nominal"
    row: str = MATCHED.name  # of the mismatch table


Fate = tuple[str, str, str]
"""Kind, status and reasons of an event."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLook:
    """What is known of the friction of one clutch at one moment; (mu_C, mu_S) each, in percent of the truth."""

    moment: int  # events used, END: all
    clutch: int
    absolute: tuple[float, float]
    absolute_std: tuple[float, float]
    free: tuple[float, float]
    free_std: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOutcome:
    """One drive: looks at the running estimate, what became of the events, and the verdicts."""

    looks: tuple[DriveLook, ...]
    statuses: Counter[Fate]  # of events
    slip_ms: Counter[Fate]  # under load, within them
    whole_slip_ms: int  # of the drive
    alone: tuple[tuple[str, FloatArray, FloatArray], ...]  # kind, scale-free errors and deviations of single events
    wrong_verdicts: tuple[str, ...]  # at any moment: of which clutch, after how many of its events, why
    final_verdicts: tuple[str, ...]
    fluid: str


def scenario_of(case: Case) -> tuple[Scenario, Vehicle]:
    """Return what is driven, and the vehicle."""
    vehicle = replace(draw(case.seed, has_mismatch=case.has_mismatch), transmission=case.transmission)
    vehicle = with_other_laws(vehicle) if case.has_other_laws else vehicle
    base = vehicle.scenario(0, WorkshopRoutine())
    effects = replace(base.effects, frame_loss_ratio=case.loss_ratio if case.burst == 1 else 0.0)
    base = replace(base, transmission=case.transmission, drive=DriveName.CITY, effects=effects)
    base = base if case.row == MATCHED.name else BY_NAME[case.row].applied(base)
    return in_oil(base, case.oil_degc), vehicle


def driven(case: Case) -> list[DriveOutcome]:
    """Drive and diagnose."""
    scenario, vehicle = scenario_of(case)
    slips: list[BoolArray] = []
    drive = Drive(scenario, planned=iter([planned(case.trace)]), make_trip=partial(WatchedTrip, slips))
    stages = new_stages(shipped_calibration(case.transmission))
    diagnoses: list[Diagnosis] = []
    rng = np.random.default_rng(case.seed)
    for stretch in drive.stretches(STRETCH_S):
        batch = to_batch(merge([stretch.frames]))
        diagnoses += stages.feed(batch if case.burst == 1 else without_bursts(batch, case.loss_ratio, case.burst, rng))
    diagnoses += [stages.conclude(event) for event in stages.flush()]
    true = np.array([[drive.truth.mu_c[m], drive.truth.mu_s[m]] for m in range(2)]) * BY_NAME[case.row].friction_ratio
    outcome, does_slip = outcome_of(diagnoses, true, vehicle, scenario.fluid.condition), np.concatenate(slips)
    slip_ms = Counter[Fate]()
    for estimate in [one.estimate for one in diagnoses]:
        first, last = ((t_ns // 1000 - EPOCH_US) // US_PER_ROW for t_ns in (estimate.start_ns, estimate.end_ns))
        slip_ms[fate_of(estimate)] += int(does_slip[max(first, 0) : last].sum())
    return [replace(outcome, slip_ms=slip_ms, whole_slip_ms=int(does_slip.sum()))]


class WatchedTrip(Trip):
    """A trip that notes in which of its rows, one a millisecond, a pressed clutch slips."""

    def __init__(self, slips: list[BoolArray], *course: Any) -> None:  # noqa: ANN401 - as of a trip
        super().__init__(*course)
        self._slips = slips

    def advance(self, duration_s: float) -> FloatArray:
        rows = super().advance(duration_s)
        is_pressed = np.abs(rows[:, TORQUE] - rows[:, DRAG]) > PRESSED_NM
        first, second = (is_pressed & (np.abs(rows[:, [Col.HUB_SPEED]] - rows[:, SHAFTS]) > BEGUN_SLIP_RAD_S)).T
        self._slips.append(first | second)
        return rows


def fate_of(estimate: ShiftEstimate) -> Fate:
    """Return what became of an event."""
    return estimate.kind.value, estimate.status.value, ", ".join(estimate.reasons)


def used_of(counts: Counter[Fate], kind: str = "") -> int:
    """Return how much of a kind, or of all, belongs to events whose friction enters the running estimate."""
    return sum(count for (of, status, why), count in counts.items()
               if (of == kind or not kind) and status == Status.VALID and not why)  # fmt: skip


def without_bursts(batch: FrameBatch, ratio: float, burst: int, rng: np.random.Generator) -> FrameBatch:
    """Return frames of which a share is lost, of each message some in a row."""
    is_kept = np.ones(len(batch), dtype=bool)
    for can_id in np.unique(batch.can_id):
        rows = np.flatnonzero(batch.can_id == can_id)
        begins = np.flatnonzero(rng.random(len(rows)) < ratio / burst)
        lost = (begins[:, None] + np.arange(burst)).ravel()
        is_kept[rows[lost[lost < len(rows)]]] = False
    return batch[is_kept]


def outcome_of(diagnoses: Sequence[Diagnosis], true: FloatArray, vehicle: Vehicle, fluid: str) -> DriveOutcome:
    """Return what the diagnoses of one drive say; ``true`` are ``(mu_c, mu_s)`` of each clutch."""
    shown = true * vehicle.torque_gain * (1.0 + np.array(vehicle.area_ratios))[:, None]
    looks: list[DriveLook] = []
    alone = []
    used_count = 0
    for diagnosis in diagnoses:
        estimate = diagnosis.estimate
        if not used_of(Counter([fate_of(estimate)])):
            continue
        used_count += 1
        looks += _looks(used_count, diagnosis.belief.posterior, true, shown)
        if estimate.scale_free is not None:
            alone.append((estimate.kind.value, *_error(estimate.scale_free, shown[estimate.clutch - 1])))
    looks += _looks(END, diagnoses[-1].belief.posterior, true, shown)
    return DriveOutcome(
        looks=tuple(looks),
        statuses=Counter(fate_of(one.estimate) for one in diagnoses),
        slip_ms=Counter(),
        whole_slip_ms=0,
        alone=tuple(alone),
        wrong_verdicts=tuple(_wrong_verdicts(diagnoses, fluid)),
        final_verdicts=_final_verdicts(diagnoses),
        fluid=fluid,
    )


def _wrong_verdicts(diagnoses: Sequence[Diagnosis], fluid: str) -> Iterator[str]:
    for one in diagnoses:
        verdict = one.verdict
        if verdict.condition in WRONG[fluid]:
            count = one.belief.posterior.shift_counts[verdict.clutch - 1]
            condition = verdict.condition.name.lower()
            yield f"{condition} of clutch {verdict.clutch} after {count} of its events ({verdict.reason})"


def _final_verdicts(diagnoses: Sequence[Diagnosis]) -> tuple[str, ...]:
    last = {one.verdict.clutch: one.verdict.condition.name.lower() for one in diagnoses}
    return tuple(last[clutch] for clutch in sorted(last))


def _looks(moment: int, state: Posterior, true: FloatArray, shown: FloatArray) -> Iterator[DriveLook]:
    for clutch in (1, 2):
        if not state.shift_counts[clutch - 1]:
            continue
        absolute, absolute_std = _error(friction(state, clutch), true[clutch - 1])
        free, free_std = _error(scale_free(state, clutch), shown[clutch - 1])
        yield DriveLook(
            moment=moment,
            clutch=clutch,
            absolute=_pair(absolute),
            absolute_std=_pair(absolute_std),
            free=_pair(free),
            free_std=_pair(free_std),
        )


def _error(found: FrictionEstimate | ScaleFreeFriction, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return error and stated deviation of (mu_C, mu_S) in percent."""
    error = 100.0 * (np.array([found.mu_c, found.mu_s]) / true - 1.0)
    return error, 100.0 * np.array([found.std_mu_c, found.std_mu_s]) / true


def _pair(values: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def coverage(errors: FloatArray, stds: FloatArray) -> str:
    """Return the share of errors within two stated deviations, and how many are beyond four."""
    distance = np.abs(errors / stds)
    far = int(np.count_nonzero(distance > FAR_STD))
    return f"{np.mean(distance < 2.0):.1%}" + (f" ({far} beyond 4)" if far else "")


def moments_table(outcomes: Sequence[DriveOutcome]) -> Table:
    """Return errors and coverage as events come."""
    table = Table(
        "events used", "estimates", "absolute mu_C", "mu_S", "stated", "within 2 std", "scale-free mu_C", "mu_S",
        "stated", "within 2 std", title="Running estimate, RMS error in %",
    )  # fmt: skip
    looks = [look for outcome in outcomes for look in outcome.looks]
    for moment in (*MOMENTS, END):
        some = [look for look in looks if look.moment == moment]
        if not some:
            continue
        arrays = {name: np.array([getattr(look, name) for look in some]) for name in
                  ("absolute", "absolute_std", "free", "free_std")}  # fmt: skip
        cells = [str(moment) if moment else "all", str(len(some))]
        for error, std in (("absolute", "absolute_std"), ("free", "free_std")):
            cells += [f"{root_mean_square(arrays[error][:, k]):.2f}" for k in range(2)]
            cells += [f"{arrays[std].mean():.2f}", coverage(arrays[error], arrays[std])]
        table.add_row(*cells)
    return table


def kinds_table(outcomes: Sequence[DriveOutcome]) -> Table:
    """Return what single events say, and what became of them."""
    table = Table(
        "kind", "events", "used", "left out", "slip, s", "of it used", "mu_C", "mu_S", "stated", "within 2 std",
        "why not", title="Single events, scale-free, RMS error in %",
    )  # fmt: skip
    statuses = sum((outcome.statuses for outcome in outcomes), Counter[Fate]())
    slip_ms = sum((outcome.slip_ms for outcome in outcomes), Counter[Fate]())
    for kind in sorted({kind for kind, _, _ in statuses}):
        mine = {key[1:]: count for key, count in statuses.items() if key[0] == kind}
        out = sum(count for (status, why), count in mine.items() if status != Status.UNOBSERVED and why)
        why = ", ".join(f"{count} {reasons}" for (_, reasons), count in sorted(mine.items()) if reasons)
        alone = [one[1:] for outcome in outcomes for one in outcome.alone if one[0] == kind]
        whole_ms = sum(ms for (of, *_), ms in slip_ms.items() if of == kind)
        cells = [kind.replace("_", " "), str(sum(mine.values())), str(used_of(statuses, kind)), str(out)]
        cells += [f"{whole_ms / 1e3:.0f}", f"{used_of(slip_ms, kind) / max(whole_ms, 1):.0%}"]
        if alone:
            errors, stds = (np.array([one[k] for one in alone]) for k in range(2))
            cells += [f"{root_mean_square(errors[:, k]):.2f}" for k in range(2)]
            cells += [f"{np.median(stds[:, 0]):.2f}, {np.median(stds[:, 1]):.2f}", coverage(errors, stds)]
        else:
            cells += ["-"] * 4
        table.add_row(*cells, why)
    return table


def main() -> int:
    """Drive all vehicles and print the tables; return 1 if a verdict was wrong."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--trace", default="udds", choices=TRACES)
    parser.add_argument("--oil-degc", type=float, default=80.0)
    parser.add_argument("--mismatch", action="store_true", help="film, oil and lining unlike the belief as well")
    parser.add_argument("--row", choices=BY_NAME, default=MATCHED.name, help="one effect of the mismatch table as well")
    parser.add_argument("--other-laws", action="store_true", help="laws of cold oil that the estimator does not have")
    parser.add_argument("--loss", type=float, default=0.0, help="share of the frames that are lost")
    parser.add_argument("--burst", type=int, default=1, help="frames of one message that are lost in a row")
    parser.add_argument("--transmission", choices=SHIPPED, default="nominal")
    options = parsed(parser, vehicles=6)
    case = partial(
        Case, trace=options.trace, oil_degc=options.oil_degc, has_mismatch=options.mismatch,
        loss_ratio=options.loss, burst=options.burst, has_other_laws=options.other_laws,
        transmission=options.transmission, row=options.row,
    )  # fmt: skip
    cases = [case(seed=seed) for seed in range(options.seed, options.seed + options.vehicles)]
    outcomes = over_drives(driven, cases, options.workers, options.kept)
    console = Console(markup=False, width=150)
    for table in (moments_table(outcomes), kinds_table(outcomes)):
        console.print(table)
    whole_ms, used_ms = sum(one.whole_slip_ms for one in outcomes), sum(used_of(one.slip_ms) for one in outcomes)
    console.print(f"slip under load: {whole_ms / 1e3:.0f} s, {used_ms / whole_ms:.1%} of it in events that are used")
    verdicts = Counter((one.fluid, ", ".join(one.final_verdicts)) for one in outcomes)
    for (fluid, final), count in sorted(verdicts.items()):
        console.print(f"{fluid}: {count} drives end with {final}")
    wrong = [(one, case.seed) for one, case in zip(outcomes, cases, strict=True) if one.wrong_verdicts]
    for one, seed in wrong:
        said = one.wrong_verdicts
        console.print(
            f"seed {seed}, {one.fluid}: {len(said)} wrong verdicts, the first: {said[0]}; the last: {said[-1]}"
        )
    console.print(f"drives with a wrong verdict at any moment: {len(wrong)} of {len(outcomes)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
