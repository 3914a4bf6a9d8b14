"""Random messages of several frames, put together by canlog and by others: none lost without a count, none invented.

Each case is a conversation of one kind of transport, whole, with frames lost, or with frames cut. ISO-TP is held
against can-isotp, J1939 transport against a plain assembler written from the standards.

    python -m tests.tools.assembled 20000
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field

from canlog.transport import Reassembler, Transfer
from tests.support.transport_cases import KINDS, conversation, damaged
from tests.support.transport_traffic import Sent, batch_of, generator

MESSAGES = 12
DAMAGES = ("whole", "lost", "cut")
LARGEST_PRIME_BELOW_2_31 = 2_147_483_629


@dataclass(slots=True)
class Outcome:
    """How cases of one kind went, in messages."""

    seen: int = 0  # with a frame left
    whole: int = 0
    incomplete: int = 0
    faults: dict[str, list[int]] = field(default_factory=dict)  # seeds by what was wrong

    def note(self, what: str, seed: int, count: int) -> None:
        """Remember what was wrong, if it was."""
        if count:
            self.faults.setdefault(what, []).append(seed)


def put_together(frames: list[Sent], cut: int) -> tuple[list[Transfer], int]:
    """Return what canlog finds in frames that come in two batches, and how many messages it calls incomplete."""
    reassembler, cut = Reassembler(), cut % (len(frames) + 1)
    found = [one for part in (frames[:cut], frames[cut:]) for one in reassembler.feed(batch_of(part))]
    return found + reassembler.close(), reassembler.counts.incomplete_count


def judge(kind: str, damage: str, seed: int, outcome: Outcome) -> None:
    """Hold one case against the other assembler and against what was sent."""
    rng = generator(seed)
    maker, assembler = KINDS[kind]
    traffic = conversation(rng, maker, MESSAGES)
    kept = damaged(rng, traffic.frames, damage)
    found, incomplete = put_together(kept, rng.randrange(1 << 30))
    own, sent = Counter((one.can_id, one.data) for one in found), Counter(traffic.messages)
    others = Counter(assembler(kept))
    seen = len({one.message for one in kept})
    outcome.seen, outcome.whole, outcome.incomplete = (
        outcome.seen + seen, outcome.whole + len(found), outcome.incomplete + incomplete,
    )  # fmt: skip
    outcome.note("invented", seed, (own - sent).total())
    outcome.note("found by the other alone", seed, ((others & sent) - own).total())
    outcome.note("lost without a count", seed, max(seen - len(found) - incomplete, 0))
    outcome.note("counted twice", seed, max(len(found) + incomplete - seen, 0))
    if damage == "whole":
        outcome.note("otherwise than sent", seed, (sent - own).total())
        outcome.note("otherwise than the other", seed, (others - own).total() + (own - others).total())


def run(cases: int, first_seed: int) -> dict[tuple[str, str], Outcome]:
    """Return how so many cases went, dealt out to kinds and damages."""
    outcomes = {(kind, damage): Outcome() for kind in KINDS for damage in DAMAGES}
    for number in range(cases):
        kind, damage = list(outcomes)[number % len(outcomes)]
        seed = (first_seed + number * LARGEST_PRIME_BELOW_2_31) % (1 << 62)
        judge(kind, damage, seed, outcomes[kind, damage])
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=int, nargs="?", default=3_000, help="in all (3000)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    outcomes = run(options.cases, options.seed)
    for (kind, damage), one in outcomes.items():
        wrong = ", ".join(f"{what} in {len(seeds)} cases, such as {seeds[0]}" for what, seeds in one.faults.items())
        print(
            f"{kind}, {damage}: {one.seen} messages with a frame left, {one.whole} put together, {one.incomplete} "
            f"counted as incomplete; {wrong or 'nothing wrong'}",
            flush=True,
        )
    return 1 if any(one.faults for one in outcomes.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
