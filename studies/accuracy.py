"""Accuracy of the estimator over many drives: error, stated standard deviation and coverage, for every fluid.

Each drive goes the whole way in memory: plant, sensors, frames with CRC, decoding, shift detection, estimation. The
running estimate after the last cycle is compared with the truth. Two intervals are judged: the random one where the
calibration is true (scenario ``noise_only``), the total one where the vehicle has production scatter.

    python -m studies.accuracy --seeds 20 --cycles 3
    python -m studies.accuracy --scenario ideal --seeds 20      # with production scatter
    python -m studies.accuracy --nuisances-known --seeds 20     # sensor noise alone
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from clutch_model.calibration import Calibration, SensorBias, Uncertainty, nominal_calibration
from clutch_results.records import FrictionEstimate, Status
from diag_service.diagnosis.friction.posterior import friction as friction_of
from ecu_emulator.scenario.scenario import FluidCondition
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import FLUIDS, diagnose
from studies.run import over_drives, parsed, study_parser

FIRST_SEED = 16_000  # seeds below were looked at while priors and drifts were chosen
PARAMETERS = ("mu_c", "mu_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class AccuracyCase:
    """One drive to make and to analyse."""

    scenario: str
    fluid: FluidCondition
    seed: int
    cycles: int
    are_nuisances_known: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AccuracyRow:
    """One clutch after one drive (``scope`` running) or after one shift (``scope`` shift)."""

    fluid: str
    seed: int
    scope: str
    clutch: int
    true_mu_c: float
    true_mu_s: float
    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    random_std_mu_c: float
    random_std_mu_s: float
    probability_negative_slope: float
    chi_square_ratio: float
    is_upshift: bool


def exactly_known() -> Calibration:
    """Return the calibration of an emulated vehicle of which everything but friction is known: nothing is late."""
    nominal = nominal_calibration()
    certain = Uncertainty(**{member.name: 0.0 for member in fields(Uncertainty)})
    return replace(nominal, uncertainty=certain, bias=SensorBias())


def analyse(case: AccuracyCase) -> list[AccuracyRow]:
    """Make one drive, analyse it, and return its rows."""
    scenario = load_scenario(case.scenario)
    scenario = replace(
        scenario, seed=case.seed, cycles=case.cycles, fluid=replace(scenario.fluid, condition=case.fluid)
    )
    diagnoses, truth = diagnose(scenario, exactly_known() if case.are_nuisances_known else None)
    true = {1: (truth.drive.mu_c[0], truth.drive.mu_s[0]), 2: (truth.drive.mu_c[1], truth.drive.mu_s[1])}

    def row(scope: str, clutch: int, friction: FrictionEstimate, ratio: float, *, is_upshift: bool) -> AccuracyRow:
        return AccuracyRow(
            fluid=case.fluid,
            seed=case.seed,
            scope=scope,
            clutch=clutch,
            true_mu_c=true[clutch][0],
            true_mu_s=true[clutch][1],
            mu_c=friction.mu_c,
            mu_s=friction.mu_s,
            std_mu_c=friction.std_mu_c,
            std_mu_s=friction.std_mu_s,
            random_std_mu_c=friction.random_std_mu_c,
            random_std_mu_s=friction.random_std_mu_s,
            probability_negative_slope=friction.probability_negative_slope,
            chi_square_ratio=ratio,
            is_upshift=is_upshift,
        )

    rows = []
    for diagnosis in diagnoses:
        estimate = diagnosis.estimate
        if estimate.friction is not None:
            up = estimate.to_gear > estimate.from_gear
            rows.append(row("shift", estimate.clutch, estimate.friction, estimate.fit.chi_square_ratio, is_upshift=up))
        if estimate.status is not Status.VALID or estimate.reasons:
            print(
                f"{case.fluid} seed {case.seed} shift {estimate.number} {estimate.from_gear}-{estimate.to_gear}: "
                f"{estimate.status} {', '.join(estimate.reasons)} chi2 {estimate.fit.chi_square_ratio:.2f}",
                file=sys.stderr,
            )
    state = diagnoses[-1].belief.posterior
    rows += [row("running", clutch, friction_of(state, clutch), 0.0, is_upshift=False) for clutch in (1, 2)]
    return rows


def table(rows: list[AccuracyRow], scope: str) -> Iterator[str]:
    """Yield the lines of the accuracy table, percent of the true value."""
    yield (
        f"{'fluid':8} {'':4} {'clutch':6} {'n':>5} {'bias %':>8} {'RMS %':>8} {'random std %':>13} {'in 2 std %':>11} "
        f"{'total std %':>12} {'in 2 std %':>11}"
    )
    for fluid in (*FLUIDS, "all"):
        for name in PARAMETERS:
            for clutch in (1, 2, 0):
                chosen = [
                    row
                    for row in rows
                    if row.scope == scope and fluid in (row.fluid, "all") and clutch in (row.clutch, 0)
                ]
                true = np.array([getattr(row, f"true_{name}") for row in chosen])
                error = np.array([getattr(row, name) for row in chosen]) - true
                random = np.array([getattr(row, f"random_std_{name}") for row in chosen])
                total = np.array([getattr(row, f"std_{name}") for row in chosen])
                yield (
                    f"{fluid:8} {name:4} {'both' if clutch == 0 else clutch:>6} {len(chosen):5d} "
                    f"{100 * np.mean(error / true):8.3f} {100 * np.sqrt(np.mean((error / true) ** 2)):8.3f} "
                    f"{100 * np.mean(random / true):13.3f} {100 * np.mean(np.abs(error) <= 2 * random):11.1f} "
                    f"{100 * np.mean(total / true):12.3f} {100 * np.mean(np.abs(error) <= 2 * total):11.1f}"
                )
    chosen = [row for row in rows if row.scope == scope]
    for kind in ("random", "total"):
        prefix = "random_std" if kind == "random" else "std"
        inside = [
            abs(getattr(row, name) - getattr(row, f"true_{name}")) <= 2 * getattr(row, f"{prefix}_{name}")
            for row in chosen
            for name in PARAMETERS
        ]
        yield f"all parameters within 2 {kind} std: {100 * np.mean(inside):.1f} % of {len(inside)}"
    right = sum((row.mu_c > row.mu_s) == (row.true_mu_c > row.true_mu_s) for row in chosen)
    yield f"slope sign right in {right} of {len(chosen)}"


def main() -> int:
    """Run the study and print its tables."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--scenario", default="noise_only")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cycles", type=int, default=3)
    parser.add_argument(
        "--nuisances-known",
        action="store_true",
        help="the service knows offsets, touch points and masses exactly (noise_only): what sensor noise alone leaves",
    )
    arguments = parsed(parser, seeds=3)
    cases = [
        AccuracyCase(
            scenario=arguments.scenario,
            fluid=fluid,
            seed=arguments.seed + k,
            cycles=arguments.cycles,
            are_nuisances_known=arguments.nuisances_known,
        )
        for k in range(arguments.seeds)
        for fluid in FLUIDS
    ]
    rows = over_drives(analyse, cases, arguments.workers, arguments.kept)
    print(
        f"scenario {arguments.scenario}, {arguments.cycles} cycles, seeds {arguments.seed}.."
        f"{arguments.seed + arguments.seeds - 1}{', nuisances known' if arguments.nuisances_known else ''}"
    )
    print("\nAfter the drive (running estimate)")
    print("\n".join(table(rows, "running")))
    print("\nSingle shifts")
    print("\n".join(table(rows, "shift")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
