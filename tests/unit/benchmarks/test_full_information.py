"""The study of the full-information estimator: its runs, its figures, its targets."""

from dataclasses import replace

import pytest

from benchmarks.full_information.study import jobs_of, lines, misses
from benchmarks.reproduce.drives import Case
from benchmarks.reproduce.full_route import Found, figures
from benchmarks.reproduce.tables import full_columns

KEY = (Case.IDEAL, 1, "mu_c")
RUN = Found(key=KEY, error=0.1, std=0.2, random_std=0.1, bound=0.1, is_slope_right=True)


def test_every_drive_gets_its_share_of_different_draws() -> None:
    noisy, noiseless = jobs_of(12, 5)
    assert len(noiseless) == 3 * 5
    for case in Case:
        mine = [job for job in noisy if job.case is case]
        assert len({job.noise_seed for job in mine}) == len(mine) == 12
        assert len({job.drive_seed for job in mine}) == 5


def test_figures_are_of_the_runs() -> None:
    one = figures([RUN, replace(RUN, error=-0.3, is_slope_right=False)])[KEY]
    assert one.count == 2
    assert (one.mean, one.worst) == pytest.approx((-0.1, 0.3))
    assert one.rms == pytest.approx(0.05**0.5)
    assert (one.coverage, one.random_coverage, one.slope_right) == (1.0, 0.5, 0.5)
    assert one.bound_ratio == pytest.approx(5.0**0.5)


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        ({}, []),
        ({"error": 0.31, "std": 0.2}, ["RMS"]),
        ({"error": 0.25, "std": 0.1}, ["coverage"]),
        ({"is_slope_right": False}, ["slope"]),
        ({"error": float("nan")}, ["RMS", "coverage"]),
    ],
)
def test_a_line_says_what_it_misses(change: dict[str, float], missed: list[str]) -> None:
    clean = figures([replace(RUN, error=0.01)])
    noisy = figures([replace(RUN, **change)])  # type: ignore[arg-type]  # one dict, several types
    assert misses(KEY, noisy[KEY], clean[KEY]) == missed
    assert misses(KEY, clean[KEY], figures([replace(RUN, error=0.11)])[KEY]) == ["noiseless"]
    heading, line = lines(noisy, clean)
    assert heading.split()[-1] == "target"
    assert line.endswith(f"misses {', '.join(missed)}" if missed else "met")


def test_the_columns_of_the_report_stand_beside_the_others() -> None:
    noisy = full_columns(figures([RUN, replace(RUN, error=-0.1)]), is_random=True)
    assert [column.cells[KEY] for column in noisy.columns] == ["+0.00", "0.10", "0.20", "100 %", "1.00", "100 %"]
    clean = full_columns(figures([RUN]), is_random=False)
    assert [column.cells[KEY] for column in clean.columns] == ["+0.100", "100 %"]
