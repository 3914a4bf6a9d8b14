"""Behind ± stand two standard deviations, wherever people read; each head or legend says so."""

import io
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console, RenderableType

from canlog.traffic import TrafficMeter
from clutch_results.records import shift_record
from demo.outcome import tables
from diag_service.api.analysis import draw_fan
from diag_service.api.learning import summary_lines
from diag_service.commands import inspect, learn
from diag_service.delivery import ConsoleReporter
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.prediction import Prediction
from diag_service.mapping.learning import LearnedGear, LearnedValue, LearnedVehicle
from diag_service.mapping.proposal import GearRatio, gears_text
from diag_service.report.history import history_lines
from diag_service.report.page import fan_for, html_of
from fleet_backend.database import open_database
from fleet_backend.follow import _finding
from fleet_backend.migrate import migrate
from fleet_backend.writer import Batch, Writer
from tests.support.batches import frames_at
from tests.support.builders import STREAM, friction_estimate, shift_result
from tests.support.fleet import row_of
from tests.support.fleet_page import asked, sources_of
from tests.support.histories import findings
from tests.unit.demo.outcomes import good_outcome
from tests.unit.diag_service.delivery.test_reporters import numbers

FRICTION = friction_estimate()
MU_C, MU_S = (f"{2.0 * std:.4f}" for std in (FRICTION.std_mu_c, FRICTION.std_mu_s))
SHIFT = f"/vehicles/car1/shift?stream={STREAM}&seq=1"
SAID, SHORT = "± two standard deviations", "± 2 std"
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
    monkeypatch.setattr(learn, "friction_of", lambda *_: FRICTION)
    found = SimpleNamespace(
        state=None, run_up_counts=(0, 0), shift_counts=(1, 1), rejected_count=0, mean_misfit=1.0, is_scale_observed=True
    )
    lines = learn._calibration_lines(cast("Any", found), cast("Any", "car.toml"))
    return "\n".join([next(lines), next(lines)])


def follow() -> str:
    return _finding(shift_record(shift_result(1)))


def page(path: str) -> str:
    """Return a page of a fleet of one vehicle."""
    with TemporaryDirectory() as folder:
        engine = open_database(f"sqlite:///{folder}/fleet.sqlite")
        migrate(engine)
        Writer(engine).store(Batch(shifts=[row_of(shift_result(1))]))
        (answer,) = asked(sources_of(engine), path)
        engine.dispose()
    return answer.text


FACES: dict[str, Callable[[], str]] = {
    "analyze": lambda: analyze(is_detailed=False),
    "analyze --verbose": lambda: analyze(is_detailed=True),
    "demo": lambda: printed(*tables(good_outcome())),
    "history": lambda: printed(*history_lines(findings(4), (1, 2), most_rows=9)),
    "report": lambda: html_of(findings(4), "2026-03-01T12:00:00.000000Z", is_full=True),
    "fleet-backend follow": follow,
    **{f"fleet page {path}": partial(page, path) for path in (SHIFT, "/vehicles/car1")},
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


def test_a_prediction_is_as_wide_as_two_of_its_deviations() -> None:
    change = Prediction(mean_rad_s=np.array([-100.0]), scale_rad_s=np.array([5.0 / 2.0**0.5]), freedom=4.0)  # std 5
    phase = SimpleNamespace(t_s=[0.0, 0.1], change_rad_s=np.array([-99.0]), from_gear=1, to_gear=2)
    shown = cast("Any", SimpleNamespace(log="a.log", phase=phase, predictions=defaultdict(lambda: change)))
    head, _, line, *_ = learn._lines("power upshifts", [shown])
    assert SAID in head
    assert "[rpm]" in head
    assert "-955 ± 95" in line


def test_intervals_of_frames_scatter_by_two_of_their_deviations() -> None:
    t_ns = np.cumsum(np.tile([9_000_000, 11_000_000], 100))  # 10 ms, standard deviation 1 ms
    meter = TrafficMeter(500_000)
    meter.add(frames_at(t_ns, 0x123))
    (row,) = meter.report().ids
    cells = dict(zip(("bus", "id", "message", *inspect._HEAD), inspect._row(row, ""), strict=True))
    assert float(cells["period ms"]) == pytest.approx(10.0, abs=0.02)
    assert float(cells[SHORT]) == pytest.approx(2.0, abs=0.02)


def test_what_is_calibrated_or_learned_shows_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    text = calibrate(monkeypatch)
    assert f"± {MU_C}" in text
    assert SAID in text
    assert "3.462 ± 0.012" in gears_text(Signal.OUTPUT_SPEED, {1: RATIO})
    assert SAID in gears_text(Signal.OUTPUT_SPEED, {1: RATIO})
    first = LearnedGear(ratio=RATIO, clutch=1)
    touch = {1: LearnedValue(value=1.2e5, std=4e3, origin="held")}
    learned = LearnedVehicle(over=Signal.OUTPUT_SPEED, gears={1: first}, are_named=True, touch_pa=touch)
    told = "\n".join(summary_lines(learned))
    assert SAID in told
    assert "3.462 ± 0.012" in told
    assert "touch point 1.20 ± 0.08 bar" in told


def test_bands_of_a_picture_are_two_deviations_wide() -> None:
    fan = fan_for(findings(4))
    assert fan is not None
    figure = draw_fan(fan, "car1")
    bands = figure.axes[0].collections[: len(fan.pasts)]
    assert [band.get_label() for band in bands if not str(band.get_label()).startswith("_")] == [SAID]
    for band, past in zip(bands, reversed(fan.pasts), strict=True):  # the first one is drawn on top
        edges = np.asarray(band.get_paths()[0].vertices)[:, 1]
        assert (edges.max(), edges.min()) == pytest.approx(
            ((past.left + 2.0 * past.std).max(), (past.left - 2.0 * past.std).min())
        )
