"""Random clients against the diagnosis, beside a model from the standard: ``python -m tests.tools.uds_fuzz``."""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tests.support.uds.clients import RandomClient, codes_step, step
from tests.support.uds.pair import DisagreementError, Pair
from tests.support.uds.server_by_the_book import table

STEPS = 60


@dataclass
class Figures:
    sequences: int = 0
    steps: int = 0
    answered: int = 0
    silent: int = 0
    nrcs: dict[int, int] = field(default_factory=dict)
    disagreements: list[str] = field(default_factory=list)
    crashes: list[str] = field(default_factory=list)

    def add(self, pair: Pair) -> None:
        self.sequences += 1
        self.answered += pair.answered
        self.silent += pair.silent
        for nrc, count in pair.nrcs.items():
            self.nrcs[nrc] = self.nrcs.get(nrc, 0) + count


def run(
    what: Callable[[Pair, RandomClient], None], folder: Path, *, seed: int, is_enough: Callable[[Figures], bool]
) -> Figures:
    """Run sequences of steps, each on a new controller, until there are enough."""
    figures, document = Figures(), table()
    while not is_enough(figures):
        pair = Pair(folder)
        number = seed + figures.sequences
        client = RandomClient(
            Random(number),  # noqa: S311 - the same sequence each time
            document,
            list(pair.model.troubles),
        )
        try:
            for _ in range(STEPS):
                what(pair, client)
                figures.steps += 1
        except DisagreementError as told:
            figures.disagreements.append(f"sequence {number}: {told}")
        except Exception as exc:  # noqa: BLE001 - whatever it is, it is what is looked for
            figures.crashes.append(f"sequence {number}: {exc!r}")
        figures.add(pair)
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=10_000, help="of results, cycles, clears and restarts")
    parser.add_argument("--requests", type=int, default=100_000, help="random and mutated")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as name:
        for title, what, is_enough in (
            ("trouble codes", codes_step, lambda figures: figures.sequences >= options.sequences),
            ("requests", step, lambda figures: figures.answered + figures.silent >= options.requests),
        ):
            began_s = time.perf_counter()
            figures = run(what, Path(name), seed=options.seed, is_enough=is_enough)
            nrcs = ", ".join(f"{nrc:02X}: {count}" for nrc, count in sorted(figures.nrcs.items()))
            unanswered = sum("the product says nothing" in told for told in figures.disagreements)
            print(
                f"{title}: {figures.sequences} sequences, {figures.steps} steps, "
                f"{figures.answered + figures.silent} requests, {figures.silent} of them rightly unanswered, "
                f"{len(figures.crashes)} crashes, {len(figures.disagreements)} disagreements with the model, "
                f"{unanswered} of them left unanswered, {time.perf_counter() - began_s:.0f} s\n"
                f"  negative responses: {nrcs}",
                flush=True,
            )
            print("".join(f"  {told}\n" for told in [*figures.crashes, *figures.disagreements][:10]), end="")
            failed |= bool(figures.crashes or figures.disagreements)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
