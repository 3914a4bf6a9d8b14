"""CPU time of one shift on CAN data, beside a loop of filterpy over the same samples.

- *Live update*: what a running service does once a shift is over: plausibility, the shift's own estimate, the running
  state, the verdict.
- *Full solve*: the same from the frames of the shift on: protection check, decoding, finding the shift.
- *filterpy*: the discrete Kalman estimator of the paper (signal and rate, two states), predicted and updated once per
  sample of the seven signals that the balance needs: what a script would begin with, before it knows any friction.

CPU time of the whole process, the best of some rounds over all shifts of a drive; compiled beforehand. With ``--drive``
each event of a public cycle, by its kind: mean and longest live update, each event the best of some rounds.

    python -m studies.estimator
    python -m studies.estimator --drive wltc
"""

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from canlog.frames import FrameBatch
from diag_service.diagnosis.columns import BALANCE_SIGNALS
from diag_service.diagnosis.events import Event
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario_file import load_scenario
from studies import bars
from studies.builders import new_stages, to_batch
from studies.run import parsed, study_parser

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # filterpy loads matplotlib, whose own dependencies are deprecated
    from filterpy.kalman import KalmanFilter

ROUNDS = 5
PEER_SHIFTS = 3  # the loop takes the same time for every shift
PERIOD_S = 0.01
PROCESS_VARIANCE, SAMPLE_VARIANCE = 1.8e7, 0.04  # q and r of the paper's filter; they do not change the time
MS = 1e3


def update_live(stages: Stages, events: Sequence[Event]) -> None:
    """Estimate and judge shifts that were found before."""
    for event in events:
        stages.conclude(event)


def filter_samples(event: Event) -> int:
    """Run a filterpy filter over every signal of a shift; return how many samples that were."""
    drive = np.array([[PERIOD_S**2 / 2.0], [PERIOD_S]])
    for signal in BALANCE_SIGNALS:
        samples = event.columns[signal].value
        kalman = KalmanFilter(dim_x=2, dim_z=1)
        kalman.x = np.array([[samples[0]], [0.0]])
        kalman.F = np.array([[1.0, PERIOD_S], [0.0, 1.0]])
        kalman.H = np.array([[1.0, 0.0]])
        kalman.Q = drive @ drive.T * PROCESS_VARIANCE
        kalman.R = np.array([[SAMPLE_VARIANCE]])
        for sample in samples:
            kalman.predict()
            kalman.update(sample)
    return sum(len(event.columns[signal].value) for signal in BALANCE_SIGNALS)


def cpu_s(prepare: Callable[[], Callable[[], object]]) -> float:
    """Return the least CPU time [s] of what ``prepare`` returns, over some rounds after a first one."""
    times_s = []
    for _ in range(ROUNDS + 1):
        work = prepare()
        began_s = time.process_time()
        work()
        times_s.append(time.process_time() - began_s)
    return min(times_s[1:])


def report(batch: FrameBatch) -> None:
    """Measure on the frames of a drive, and print."""
    events = [*(stages := new_stages()).segment(batch), *stages.flush()]

    def live() -> Callable[[], None]:
        fresh = new_stages()
        return lambda: update_live(fresh, events)

    def full() -> Callable[[], object]:
        fresh = new_stages()
        return lambda: fresh.feed(batch)

    live_s, full_s = (cpu_s(prepare) / len(events) for prepare in (live, full))
    chosen = events[:PEER_SHIFTS]
    samples = sum(map(filter_samples, chosen)) / PEER_SHIFTS
    peer_s = cpu_s(lambda: lambda: [filter_samples(event) for event in chosen]) / PEER_SHIFTS
    print(f"CPU time of one shift, mean over {len(events)} shifts ({samples:.0f} samples of seven signals each)")
    print(f"  live update: estimate, running state, verdict    {live_s * MS:7.2f} ms")
    print(
        f"  full solve: from the frames to the verdict       {full_s * MS:7.2f} ms   {bars.EVENT.judged(full_s * MS)}"
    )
    print(f"  filterpy: signal and rate of the same samples    {peer_s * MS:7.2f} ms")
    ratio = peer_s / full_s
    print(f"  filterpy over live update {peer_s / live_s:.1f}")
    print(f"  filterpy over full solve {ratio:.1f}   {bars.FILTERPY.judged(ratio)}")


def report_events(name: DriveName) -> None:
    """Measure each event of a drive, and print what each kind of them takes: each event the least of some rounds."""
    batch = to_batch(frames_of(replace(load_scenario("ideal"), drive=name))[0])
    events = [*(stages := new_stages()).segment(batch), *stages.flush()]
    times_s = np.full(len(events), np.inf)
    for _ in range(ROUNDS + 1):
        stages = new_stages()
        for place, event in enumerate(events):
            began_s = time.process_time()
            stages.conclude(event)
            times_s[place] = min(times_s[place], time.process_time() - began_s)
    kinds = np.array([event.kind.value for event in events])
    print(f"CPU time of the live update after each event of {name.value}")
    for kind in (*np.unique(kinds), "all"):
        own_ms = MS * times_s[(kinds == kind) | (kind == "all")]
        print(f"  {kind:20} {len(own_ms):4} events, mean {own_ms.mean():6.2f} ms, longest {own_ms.max():6.2f} ms")


def main() -> int:
    """Run the benchmark."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--drive", type=DriveName, choices=list(DriveName))
    options = parsed(parser)
    if options.drive is not None:
        report_events(options.drive)
    else:
        frames, _ = frames_of(load_scenario("ideal"))
        report(to_batch(frames))
    return 0


if __name__ == "__main__":
    sys.exit(main())
