"""Run the study: ``python -m studies.full_information [--seeds N] [--drives N]``; status 1 if a target is missed."""

import argparse
import sys

from rich.console import Console
from rich.progress import Progress

from studies.full_information.study import BOUND_RATIO_AIM, jobs_of, lines, misses
from studies.reproduce.full_route import figures, run_all


def main() -> int:
    """Run every drive and print the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.full_information", description="Full information against the Cramér-Rao bound."
    )
    parser.add_argument("--seeds", type=int, default=50, help="draws of the noise per set (default: %(default)s)")
    parser.add_argument("--drives", type=int, default=5, help="different drives per set (default: %(default)s)")
    options = parser.parse_args()
    if not 1 <= options.drives <= options.seeds:
        parser.error("--drives must be 1 or more, and --seeds no fewer")
    noisy_jobs, noiseless_jobs = jobs_of(options.seeds, options.drives)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("drives", total=len(noisy_jobs) + len(noiseless_jobs))
        noisy = figures(run_all(noisy_jobs, lambda: progress.advance(task)))
        noiseless = figures(run_all(noiseless_jobs, lambda: progress.advance(task)))
    print("percent of the true value; random std and the coverage behind it leave out the floor of the stated std")
    print("\n".join(lines(noisy, noiseless)))
    within_aim = sum(one.bound_ratio <= BOUND_RATIO_AIM for one in noisy.values())
    print(f"RMS within {BOUND_RATIO_AIM} times the bound: {within_aim} of {len(noisy)} lines")
    return int(any(misses(key, noisy[key], noiseless[key]) for key in noisy))


if __name__ == "__main__":
    sys.exit(main())
