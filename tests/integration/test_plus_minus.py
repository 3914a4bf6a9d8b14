"""Behind ± stand two standard deviations, wherever people read; each head or legend says so."""

import io
from collections.abc import Callable, Iterable
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, cast

import pytest
from rich.console import Console, RenderableType

from demo.outcome import live_line, tables
from diag_service.api.picture import draw
from diag_service.commands.learn import said
from diag_service.delivery import ConsoleReporter
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.records import shift_record
from diag_service.mapping.learning import Found, LearnedGear, LearnedVehicle
from diag_service.mapping.proposal import GearRatio, gears_text
from diag_service.report.history import history_lines
from diag_service.report.page import html_of, page_of
from diag_service.service import calibrate_run
from fleet_backend import report
from fleet_backend.follow import _finding
from fleet_backend.page import clutches_view, shift_view
from tests.support.builders import friction_estimate, shift_result
from tests.support.histories import findings
from tests.unit.demo.outcomes import good_outcome
from tests.unit.diag_service.delivery.test_reporters import numbers

FRICTION = friction_estimate()
MU_C, MU_S = (f"{2.0 * std:.4f}" for std in (FRICTION.std_mu_c, FRICTION.std_mu_s))
SAID = "± two standard deviations"
RATIO = GearRatio(ratio=3.462, std=0.006, sample_count=99)


def printed(*parts: RenderableType) -> str:
    out = io.StringIO()
    console = Console(file=out, width=250)
    for part in parts:
        console.print(part)
    return out.getvalue()


def analyze(*, is_detailed: bool) -> str:
    out = io.StringIO()
    reporter = ConsoleReporter(Console(file=out, width=250), is_detailed=is_detailed)
    reporter.report(shift_result(1))
    reporter.report(numbers())
    return out.getvalue()


def calibrate(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(calibrate_run, "friction_of", lambda *_: FRICTION)
    found = SimpleNamespace(
        state=None, run_up_counts=(0, 0), shift_counts=(1, 1), rejected_count=0, mean_misfit=1.0, is_scale_observed=True
    )
    lines = calibrate_run._lines(cast("Any", found), cast("Any", "car.toml"))
    return "\n".join([next(lines), next(lines)])


def follow() -> str:
    return _finding(shift_record(shift_result(1)))


def fleet() -> str:
    row = {"vehicle": "car1", "condition": "good", "mu_c": FRICTION.mu_c, "element": None, "clutch": 1, "mu_s": None}
    row |= {"running_mu_c": FRICTION.mu_c, "running_std_mu_c": FRICTION.std_mu_c, "end_at": None, "fluid": None}
    row |= {"random_std_mu_c": FRICTION.std_mu_c, "running_mu_s": FRICTION.mu_s, "running_std_mu_s": FRICTION.std_mu_s}
    out = io.StringIO()
    report.show(report.trend_table("car1", [row]), out)
    return out.getvalue().replace("±0", "± 0")


def page() -> str:
    """Return heads and cells of the pages of a fleet."""
    own = asdict(FRICTION)
    now = cast("Any", SimpleNamespace(std_mu_c=FRICTION.std_mu_c))
    answer = cast("Any", SimpleNamespace(friction=own, running=own))
    rows: list[Iterable[object]] = [*shift_view._friction_rows(answer), [clutches_view._COLUMNS[SAID](now)]]
    return " ".join([*shift_view._FRICTION_HEAD, *(str(getattr(cell, "text", cell)) for row in rows for cell in row)])


FACES: dict[str, Callable[[], str]] = {
    "analyze": lambda: analyze(is_detailed=False),
    "analyze --verbose": lambda: analyze(is_detailed=True),
    "demo": lambda: printed(*tables(good_outcome())),
    "history": lambda: printed(*history_lines(findings(4), (1, 2), most_rows=9)),
    "report": lambda: html_of(page_of(findings(4), "2026-03-01T12:00:00.000000Z")),
    "fleet-backend follow": follow,
    "fleet-backend trend": fleet,
    "fleet page": page,
}


@pytest.mark.parametrize("face", FACES)
def test_every_face_of_a_result_shows_one_half_width_and_says_which(face: str) -> None:
    text = FACES[face]()
    assert SAID in text
    if face in {"history", "report"}:  # of results of their own
        (mu_c, *_) = (one.verdict.friction for one in findings(4).latest if one.verdict.friction)
        assert f"{2.0 * mu_c.std_mu_c:.4f}" in text
        assert f"± {mu_c.std_mu_c:.4f}" not in text
        return
    assert MU_C in text
    assert "0.0012" not in text


def test_a_line_as_it_comes_shows_the_same() -> None:
    assert f"{FRICTION.mu_c:.4f} ± {MU_C}  mu_S {FRICTION.mu_s:.4f} ± {MU_S}" in str(live_line(shift_result(1)))


def test_what_is_calibrated_or_learned_shows_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    text = calibrate(monkeypatch)
    assert f"± {MU_C}" in text
    assert SAID in text
    assert "3.462 ± 0.012" in gears_text(Signal.OUTPUT_SPEED, {1: RATIO})
    assert SAID in gears_text(Signal.OUTPUT_SPEED, {1: RATIO})
    first = LearnedGear(ratio=RATIO, clutch=1)
    touch = {1: Found(value=1.2e5, std=4e3, origin="held")}
    told = "\n".join(said(LearnedVehicle(over=Signal.OUTPUT_SPEED, gears={1: first}, are_named=True, touch_pa=touch)))
    assert SAID in told
    assert "3.462 ± 0.012" in told
    assert "touch point 1.20 ± 0.08 bar" in told


def test_bars_of_a_picture_are_as_wide_as_its_bands() -> None:
    figure = draw([shift_result(number) for number in (1, 2, 3)], "drive.log")
    axes = figure.axes[1]  # clutch 2
    (bars,) = axes.containers[0][2]
    low, high = bars.get_segments()[0][:, 1]
    assert high - low == pytest.approx(4.0 * FRICTION.std_mu_c)
    assert SAID in axes.get_xlabel()
