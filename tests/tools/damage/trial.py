"""One format after the other: damages, their outcomes, and what was wrong with them."""

import faulthandler
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.tools.damage.expected import faults, is_noticed
from tests.tools.damage.kinds import DAMAGES, Recording
from tests.tools.damage.recordings import SUFFIXES, WRITERS, analyse, frame_decoder, short_drive
from tests.tools.damage.tables import GRAMMARS, TABLE_DAMAGES, decoder_of, short_table

LIMIT_S = 10.0  # of processor time, for one damaged recording
HANG_S = 120.0  # of any time: the trial ends here, with a traceback


@dataclass(slots=True, kw_only=True)
class Tally:
    """How the damages to one format went."""

    log_format: str
    count: int = 0
    refused: int = 0
    noticed: int = 0
    accepted: int = 0  # estimates
    slowest_s: float = 0.0
    total_s: float = 0.0
    wrong: list[str] = field(default_factory=list)

    @property
    def said(self) -> str:
        """All of it, for people."""
        return (
            f"{self.log_format}: {self.count} damages, {self.noticed} noticed, {self.refused} refused, "
            f"{self.accepted} estimates accepted, slowest {self.slowest_s:.2f} s, all {self.total_s:.0f} s of "
            f"processor time; wrong: {len(self.wrong)}"
        )


def run(log_format: str, count: int, seed: int, folder: Path) -> Tally:
    """Damage a recording so often; return how it went."""
    is_table = log_format in GRAMMARS
    suffix = GRAMMARS[log_format][0] if is_table else SUFFIXES[log_format]
    path, decoder, damages = folder / f"sound{suffix}", frame_decoder, DAMAGES
    if is_table:
        GRAMMARS[log_format][1](path, short_table())
        decoder, damages = decoder_of(path), TABLE_DAMAGES
    else:
        WRITERS[log_format](path, short_drive())
    recording = Recording(
        log_format=log_format, path=path, contents=path.read_bytes(), target=folder / f"damaged{suffix}"
    )
    sound = analyse(path, decoder)
    tally = Tally(log_format=log_format)
    if sound.error or not sound.estimates:
        tally.wrong.append(f"the sound recording: {sound.error or 'no shift'}")
        return tally
    for number in range(count):
        name, damage = list(damages.items())[number % len(damages)]
        print(f"\r{log_format} {number + 1} of {count}: {name:16}", end="", file=sys.stderr, flush=True)
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        expected = damage(recording, np.random.default_rng([seed, number]))
        began_s = time.process_time()
        outcome = analyse(recording.target, decoder)
        took_s = time.process_time() - began_s
        faulthandler.cancel_dump_traceback_later()
        problems = [*faults(expected, outcome, sound)]
        if took_s > LIMIT_S:
            problems.append(f"took {took_s:.1f} s")
        tally.wrong += [f"{name}, number {number}: {problem}" for problem in problems]
        tally.count += 1
        tally.refused += outcome.error != ""
        tally.noticed += is_noticed(outcome, sound)
        tally.accepted += sum(estimate.friction is not None for estimate in outcome.estimates)
        tally.slowest_s, tally.total_s = max(tally.slowest_s, took_s), tally.total_s + took_s
    print("\r", end="", file=sys.stderr)
    return tally
