"""Drives on the road, warm and cold, of unknown vehicles whose film, oil and lining differ from the belief."""

from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np

from studies.drive_accuracy import END, MOMENTS, Case, Outcome, driven
from studies.run import over_drives, percent, root_mean_square

FIRST_SEED: Final = 94_000
DRIVES: Final = (("udds", 80.0), ("us06", 80.0), ("wltc", 20.0), ("us06", 0.0), ("udds", -10.0))  # trace, oil [degC]


def road_section(vehicles: int, jobs: int) -> Iterator[str]:
    """Drive, and yield a section of the page; each kind of drive with other vehicles."""
    yield "## On the road"
    yield ""
    yield (
        "Vehicles drawn with all that `python -m studies.self_calibration --mismatch` draws, film, oil and lining "
        f"included, whom the service has never met: one drive each, {vehicles} vehicles a row, seeds from "
        f"{FIRST_SEED}. Coverage is that of the absolute values at every moment looked at: after 2, 5, 10 and 30 "
        "events, and at the end."
    )
    yield ""
    yield (
        "| drive | oil at the start, degC | in 2 total std, mu_C, mu_S % | at the end: RMS mu_C, mu_S % "
        "| scale-free RMS mu_C, mu_S % | in 2 std % | drives with a wrong verdict at any moment |"
    )
    yield "|---|---|---|---|---|---|---|"
    case = partial(Case, is_plain=False, has_mismatch=True, loss_ratio=0.0)
    for row, (trace, oil_degc) in enumerate(DRIVES):
        seeds = range(FIRST_SEED + 100 * row, FIRST_SEED + 100 * row + vehicles)
        outcomes = over_drives(driven, [case(seed=seed, trace=trace, oil_degc=oil_degc) for seed in seeds], jobs)
        yield _line(trace, oil_degc, outcomes)
    yield ""


def _line(trace: str, oil_degc: float, outcomes: list[Outcome]) -> str:
    looks = [look for outcome in outcomes for look in outcome.looks if look.moment in {*MOMENTS, END}]
    errors, stds = (np.array([getattr(one, name) for one in looks]) for name in ("absolute", "absolute_std"))
    inside = np.mean(np.abs(errors) <= 2.0 * stds, axis=0).tolist()
    ends = [look for look in looks if look.moment == END]
    absolute, free, free_std = (
        np.array([getattr(one, name) for one in ends]) for name in ("absolute", "free", "free_std")
    )
    free_inside = float(np.mean(np.abs(free) <= 2.0 * free_std))
    wrong = sum(bool(one.wrong_verdicts) for one in outcomes)
    return (
        f"| {trace.upper()} | {oil_degc:.0f} | {percent(inside[0])}, {percent(inside[1])} "
        f"| {root_mean_square(absolute[:, 0]):.2f}, {root_mean_square(absolute[:, 1]):.2f} "
        f"| {root_mean_square(free[:, 0]):.2f}, {root_mean_square(free[:, 1]):.2f} | {percent(free_inside)} | {wrong} |"
    )
