"""A day of endless driving as fast as it goes: memory, clock, frames and events, hour by hour.

Days of trips with the car parked in between, as ``ecu-emulator run --drive day --endless`` sends them: plant, sensors,
frames and truth are at work, only the bus is left out. With ``--diagnose`` the service's stages are at work as well, in
the same process: decoding, events, estimate and verdict, and what one event costs in processor time.

    python -m studies.endless [hours]
    python -m studies.endless 24 --diagnose
"""

import argparse
import time
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import psutil
from rich.console import Console

from studies.accuracy import to_batch
from studies.measuring import machine
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive, Stretch
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import EventTruth, TripTruth

HOURS: Final = 24.0
PARKED_S: Final = 10.0  # what a stay lasts on a bus
SCENARIO: Final = "noise_only"
S_PER_H: Final = 3600.0
MS_PER_S: Final = 1000.0
MB: Final = 1e6


@dataclass(slots=True)
class Account:
    """What the stretches so far add up to."""

    parked_ms: int = 0
    trips: int = 0
    events: int = 0
    off_grid_ms: float = 0.0  # greatest distance of a frame's time from a whole millisecond
    disorder_count: int = 0  # frames before the one before them
    last_s: float = -1.0

    def add(self, stretch: Stretch) -> None:
        """Add a stretch."""
        t_s = stretch.frames.t_s
        self.off_grid_ms = max(
            self.off_grid_ms, float(np.abs(t_s * MS_PER_S - np.rint(t_s * MS_PER_S)).max(initial=0.0))
        )
        self.disorder_count += int(np.count_nonzero(np.diff(t_s, prepend=self.last_s) < 0.0))
        self.last_s = float(t_s[-1]) if len(t_s) else self.last_s
        for truth in stretch.truths:
            self.events += isinstance(truth, EventTruth)
            if isinstance(truth, TripTruth):
                self.trips += 1
                self.parked_ms += round(min(truth.parked_s, PARKED_S) * MS_PER_S)


@dataclass(slots=True)
class Diagnosing:
    """The stages of the service beside the drive, and what its events cost."""

    stages: Stages
    count: int = 0
    total_s: float = 0.0
    longest_s: float = 0.0

    def add(self, stretch: Stretch) -> None:
        """Diagnose a stretch."""
        for event in self.stages.segment(to_batch(stretch.frames)):
            start_s = time.process_time()
            self.stages.conclude(event)
            took_s = time.process_time() - start_s
            self.count += 1
            self.total_s += took_s
            self.longest_s = max(self.longest_s, took_s)

    def line(self) -> str:
        """Return what the events cost so far."""
        mean_ms = self.total_s / max(self.count, 1) * MS_PER_S
        return f"  {self.count:6d} diagnosed, {mean_ms:.1f} ms each, at most {self.longest_s * MS_PER_S:.0f} ms"


def stages() -> Stages:
    """Return the stages of a service that knows nothing of the vehicle yet."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    return Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())


def hour_line(hour: int, drive: Drive, account: Account, took_s: float) -> str:
    """Return what can be said after an hour, beginning with what must not grow."""
    totals = drive.totals
    rows_ms = round(totals.driven_s * MS_PER_S) + account.parked_ms
    drift_ms = round(totals.duration_s * MS_PER_S) + 1 - rows_ms  # the last row is a millisecond before its end
    memory_mb = psutil.Process().memory_info().rss / MB
    return (
        f"{hour:4d} h  {memory_mb:7.1f} MB  clock {drift_ms:+d} ms  off the grid {account.off_grid_ms:.0e} ms  "
        f"disorder {account.disorder_count}  {totals.frames:>11,} frames  {account.trips:3d} trips  "
        f"{account.events:6d} events  {hour * S_PER_H / took_s:4.0f} x real time"
    )


def main() -> None:
    """Drive for the hours on the command line, or for a day."""
    parser = argparse.ArgumentParser(description="A day of endless driving.")
    parser.add_argument("hours", type=float, nargs="?", default=HOURS)
    parser.add_argument("--diagnose", action="store_true", help="with the stages of the service")
    options = parser.parse_args()
    console = Console(markup=False, highlight=False, width=220)
    scenario = replace(load_scenario(SCENARIO), drive=DriveName.DAY, endless=True)
    drive, account = Drive(scenario, PARKED_S), Account()
    diagnosing = Diagnosing(stages()) if options.diagnose else None
    console.print(f"Endless days, {machine()}")
    start_s, hour = time.process_time(), 0
    for stretch in drive.stretches(SHORT_STRETCH_S):
        account.add(stretch)
        if diagnosing is not None:
            diagnosing.add(stretch)
        if stretch.end_s >= (hour + 1) * S_PER_H:
            hour += 1
            said = hour_line(hour, drive, account, time.process_time() - start_s)
            console.print(said + ("" if diagnosing is None else diagnosing.line()))
        if stretch.end_s >= options.hours * S_PER_H:
            return


if __name__ == "__main__":
    main()
