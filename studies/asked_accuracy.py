"""Friction from signals that were asked for: coverage at every moment, wrong verdicts, widths, beside broadcast frames.

Each vehicle is drawn as ``studies.drive_accuracy`` draws it and driven once along a trace with one of three fluids.
The profile is ``dct_asked``: engine speed and gears are broadcast, pressures, torque, shaft speeds and temperature are
asked for, answered after 5 to 40 ms. Once five come as one datum that the controller was told to make of them (2C), as
fast as it answers; once in one answer, as fast as 5 % of a bus of 500 kbit/s allow; once one by one at 15 values a
second, as an ELM327 adapter reaches. Nothing of the vehicle is known but its type.

    python -m studies.asked_accuracy --vehicles 6 --workers 1
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from studies.drive_accuracy import END, STRETCH_S, Case, outcome_of, scenario_of
from studies.drive_events import planned
from studies.study import add_pool_options, over_drives, root_mean_square
from studies.table_accuracy import TRACES, Shown, events, moments
from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.profile import load_shipped
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import Drive
from ecu_emulator.log_formats.record import open_log
from tests.support.asked import dialogue_of, merged
from tests.support.recode import drive_of

FIRST_SEED: Final = 98_000
PROFILE: Final = "dct_asked"
FRAMES, DEFINED, TOGETHER = "frames", "asked, one datum", "asked, five at once"
ONE_BY_ONE = "asked, 15 values/s"
SETS_PER_S, VALUES_PER_S, FAST = 24.0, 15.0, 5
BLOCK: Final = 8192


def shown(case: Case) -> list[Shown]:
    """Drive, ask in two ways, diagnose each."""
    scenario, vehicle = scenario_of(case)
    drive = Drive(scenario, planned=iter([planned(case.trace)]))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "drive.log"
        with open_log(log) as file:
            for stretch in drive.stretches(STRETCH_S):
                file.write(stretch.frames)
        frames, signals = join(list(read_log(log))), drive_of(log)
    true = np.array([[drive.truth.mu_c[m], drive.truth.mu_s[m]] for m in range(2)])
    profile, rng = load_shipped(PROFILE), np.random.default_rng(case.seed)
    asked = {
        DEFINED: dialogue_of(signals, profile, rng, is_defined=True),
        TOGETHER: dialogue_of(signals, profile, rng, most_per_s=SETS_PER_S * FAST),
        ONE_BY_ONE: dialogue_of(signals, profile, rng, most_per_s=VALUES_PER_S, together=1),
    }
    found = {FRAMES: diagnosed(frames, None)}
    found |= {name: diagnosed(merged(frames, dialogue), PROFILE) for name, dialogue in asked.items()}
    outcomes = {name: outcome_of(one, true, vehicle, scenario.fluid.condition) for name, one in found.items()}
    return [Shown(trace=case.trace, seed=case.seed, outcomes=outcomes)]


def diagnosed(frames: FrameBatch, profile: str | None) -> list[Diagnosis]:
    """Return the diagnoses of frames by a shipped profile."""
    calibration = nominal_calibration()
    decoder = interpret(None, None if profile is None else Path(profile)).decoder()
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    found = [one for at in range(0, len(frames), BLOCK) for one in stages.feed(frames[at : at + BLOCK])]
    return [*found, *(stages.conclude(event) for event in stages.flush())]


def main() -> int:
    """Drive all vehicles and print the tables; return 1 if a verdict was wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=6, help="on each of the two traces")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first vehicle")
    add_pool_options(parser)
    parser.add_argument("--traces", nargs="+", default=TRACES, choices=TRACES)
    options = parser.parse_args()
    cases = [
        Case(seed=seed, trace=trace, oil_degc=80.0, is_plain=False, has_mismatch=False, loss_ratio=0.0)
        for trace in options.traces
        for seed in range(options.seed, options.seed + options.vehicles)
    ]
    drives = over_drives(shown, cases, options.workers, options.kept)
    console = Console(width=180)
    console.print(moments(drives))
    console.print(events(drives))
    for name in (FRAMES, DEFINED, TOGETHER, ONE_BY_ONE):
        errors = [look.absolute[0] for one in drives for look in one.outcomes[name].looks if look.moment == END]
        if errors:
            console.print(f"{name}: RMS error of mu_C at the end {root_mean_square(np.array(errors)):.2f} %")
    return int(any(outcome.wrong_verdicts for one in drives for outcome in one.outcomes.values()))


if __name__ == "__main__":
    sys.exit(main())
