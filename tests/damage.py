"""Damage to recordings, generated, and what the service makes of it.

A sound recording is damaged in one way after the other: bits flipped, ends cut off, garbage put in, lines or pieces
swapped, times made to jump. Whatever is done, reading ends, nothing breaks, counts say what was found, and no shift is
estimated far from what the sound recording gave.

    python -m tests.damage --format blf --count 200
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from clutch_model.calibration import nominal_calibration
from dbc.contract import DBC_PATH
from diag_service.condition import ConditionMemory
from diag_service.database import load_database
from diag_service.errors import SourceError
from diag_service.estimation import Belief
from diag_service.mapping import Decoder
from diag_service.pipeline import Stages
from diag_service.profile import load_profile
from diag_service.records import ShiftEstimate, Status
from diag_service.sources import LogCounts, read_log
from ecu_emulator.frames import EncodedFrames
from ecu_emulator.record import open_log
from ecu_emulator.recording import Drive
from tests.builders import drive_scenario

SUFFIXES = {
    "candump": ".log",
    "blf": ".blf",
    "asc": ".asc",
    "mf4": ".mf4",
    "trc": ".trc",
    "csv": ".csv",
    "gvret": ".gvret.csv",
}
DURATION_S = 10.0
LIMIT_S = 10.0  # of processor time, for one damaged recording
MOST_STD = 5.0  # an estimate from damaged data may differ, by its own account
TEXTS = frozenset({"candump", "asc", "trc", "csv", "gvret"})

Generator = np.random.Generator
Damage = Callable[[bytearray, Generator], bytearray]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one recording."""

    estimates: tuple[ShiftEstimate, ...]
    counts: LogCounts | None
    error: str


def flip_bits(contents: bytearray, rng: Generator) -> bytearray:
    for place in rng.integers(0, len(contents), int(rng.integers(1, 20))):
        contents[place] ^= 1 << int(rng.integers(8))
    return contents


def cut(contents: bytearray, rng: Generator) -> bytearray:
    return contents[: int(rng.integers(1, len(contents)))]


def insert_garbage(contents: bytearray, rng: Generator) -> bytearray:
    place = int(rng.integers(0, len(contents)))
    return contents[:place] + bytearray(rng.bytes(int(rng.integers(1, 5_000)))) + contents[place:]


def remove_piece(contents: bytearray, rng: Generator) -> bytearray:
    place = int(rng.integers(0, len(contents)))
    return contents[:place] + contents[place + int(rng.integers(1, 5_000)) :]


def swap_pieces(contents: bytearray, rng: Generator) -> bytearray:
    """Swap two lines of a text, two pieces of anything else."""
    size = int(rng.integers(20, 2_000))
    first, second = sorted(int(place) for place in rng.integers(0, max(1, len(contents) - 2 * size), 2))
    first, second = (contents.find(b"\n", place) + 1 for place in (first, second + size))
    ends = [contents.find(b"\n", place) + 1 for place in (first, second)]
    if not first < ends[0] <= second < ends[1]:
        return contents
    return (
        contents[:first] + contents[second : ends[1]] + contents[ends[0] : second] + contents[first : ends[0]]
        + contents[ends[1] :]
    )  # fmt: skip


def repeat_piece(contents: bytearray, rng: Generator) -> bytearray:
    """Write a piece twice: frames come again, and time jumps back."""
    place = int(rng.integers(0, len(contents)))
    piece = contents[place : place + int(rng.integers(50, 200_000))]
    return contents[: place + len(piece)] + piece + contents[place + len(piece) :]


DAMAGES: tuple[Damage, ...] = (flip_bits, cut, insert_garbage, remove_piece, swap_pieces, repeat_piece)


@cache
def short_drive() -> EncodedFrames:
    """Return the frames of three shifts."""
    return next(Drive(drive_scenario("ideal")).stretches(DURATION_S)).frames


def write_recording(path: Path) -> Path:
    """Record a short drive in the format of the path's suffix."""
    with open_log(path) as log:
        log.write(short_drive())
    return path


def analyse(path: Path) -> Outcome:
    """Read and diagnose a recording."""
    calibration = nominal_calibration()
    decoder = Decoder(load_database(DBC_PATH), load_profile())
    stages = Stages(decoder, calibration, Belief.fresh(calibration), ConditionMemory.fresh())
    estimates: list[ShiftEstimate] = []
    reader = None
    try:
        reader = read_log(path)
        for batch in reader:
            estimates += [stages.conclude(event).estimate for event in stages.segment(batch)]
        estimates += [stages.conclude(event).estimate for event in stages.flush()]
    except SourceError as exc:
        return Outcome(tuple(estimates), reader.counts if reader else None, str(exc))
    return Outcome(tuple(estimates), reader.counts, "")


def faults(damaged: Outcome, sound: Outcome) -> list[str]:
    """Return what must not happen: estimates that contradict those of the sound recording, by their own account."""
    found: list[str] = []
    by_time = {estimate.start_ns: estimate for estimate in sound.estimates}
    for estimate in damaged.estimates:
        other = by_time.get(estimate.start_ns)
        if estimate.status is not Status.VALID or estimate.friction is None or other is None or other.friction is None:
            continue
        difference = abs(estimate.friction.mu_c - other.friction.mu_c)
        std = max(estimate.friction.std_mu_c, other.friction.std_mu_c)
        if difference > MOST_STD * std:
            found.append(f"mu_C of the shift at {estimate.start_ns} ns differs by {difference:.4f}, std {std:.4f}")
    if "\n" in damaged.error:
        found.append("an error of several lines")
    return found


def is_noticed(damaged: Outcome, sound: Outcome) -> bool:
    """Return whether anything says that the recording is not what it was."""
    return damaged.error != "" or damaged.counts != sound.counts


def run(log_format: str, count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Damage a recording so often; return how it went, and what must not have happened."""
    sound_path = write_recording(folder / f"sound{SUFFIXES[log_format]}")
    sound, contents = analyse(sound_path), sound_path.read_bytes()
    tally: Counter[str] = Counter()
    wrong: list[str] = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        damage = DAMAGES[number % len(DAMAGES)]
        path = folder / f"damaged{SUFFIXES[log_format]}"
        path.write_bytes(damage(bytearray(contents), rng))
        began_s = time.process_time()
        outcome = analyse(path)
        problems = faults(outcome, sound)
        if time.process_time() - began_s > LIMIT_S:
            problems.append(f"took more than {LIMIT_S} s")
        wrong += [f"{damage.__name__}, number {number}: {problem}" for problem in problems]
        tally["refused" if outcome.error else "read"] += 1
        tally["noticed"] += is_noticed(outcome, sound)
    return tally, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--format", choices=SUFFIXES, action="append", help="default: all")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    is_sound = True
    with TemporaryDirectory() as folder:
        for log_format in options.format or SUFFIXES:
            tally, wrong = run(log_format, options.count, options.seed, Path(folder))
            is_sound &= not wrong
            counts = ", ".join(f"{count} {name}" for name, count in sorted(tally.items()))
            print(f"{log_format}: {options.count} damages: {counts}; wrong: {len(wrong)}", flush=True)
            for problem in wrong:
                print(f"  {problem}", flush=True)
    return 0 if is_sound else 1


if __name__ == "__main__":
    sys.exit(main())
