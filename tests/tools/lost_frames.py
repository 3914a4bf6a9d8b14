"""Conversations with lost frames: every message that left a frame in the log is put together or counted, none invented.

Each log holds 40 messages of one protocol, of which every twentieth frame is lost by chance, flow control included.
What is put together and what is counted as incomplete must be as many as messages have a frame left; those of which
every frame is there must be put together.

    python -m tests.tools.lost_frames --logs 700
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass

from canlog.transport import Reassembler, Transfer
from tests.support.transport_traffic import MAKERS, Sent, Traffic, batch_of, generator

MESSAGES = 40
LOST_RATIO = 0.05
LARGEST_PRIME_BELOW_2_31 = 2_147_483_629


@dataclass(slots=True)
class Tally:
    """How logs of one protocol went, in messages."""

    seen: int = 0
    incomplete: int = 0
    invented: int = 0
    missed: int = 0  # whole in the log, and not put together
    uncounted: int = 0
    counted_twice: int = 0

    @property
    def is_good(self) -> bool:
        """Whether nothing is there that must not be."""
        return not (self.invented or self.missed or self.uncounted or self.counted_twice)

    def add(self, traffic: Traffic, kept: list[Sent], found: list[Transfer], incomplete: int) -> None:
        """Add one log: what was sent, what is left of it, and what was made of that."""
        sent, right = Counter(traffic.messages), Counter((one.can_id, one.data) for one in found)
        left = set(kept)
        broken = {one.message for one in traffic.frames if not one.is_answer and one not in left}
        whole = Counter(message for number, message in enumerate(traffic.messages) if number not in broken)
        seen = len({one.message for one in kept})
        self.seen += seen
        self.incomplete += incomplete
        self.invented += (right - sent).total()
        self.missed += (whole - right).total()
        self.uncounted += max(seen - len(found) - incomplete, 0)
        self.counted_twice += max(len(found) + incomplete - seen, 0)


def run(name: str, logs: int, first_seed: int) -> Tally:
    """Return how so many logs of one protocol went."""
    tally = Tally()
    for number in range(logs):
        rng = generator((first_seed + number * LARGEST_PRIME_BELOW_2_31) % (1 << 62))
        traffic = MAKERS[name](rng, MESSAGES)
        kept = [one for one in traffic.frames if rng.random() >= LOST_RATIO]
        reassembler = Reassembler()
        found = reassembler.feed(batch_of(kept)) + reassembler.close()
        tally.add(traffic, kept, found, reassembler.counts.incomplete_count)
    return tally


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=700, help="of each protocol (700)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    is_good = True
    for name in MAKERS:
        tally = run(name, options.logs, options.seed)
        is_good &= tally.is_good
        print(
            f"{name}: {options.logs} logs, {tally.seen} messages with a frame left, {tally.incomplete} counted as "
            f"incomplete; invented {tally.invented}, whole and missed {tally.missed}, not counted {tally.uncounted}, "
            f"counted twice {tally.counted_twice}",
            flush=True,
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
