"""Speed of the service: analysing a recording, stage by stage, and decoding beside python-can with cantools.

Every figure is the best of some rounds after a first one that compiles; the rest of the machine only ever slows down.

    python -m benchmarks.service
"""

import argparse
import cProfile
import pstats
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import can
from can.io import CanutilsLogReader
from cantools.database.can import Database

from canlog.frames import FrameBatch
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.diagnosis.summary import Summary
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.drive import open_drive, stream_of
from diag_service.service.recorded import run_logs
from diag_service.service.session import Session
from diag_service.service.stages import Stages
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore

TARGET_S = 2.0
CYCLES = 3
ROUNDS = 5
MEGA = 1e6
ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One stage of the analysis and what it took."""

    name: str
    took_s: float


def record(path: Path, cycles: int) -> None:
    """Record a drive with production scatter, as the emulator's users do."""
    command = [sys.executable, "-m", "ecu_emulator", "record", str(path), "--cycles", str(cycles)]
    subprocess.run(command, check=True, capture_output=True)


def new_decoder() -> Decoder:
    """Return a decoder of the shipped DBC that has seen nothing."""
    return Decoder(load_contract(), load_profile())


def new_stages() -> Stages:
    """Return all stages, before their first frame."""
    calibration = nominal_calibration()
    return Stages(new_decoder(), calibration, Posterior.fresh(calibration), ConditionMemory.fresh())


def analyse(path: Path) -> Summary:
    """Analyse a log the way ``diag-service analyze`` does, with a store in memory."""
    config = DiagnosisConfig(vehicle="benchmark", calibration=nominal_calibration())
    with closing(ResultStore.in_memory()) as store:
        session = Session(config, new_decoder(), store, stream_of([path]), MemoryReporter())
        with open_drive([path]) as logs:
            return run_logs(logs, session, stop=Trigger())


def stages_of(path: Path) -> list[Stage]:
    """Analyse a log stage by stage, each on all of its input at a time."""
    stages: list[Stage] = []

    def timed(name: str, work: Callable[[], ResultT]) -> ResultT:
        began_s = time.perf_counter()
        result = work()
        stages.append(Stage(name=name, took_s=time.perf_counter() - began_s))
        return result

    batches = timed("read", lambda: list(read_log(path)))
    decoder = timed("load DBC and profile", new_decoder)
    columns = timed("decode", lambda: [part for batch in batches for part in decoder.feed(batch)])
    finder = ShiftFinder()
    events = timed("find shifts", lambda: [event for part in columns for event in finder.feed(part)] + finder.flush())
    concluding = new_stages()
    timed("estimate and judge", lambda: [concluding.conclude(event) for event in events])
    return stages


def best(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the shortest time [s] that some work took."""
    times_s = []
    for _ in range(rounds):
        began_s = time.perf_counter()
        work()
        times_s.append(time.perf_counter() - began_s)
    return min(times_s)


def decode_messages(messages: Iterable[can.Message], database: Database) -> None:
    """Decode frames as a script on top of python-can and cantools would."""
    for message in messages:
        database.decode_message(message.arbitration_id, bytes(message.data))


def decode_log(path: Path, database: Database) -> None:
    """Read and decode a log as such a script would."""
    with CanutilsLogReader(path) as log:
        decode_messages(log, database)


def feed(batches: Iterable[FrameBatch], decoder: Decoder) -> None:
    """Decode frames with the service's stages; bus time that goes back only starts a new segment."""
    for batch in batches:
        decoder.feed(batch)


def report_analysis(path: Path) -> None:
    """Print what analysing the log takes, in all and by stage."""
    began_s = time.perf_counter()
    summary = analyse(path)
    first_s = time.perf_counter() - began_s
    whole_s = best(lambda: analyse(path))
    frames, shifts = summary.frames.on_bus, sum(summary.shifts.by_status.values())
    times = read_log(path)
    first = next(times)
    last_ns = max([int(first.t_ns[-1]), *(int(batch.t_ns[-1]) for batch in times)])
    verdict = "met" if whole_s < TARGET_S else "MISSED"
    print(
        f"Analysis of {CYCLES} cycles: {frames} frames, {(last_ns - first.t_ns[0]) / 1e9:.0f} s of bus, {shifts} shifts"
    )
    print(f"  first time, compiling or loading compiled code  {first_s:8.3f} s")
    print(f"  after warm-up                                   {whole_s:8.3f} s   target < {TARGET_S:.0f} s: {verdict}")
    rounds = [stages_of(path) for _ in range(ROUNDS)]
    for index, stage in enumerate(rounds[0]):
        took_s = min(each[index].took_s for each in rounds)
        share = f"{took_s / shifts * 1e3:.1f} ms per shift" if stage.name.startswith("estimate") else ""
        print(f"    {stage.name:<46}{took_s:8.3f} s   {share}".rstrip())
    command = [sys.executable, "-m", "diag_service", "analyze", str(path), "--json"]
    command_s = best(lambda: subprocess.run(command, check=True, capture_output=True), rounds=2)
    print(f"  as a command, interpreter and libraries included{command_s:8.3f} s")


def report_decoding(path: Path) -> None:
    """Print how fast frames become values, beside python-can with cantools."""
    with CanutilsLogReader(path) as log:
        messages = list(log)
    batches = list(read_log(path))
    decoder, database = new_decoder(), load_contract()
    rows: tuple[tuple[str, Callable[[], None], Callable[[], None]], ...] = (
        ("file to values", lambda: feed(read_log(path), decoder), lambda: decode_log(path, database)),
        ("in memory", lambda: feed(batches, decoder), lambda: decode_messages(messages, database)),
    )
    print(f"Decoding of the same {len(messages)} frames [M frames/s]")
    for name, ours, theirs in rows:
        ours_m = len(messages) / best(ours) / MEGA
        theirs_m = len(messages) / best(theirs, rounds=2) / MEGA
        print(
            f"  {name:<16} service, CRC, counter and range checked {ours_m:6.2f}   python-can + cantools, unchecked "
            f"{theirs_m:6.3f}   {ours_m / theirs_m:4.0f} x"
        )


def report_profile(path: Path) -> None:
    """Print where the analysis spends its time."""
    profile = cProfile.Profile()
    stages = new_stages()
    profile.enable()
    for batch in read_log(path):
        stages.feed(batch)
    profile.disable()
    pstats.Stats(profile).sort_stats("tottime").print_stats(25)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", action="store_true", help="profile the analysis instead")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.log"
        record(path, CYCLES)
        if arguments.profile:
            analyse(path)
            report_profile(path)
            return 0
        report_analysis(path)
        report_decoding(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
