"""Friction from tables of signals: coverage at every moment, wrong verdicts, widths, at few rows a second.

Each vehicle is drawn as ``studies.drive_accuracy`` draws it, driven along a trace with one of three fluids, and
recorded once; a table of every rate is made of that log as a scan tool writes them: pressures in steps of 5.86 kPa,
columns asked one after the other over a whole row, rows 10 ms early or late. Nothing of the vehicle is known but its
type. Where injected fuel stands in for the torque, friction is told up to a scale: what needs none (mu_S over mu_C, the
sign of the slope, clutch against clutch, change since the baseline, which truly is none) is held against the truth.
Without both nothing may be said of friction.

    python -m studies.table_accuracy --vehicles 12 --workers 1
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import FloatArray
from canlog.logs import read_log
from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.records import FrictionSlope, Status
from diag_service.diagnosis.friction.posterior import clutch_ratio, scale_free, trend
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.learning import proposed_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import Drive
from ecu_emulator.log_formats import open_log
from studies.builders import OF_FRICTION, OUTPUT, STRETCH_S, planned, with_fuel, written
from studies.drive_accuracy import END, MOMENTS, WRONG, Case, DriveOutcome, coverage, outcome_of, scenario_of
from studies.run import over_drives, parsed, root_mean_square, study_parser

RATES_HZ: Final = (50.0, 27.0, 10.0)
TRACES: Final = ("udds", "us06")
FIRST_SEED: Final = 97_000
NO_TORQUE: Final = "no torque"
FUEL: Final = "fuel"
TORQUE: Final = "Engine Torque"
SURE: Final = 0.95


NAMES: Final = (*(f"{kind}{rate:.0f}/s" for rate in RATES_HZ for kind in ("", f"{FUEL} ")), NO_TORQUE)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableErrors:
    """What the tables of one drive gave, by the name of the table."""

    trace: str
    seed: int
    outcomes: dict[str, DriveOutcome]
    slopes: dict[str, list["SlopeLook"]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlopeLook:
    """What is known up to a scale at one moment, in percent: each an error with its stated deviation."""

    moment: int  # events used, END: all
    numbers: dict[str, tuple[float, float]]
    is_falling: bool  # in truth
    probability_falling: float


def shown(names: frozenset[str], case: Case) -> list[TableErrors]:
    """Drive, write tables, diagnose each."""
    scenario, vehicle = scenario_of(case)
    drive = Drive(scenario, planned=iter([planned(case.trace)]))
    outcomes, slopes = dict[str, DriveOutcome](), dict[str, list[SlopeLook]]()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "drive.log"
        with open_log(log) as file:
            for stretch in drive.stretches(STRETCH_S):
                file.write(stretch.frames)
        true = np.array([[drive.truth.mu_c[m], drive.truth.mu_s[m]] for m in range(2)])
        for rate_hz in RATES_HZ:
            left_out = OUTPUT - OF_FRICTION
            plain, fuel = f"{rate_hz:.0f}/s", f"{FUEL} {rate_hz:.0f}/s"
            for name, missing in ((plain, left_out), (fuel, left_out), (NO_TORQUE, left_out | {TORQUE})):
                if name not in names or (name == NO_TORQUE and rate_hz != RATES_HZ[1]):
                    continue
                table = Path(folder) / "drive.csv"
                rng = np.random.default_rng(case.seed)
                written(log, table, rng, rate_hz=rate_hz, left_out=missing)
                if name == fuel:
                    with_fuel(table, rng)
                diagnoses = diagnosed(table)
                outcomes[name] = outcome_of(diagnoses, true, vehicle, scenario.fluid.condition)
                if name == fuel:
                    slopes[name] = list(slope_looks(diagnoses, true, vehicle.area_ratios if vehicle else (0.0, 0.0)))
    return [TableErrors(trace=case.trace, seed=case.seed, outcomes=outcomes, slopes=slopes)]


def slope_looks(
    diagnoses: Sequence[Diagnosis], true: FloatArray, area_ratios: tuple[float, float]
) -> Iterator[SlopeLook]:
    """Yield what is known up to a scale at each moment, after the events used."""
    used = [one for one in diagnoses if one.estimate.status is Status.VALID and not one.estimate.reasons]
    moments = {count: used[count - 1] for count in MOMENTS if count <= len(used)}
    if used:
        moments[END] = used[-1]
    carries = true[:, 0] * (1.0 + np.array(area_ratios))
    for moment, diagnosis in moments.items():
        state = diagnosis.belief.posterior
        for clutch in (1, 2):
            if not state.shift_counts[clutch - 1]:
                continue
            slope = FrictionSlope.of(scale_free(state, clutch), state.torque)
            ratio = float(true[clutch - 1, 1] / true[clutch - 1, 0])
            numbers = {"mu_S/mu_C": (100.0 * (slope.mu_s_ratio / ratio - 1.0), 100.0 * slope.std_mu_s_ratio / ratio)}
            if (since := trend(state, clutch)) is not None:
                numbers["change"] = (100.0 * since.change_mu_c_ratio, 100.0 * since.std_change_mu_c_ratio)
            if clutch == 1 and all(state.shift_counts):
                both = clutch_ratio(state.stated)
                expected = float(carries[0] / carries[1])
                error = 100.0 * (both.mu_c_ratio / expected - 1.0)
                numbers["clutch 1 over 2"] = (error, 100.0 * both.std_mu_c_ratio / expected)
            yield SlopeLook(
                moment=moment,
                numbers=numbers,
                is_falling=ratio > 1.0,
                probability_falling=slope.probability_negative,
            )


def diagnosed(table: Path) -> list[Diagnosis]:
    """Return the diagnoses of a table, with the profile that is proposed for it."""
    profile = table.with_suffix(".toml")
    proposed = proposed_profile(table)
    profile.write_text(proposed.replace(TorqueSource.WITHOUT_CUT, TorqueSource.MODELLED), encoding="utf-8")
    meaning = interpret(None, profile)
    decoder, calibration = meaning.decoder(), nominal_calibration().with_torque(meaning.profile.torque)
    stages = Stages(decoder, calibration)
    with read_log(table) as reader:
        diagnoses = [one for batch in reader for one in stages.feed(batch)]
    return [*diagnoses, *(stages.conclude(event) for event in stages.flush())]


def moments(drives: Sequence[TableErrors]) -> Table:
    """Return coverage and widths of the running estimate at every moment."""
    table = Table("trace", "table", "events used", "estimates", "absolute: within 2 std", "stated %",
                  "scale-free: within 2 std", "stated %", title="Running friction, mu_C and mu_S")  # fmt: skip
    for trace in TRACES:
        for name in (one for one in drives[0].outcomes if not one.startswith(FUEL)):
            looks = [look for one in drives if one.trace == trace for look in one.outcomes[name].looks]
            for moment in (*MOMENTS, END):
                some = [look for look in looks if look.moment == moment]
                if not some:
                    continue
                cells = [trace, name, str(moment) if moment else "all", str(len(some))]
                for what in ("absolute", "free"):
                    errors, stds = (np.array([getattr(one, key) for one in some]) for key in (what, f"{what}_std"))
                    cells += [coverage(errors, stds), f"{np.median(stds[:, 0]):.1f}, {np.median(stds[:, 1]):.1f}"]
                table.add_row(*cells)
    return table


def slopes(drives: Sequence[TableErrors]) -> Table:
    """Return coverage and widths of what is told up to a scale, at every moment."""
    table = Table("trace", "table", "events used", "what", "estimates", "RMS error %", "stated %", "within 2 std",
                  title="Up to a scale, from injected fuel")  # fmt: skip
    for trace in TRACES:
        for name in drives[0].slopes:
            looks = [look for one in drives if one.trace == trace for look in one.slopes[name]]
            for moment in (*MOMENTS, END):
                some = [look for look in looks if look.moment == moment]
                for what in dict.fromkeys(what for look in some for what in look.numbers):
                    errors, stds = np.array([look.numbers[what] for look in some if what in look.numbers]).T
                    table.add_row(
                        trace, name, str(moment) if moment else "all", what, str(len(errors)),
                        f"{root_mean_square(errors):.1f}", f"{np.median(stds):.1f}", coverage(errors, stds),
                    )  # fmt: skip
                if some:
                    by_sign = [[look.probability_falling for look in some if look.is_falling is sign]
                               for sign in (True, False)]  # fmt: skip
                    sure = [f"{sum(p > SURE for p in one)} of {len(one)}" for one in by_sign]
                    said = f"{sure[0]} where it falls, {sure[1]} where not"
                    table.add_row(trace, name, str(moment) if moment else "all", "surely falling", said, "", "", "")
    return table


def events(drives: Sequence[TableErrors]) -> Table:
    """Return what became of the events, and the verdicts."""
    table = Table("trace", "table", "events", "used", "why not", "verdicts at the end", "drives with a wrong one",
                  title="Events and verdicts")  # fmt: skip
    for trace in TRACES:
        for name in drives[0].outcomes:
            own = [one.outcomes[name] for one in drives if one.trace == trace]
            statuses = sum((one.statuses for one in own), Counter[tuple[str, str, str]]())
            used = sum(count for (_, status, why), count in statuses.items() if status == Status.VALID and not why)
            reasons = Counter[str]()
            for (_, _, why), count in statuses.items():
                reasons[why] += count if why else 0
            ends = Counter(final for one in own for final in one.final_verdicts)
            table.add_row(
                trace, name, str(statuses.total()), str(used),
                ", ".join(f"{count} {why}" for why, count in reasons.most_common(5) if count),
                ", ".join(f"{count} {final}" for final, count in ends.most_common()),
                f"{sum(bool(one.wrong_verdicts) for one in own)} of {len(own)}",
            )  # fmt: skip
    return table


def main() -> int:
    """Drive all vehicles and print the tables; return 1 if a verdict was wrong."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--vehicles", type=int, default=12, help="on each of the two traces")
    parser.add_argument("--traces", nargs="+", default=TRACES, choices=TRACES)
    parser.add_argument("--tables", nargs="+", default=NAMES, choices=NAMES)
    options = parsed(parser, vehicles=1, traces=["udds"])
    cases = [
        Case(seed=seed, trace=trace, oil_degc=80.0, has_mismatch=False, loss_ratio=0.0)
        for seed in range(options.seed, options.seed + options.vehicles)
        for trace in options.traces
    ]
    drives = over_drives(partial(shown, frozenset(options.tables)), cases, options.workers, options.kept)
    console = Console(markup=False, width=170)
    console.print(moments(drives))
    console.print(slopes(drives))
    console.print(events(drives))
    wrong = [
        (one, name, said) for one in drives for name, found in one.outcomes.items() for said in found.wrong_verdicts[:1]
    ]
    for one, name, said in wrong:
        console.print(f"{one.trace}, seed {one.seed}, {name}, {one.outcomes[name].fluid}: {said}")
    console.print(f"wrong verdicts count for {', '.join(WRONG)}: {len(wrong)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
