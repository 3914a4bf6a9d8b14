"""Speed of decoding on one core: frames in memory beside cantools, and a long log from the file to shifts and results.

    python -m benchmarks.decode [--frames 2000000] [--log-frames 3600000]

All times are computing time of this process, so that what else the machine does counts little. Rounds of both sides
alternate, medians are printed; the peer decodes a part of the frames, one at a time as its users do.
"""

import argparse
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from cantools.database.can import Database

from benchmarks.decoding.hour import record_drive, write_hour
from benchmarks.decoding.layout import database, random_batches
from benchmarks.measuring import machine, peak_mib, took_s
from canlog.decode.codec import Codec
from canlog.frames import FrameBatch
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages

ROUNDS: Final = 5
LOG_ROUNDS: Final = 3
PEER_FRAMES: Final = 40_000  # for each round of the peer
CYCLES: Final = 3
MEMORY_TARGET_MIB: Final = 64.0
RATIO_TARGET: Final = 40.0
SHIFTS_TARGET_S: Final = 1.5
WARM_BATCHES: Final = 8  # before memory is measured: every buffer has its size, every kernel is compiled
MEGA: Final = 1e6


def verdict(met: bool) -> str:  # noqa: FBT001 - a yes or no to put into words
    """Return whether a target was met, in words."""
    return "met" if met else "MISSED"


def decode_all(batches: list[FrameBatch], codec: Codec) -> None:
    """Decode every signal of every frame."""
    for batch in batches:
        for _ in codec.decode(batch):
            pass


def decode_each(frames: list[tuple[int, bytes]], peer: Database) -> None:
    """Decode every signal of every frame with cantools."""
    for can_id, payload in frames:
        try:
            peer.decode_message(can_id, payload, decode_choices=False)
        except ValueError:  # a page of a multiplexer that has no signals
            continue


def report_memory_decoding(count: int) -> None:
    """Print how fast frames in memory become columns, beside cantools."""
    batches, peer = random_batches(count), database()
    codec = Codec(peer.messages)
    part = batches[0][:PEER_FRAMES]
    payloads = [row.tobytes() for row in part.data]
    frames = list(zip(part.can_id.tolist(), payloads, strict=True))
    decode_all(batches[:1], codec)
    ours, theirs = [], []
    for _ in range(ROUNDS):
        ours.append(count / took_s(lambda: decode_all(batches, codec)))
        theirs.append(len(frames) / took_s(lambda: decode_each(frames, peer)))
    ratio = statistics.median(ours) / statistics.median(theirs)
    print(f"In memory, {count} frames of 10 messages with 64 signals [M frames/s of one core]")
    print(f"  columns, ranges checked          {statistics.median(ours) / MEGA:8.3f}")
    print(
        f"  cantools decode_message          {statistics.median(theirs) / MEGA:8.3f}   ({len(frames)} frames a round)"
    )
    print(f"  ratio {ratio:.0f} x   target >= {RATIO_TARGET:.0f} x: {verdict(ratio >= RATIO_TARGET)}")


def shifts_of(path: Path) -> list[Event]:
    """Return the shifts in a log, from the file to events."""
    return list(iterate_shifts(path))


def iterate_shifts(path: Path, after_batch: Callable[[int], None] = lambda _: None) -> Iterator[Event]:
    """Yield the shifts in a log; ``after_batch`` is called with the number of batches so far."""
    decoder, finder = Decoder(load_contract(), load_profile()), ShiftFinder()
    for number, batch in enumerate(read_log(path), start=1):
        for columns in decoder.stream(batch):
            yield from finder.feed(columns)
        after_batch(number)
    yield from finder.flush()


def results_of(path: Path) -> list[Diagnosis]:
    """Return what is said of the shifts in a log, from the file to results."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    diagnoses = [diagnosis for batch in read_log(path) for diagnosis in stages.feed(batch)]
    return [*diagnoses, *(stages.conclude(event) for event in stages.flush())]


def report_log(path: Path, name: str) -> None:
    """Print what a long log takes from file to shifts and to results, and how much memory grows on the way."""
    shifts_s = statistics.median([took_s(lambda: shifts_of(path)) for _ in range(LOG_ROUNDS)])
    diagnoses: list[Diagnosis] = []
    results_s = took_s(lambda: diagnoses.extend(results_of(path)))
    command = [sys.executable, "-m", "benchmarks.decode", "--memory-of", str(path)]
    growth_mib = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    time_verdict = verdict(shifts_s <= SHIFTS_TARGET_S)
    memory_verdict = verdict(growth_mib <= MEMORY_TARGET_MIB)
    each_ms = 1e3 * (results_s - shifts_s) / max(1, len(diagnoses))
    print(f"  {name:<8} to shifts  {shifts_s:6.2f} s   target <= {SHIFTS_TARGET_S} s: {time_verdict}")
    print(
        f"           to results {results_s:6.2f} s   {len(diagnoses)} shifts, the estimator's own {each_ms:.1f} ms each"
    )
    print(f"           memory grows by {growth_mib:5.1f} MiB   target <= {MEMORY_TARGET_MIB:.0f} MiB: {memory_verdict}")


def report_logs(count: int) -> None:
    """Print what a long log takes in both formats."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        drive = record_drive(folder, "--cycles", str(CYCLES))
        candump, blf = folder / "hour.log", folder / "hour.blf"
        duration_s = write_hour(drive, count, candump, blf)
        results_of(folder / "drive.log")  # compiles what is not compiled
        print(f"A log of {count} frames, {duration_s:.0f} s of this project's bus [s of one core, after warm-up]")
        report_log(candump, "candump")
        report_log(blf, "BLF")


def memory_growth_mib(path: Path) -> float:
    """Return by how much the memory grows from the first batches of a log to its end; its shifts are not kept."""
    warm_mib = 0.0

    def note(number: int) -> None:
        nonlocal warm_mib
        if number <= WARM_BATCHES:
            warm_mib = peak_mib()

    for _ in iterate_shifts(path, note):
        pass
    return max(0.0, peak_mib() - warm_mib)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=2_000_000, help="frames in memory (2000000)")
    parser.add_argument("--log-frames", type=int, default=3_600_000, help="frames of the log (3600000)")
    parser.add_argument("--memory-of", type=Path, metavar="LOG", help="print only the growth of memory [MiB]")
    arguments = parser.parse_args()
    if arguments.memory_of is not None:
        print(memory_growth_mib(arguments.memory_of))
        return 0
    print(machine())
    report_memory_decoding(arguments.frames)
    report_logs(arguments.log_frames)
    return 0


if __name__ == "__main__":
    sys.exit(main())
