"""CPU time of one shift on CAN data, beside a loop of filterpy over the same samples.

- *Live update*: what a running service does once a shift is over: plausibility, the shift's own estimate, the running
  state, the verdict.
- *Full solve*: the same from the frames of the shift on: protection check, decoding, finding the shift.
- *filterpy*: the discrete Kalman estimator of the paper (signal and rate, two states), predicted and updated once per
  sample of the seven signals that the balance needs: what a script would begin with, before it knows any friction.

CPU time of the whole process, the best of some rounds over all shifts of a drive; compiled beforehand. With ``--drive``
each event of a public cycle, by its kind: mean and longest live update, each event the best of some rounds.

    python -m studies.estimator
    python -m studies.estimator --before TREE
    python -m studies.estimator --drive wltc
    python -m studies.estimator --drive wltc --before TREE

``--before`` measures the same with an earlier checkout in turns with this one, each in a process of its own; the cycle
round by round.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from studies import bars, timed_events
from studies.accuracy import to_batch
from studies.timed_events import Times, new_stages
from canlog.frames import FrameBatch
from diag_service.diagnosis.columns import BALANCE_SIGNALS
from diag_service.diagnosis.events import Event
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario_file import load_scenario

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # filterpy loads matplotlib, whose own dependencies are deprecated
    from filterpy.kalman import KalmanFilter

ROUNDS = 5
TURNS = 5  # of both checkouts
PAIRS = 100  # of rounds, of the cycle
ROWS = ("live update", "full solve")
PEER_SHIFTS = 3  # the loop takes the same time for every shift
PERIOD_S = 0.01
PROCESS_VARIANCE, SAMPLE_VARIANCE = 1.8e7, 0.04  # q and r of the paper's filter; they do not change the time
MS = 1e3
HERE = Path(__file__).resolve().parents[1]


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


def report_events(name: DriveName, before: Path | None) -> None:
    """Measure each event of a drive, and print what each kind of them takes, also in an earlier checkout."""
    trees = {"now": HERE} if before is None else {"before": before.resolve(), "now": HERE}
    turns = {version: list[Times]() for version in trees}
    for _ in range(1 if before is None else TURNS):
        for version, tree in trees.items():
            turns[version].append(events_times(tree, name))
    found = {version: with_all(least(times)) for version, times in turns.items()}
    print(f"CPU time of the live update after each event of {name.value}")
    for kind, times_s in sorted(found["now"].items(), key=lambda one: max(one[1])):
        print(f"  {kind:20} {len(times_s):4} events, {mean_and_longest(times_s)}")
        if before is not None:
            ratio = sum(found["before"][kind]) / sum(times_s)
            print(f"  {'':20} {'before':>11}, {mean_and_longest(found['before'][kind])}: {ratio:.2f} times as fast now")


def events_times(tree: Path, name: DriveName) -> Times:
    """Return the times of a checkout in a process of its own."""
    command = [sys.executable, "-P", str(Path(timed_events.__file__)), name.value]
    variables = os.environ | {"PYTHONPATH": str(tree)}
    times: Times = json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True, env=variables, cwd=tree).stdout
    )
    return times


def least(turns: Sequence[Times]) -> Times:
    """Return the least time of each event."""
    return {kind: [min(one) for one in zip(*(turn[kind] for turn in turns), strict=True)] for kind in turns[0]}


def with_all(times: Times) -> Times:
    """Return times by kind, and of all kinds together."""
    return times | {"all": [one for times_s in times.values() for one in times_s]}


def mean_and_longest(times_s: Sequence[float]) -> str:
    """Return what some events take."""
    return f"mean {float(np.mean(times_s)) * MS:6.2f} ms, longest {max(times_s) * MS:6.2f} ms"


def compare(before: Path) -> None:
    """Time an earlier checkout and this one in turns, round by round, and print the ratios.

    Both run at once and wait for each other: what else the machine does slows both down alike.
    """
    trees = (before.resolve(), HERE)
    command = [sys.executable, "-P", str(Path(timed_events.__file__))]
    with ExitStack() as running:
        processes = [
            running.enter_context(
                subprocess.Popen(
                    command, cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)}, text=True,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                )
            )
            for tree in trees
        ]  # fmt: skip
        times_s = np.empty((PAIRS, len(trees), len(ROWS)))
        for number in range(PAIRS):
            for place in (0, 1) if number % 2 else (1, 0):
                times_s[number, place] = one_round(processes[place])
    print(f"CPU time of one shift, the median of {PAIRS} rounds in turns")
    for row, (earlier_s, now_s) in zip(ROWS, times_s.transpose(2, 1, 0), strict=True):
        ratio, least = np.median(now_s / earlier_s), now_s.min() / earlier_s.min()
        print(
            f"  {row:12} {np.median(earlier_s) * MS:6.2f} ms before, {np.median(now_s) * MS:6.2f} ms now: "
            f"{ratio - 1.0:+.1%}, the least of all rounds {least - 1.0:+.1%}"
        )


def one_round(process: "subprocess.Popen[str]") -> list[float]:
    """Have a checkout time one round; return its times [s]."""
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("no way to the other process")
    process.stdin.write("\n")
    process.stdin.flush()
    times_s: list[float] = json.loads(process.stdout.readline())
    return times_s


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description="CPU time of one shift, or of each event of a drive.")
    parser.add_argument("--drive", type=DriveName, choices=list(DriveName))
    parser.add_argument("--before", type=Path, metavar="TREE", help="an earlier checkout, measured in turns")
    options = parser.parse_args()
    if options.drive is not None:
        report_events(options.drive, options.before)
    elif options.before is not None:
        compare(options.before)
    else:
        frames, _ = frames_of(load_scenario("ideal"))
        report(to_batch(frames))
    return 0


if __name__ == "__main__":
    sys.exit(main())
