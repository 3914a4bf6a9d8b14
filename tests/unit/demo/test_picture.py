"""The band of the friction curve, against the laws at both ends and against random draws between them."""

from pathlib import Path

import numpy as np
import pytest

from canlog.series import Series
from clutch_model.calibration import nominal_calibration
from clutch_model.friction import friction_law, stribeck_weights
from demo.picture import curve_band, draw
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from tests.unit.demo.outcomes import FRICTION, good_outcome

REFERENCE = nominal_calibration().clutches[0].friction
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def test_the_band_is_that_of_mu_s_at_lock_and_of_mu_c_far_from_it() -> None:
    mean, std = curve_band(np.array([0.0, 1e3]), FRICTION, REFERENCE)
    assert mean == pytest.approx([FRICTION.mu_s, FRICTION.mu_c])
    assert std == pytest.approx([FRICTION.std_mu_s, FRICTION.std_mu_c])


def test_the_band_agrees_with_random_draws() -> None:
    slip_rad_s = np.array([2.0, 6.0, 15.0])
    off_diagonal = FRICTION.correlation * FRICTION.std_mu_c * FRICTION.std_mu_s
    covariance = [[FRICTION.std_mu_c**2, off_diagonal], [off_diagonal, FRICTION.std_mu_s**2]]
    drawn = np.random.default_rng(1).multivariate_normal([FRICTION.mu_c, FRICTION.mu_s], covariance, 200_000)
    weight = stribeck_weights(slip_rad_s, friction_law(REFERENCE))
    curves = drawn @ np.vstack((1.0 - weight, weight))
    mean, std = curve_band(slip_rad_s, FRICTION, REFERENCE)
    assert mean == pytest.approx(curves.mean(axis=0), rel=1e-3)
    assert std == pytest.approx(curves.std(axis=0), rel=1e-2)


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    t_ns = np.arange(-50, 150) * 10_000_000
    series = Series(t_ns=t_ns, sequence=np.arange(len(t_ns)), value=np.linspace(100.0, 300.0, len(t_ns)))
    event = Event(
        number=1,
        from_gear=1,
        to_gear=2,
        start_ns=0,
        end_ns=1_000_000_000,
        end_reason=EndReason.COMPLETE,
        columns={Signal.ENGINE_SPEED: series, Signal.CLUTCH2_PRESSURE: series, Signal.ENGINE_TORQUE: series},
        bad_frame_count=0,
    )
    path = tmp_path / "demo.png"
    draw(path, event, good_outcome())
    content = path.read_bytes()
    assert content.startswith(PNG_MAGIC)
    assert len(content) > 20_000
