"""Sample instants behind a jittering bus, and the even grid."""

from typing import TYPE_CHECKING

import numpy as np

from canlog.arrays import Series
from diag_service.diagnosis.alignment import sample_times_s, segment_centres_s

if TYPE_CHECKING:
    from canlog.arrays import FloatArray

PERIOD_NS = 10_000_000


def series_at(t_ns: np.ndarray, sequence: np.ndarray, period_ns: int = PERIOD_NS) -> Series:
    return Series(
        t_ns=t_ns.astype(np.int64), sequence=sequence.astype(np.int64), value=np.zeros(len(t_ns)), period_ns=period_ns
    )


def test_delays_are_taken_off_a_scheduled_message() -> None:
    rng = np.random.default_rng(1)
    sequence = np.delete(np.arange(150), [20, 21, 77])  # missing frames leave gaps, not shifts
    delays_ns = rng.exponential(8e5, len(sequence))
    delays_ns[40:45] = [5e7, 4e7, 3e7, 2e7, 1e7]  # a stalled receiver hands over five frames at once
    received = series_at(sequence * PERIOD_NS + delays_ns, sequence)
    times_s = sample_times_s(received, 0)
    assert np.max(np.abs(times_s - sequence * 0.01)) < 3e-5


def test_a_sender_that_is_mostly_late_is_still_on_its_schedule() -> None:
    sequence = np.arange(160)
    delays_ns = np.full(160, 3.5e7)
    delays_ns[[20, 21, 140, 141]] = 0.0
    times_s = sample_times_s(series_at(sequence * PERIOD_NS + delays_ns, sequence), 0)
    assert np.allclose(times_s, sequence * 0.01, atol=1e-12)


def test_a_sender_off_its_schedule_keeps_its_receive_times() -> None:
    sequence = np.arange(100)
    t_ns = sequence * PERIOD_NS * 1.3  # says 10 ms, sends every 13
    assert np.allclose(sample_times_s(series_at(t_ns, sequence), 0), t_ns * 1e-9)


def test_a_mean_over_a_crank_segment_belongs_to_its_centre() -> None:
    acceleration, segment = -200.0, 2.0943951023931953
    times_s = np.linspace(0.0, 0.5, 51)
    angle = 300.0 * times_s + 0.5 * acceleration * times_s**2

    def mean_speed(t: float, theta: float) -> float:
        # The time at which the crank stood one segment earlier, from the quadratic.
        back = np.roots([0.5 * acceleration, 300.0, -(theta - segment)])
        return float(segment / (t - min(back.real, key=lambda root: abs(root - t + 0.007))))

    means: FloatArray = np.array([mean_speed(t, theta) for t, theta in zip(times_s, angle, strict=True)])
    centres_s = segment_centres_s(times_s, means, segment)
    assert np.allclose(means, 300.0 + acceleration * centres_s, atol=0.01)
