"""Three shifts as a log and as a table, damaged as disks and recorders do it, and what must not come of that."""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from canlog.errors import SourceError
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from clutch_results.records import ShiftEstimate
from dbc.contract import load_contract
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.learning import proposed_profile
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.drive.recording import Drive
from ecu_emulator.log_formats import open_log
from studies.scan_tool import TableOptions, write_table
from tests.support.builders import drive_scenario

DURATION_S: Final = 10.0  # three shifts
MOST_STD: Final = 4.0  # an estimate may be off, by its own account

Generator = np.random.Generator
Damage = Callable[[bytes, Generator], bytes]


@cache
def drive() -> tuple[EncodedFrames, tuple[dict[str, float], ...]]:
    """Return the frames of three shifts, and the friction of the clutches."""
    driven = Drive(drive_scenario("ideal"))
    friction = tuple({"mu_c": driven.truth.mu_c[clutch], "mu_s": driven.truth.mu_s[clutch]} for clutch in (0, 1))
    return next(driven.stretches(DURATION_S)).frames, friction


def record(path: Path) -> None:
    """Write the drive as a log, or as the table that a scan tool records."""
    log = path.with_suffix(".log") if path.suffix == ".csv" else path
    with open_log(log) as out:
        out.write(drive()[0])
    if log != path:
        write_table(log, TableOptions(path=path, rate_hz=50.0, jitter_s=0.002, skew_ratio=0.5), 1)


def decoder_of(path: Path) -> Callable[[], Decoder]:
    """Return what makes decoders: of our own bus, or by the profile that is proposed for a sound table."""
    if path.suffix != ".csv":
        return lambda: Decoder(load_contract(), load_profile())
    profile = path.with_suffix(".toml")
    profile.write_text(proposed_profile(path), encoding="utf-8")
    return interpret(None, profile).decoder


def analyse(path: Path, decoder: Callable[[], Decoder]) -> tuple[list[ShiftEstimate], str]:
    """Read and diagnose a recording; return its estimates, and the error with which reading ended."""
    calibration = nominal_calibration()
    stages = Stages(decoder(), calibration)
    estimates: list[ShiftEstimate] = []
    try:
        for batch in read_log(path):
            estimates += [stages.conclude(event).estimate for event in stages.segment(batch)]
        estimates += [stages.conclude(event).estimate for event in stages.flush()]
    except SourceError as exc:
        return estimates, str(exc)
    return estimates, ""


def untrue(estimates: list[ShiftEstimate]) -> Iterator[str]:
    """Yield what accepted estimates say that the truth contradicts."""
    for estimate in estimates:
        for name, true in drive()[1][estimate.clutch - 1].items() if estimate.friction else ():
            value, std = getattr(estimate.friction, name), getattr(estimate.friction, f"std_{name}")
            if abs(value - true) > MOST_STD * std:
                yield f"{name} of the shift at {estimate.start_ns} ns is {value:.4f} ± {std:.4f}, not {true:.4f}"


def flip_bits(sound: bytes, rng: Generator) -> bytes:
    """Flip up to 20 bits anywhere."""
    contents = bytearray(sound)
    for place in rng.integers(0, len(contents), int(rng.integers(1, 20))):
        contents[place] ^= 1 << int(rng.integers(8))
    return bytes(contents)


def cut(sound: bytes, rng: Generator) -> bytes:
    """End the file anywhere."""
    return sound[: int(rng.integers(1, len(sound)))]


def replace_piece(sound: bytes, rng: Generator) -> bytes:
    """Put up to 5,000 bytes of anything in the place of as many others, or between them."""
    first, size = int(rng.integers(0, len(sound))), int(rng.integers(0, 5_000))
    return sound[:first] + rng.bytes(int(rng.integers(0, 5_000))) + sound[first + size :]


def repeat_piece(sound: bytes, rng: Generator) -> bytes:
    """Write a piece twice: frames come again, and time jumps back."""
    first, size = int(rng.integers(0, len(sound))), int(rng.integers(50, 200_000))
    return sound[: first + size] + sound[first:]


def swap_lines(sound: bytes, rng: Generator) -> bytes:
    """Swap two lines, times and all."""
    lines = sound.splitlines(keepends=True)
    first, second = rng.choice(np.arange(1, len(lines)), 2, replace=False).tolist()
    lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


def lose_lines(sound: bytes, rng: Generator) -> bytes:
    """Leave out some lines, alone and in a row."""
    lines = sound.splitlines(keepends=True)
    first = int(rng.integers(1, len(lines)))
    lost = {*rng.integers(1, len(lines), 30).tolist(), *range(first, first + 60)}
    return b"".join(line for number, line in enumerate(lines) if number not in lost)


DAMAGES: Final[tuple[Damage, ...]] = (flip_bits, cut, replace_piece, repeat_piece, swap_lines, lose_lines)
