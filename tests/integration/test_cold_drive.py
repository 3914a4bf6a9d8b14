"""Drives from cold of cars whose films and open packs obey other laws than the service believes."""

import numpy as np

from studies.drive_accuracy import Case, driven, used_of

WORST_STD = 4.5


def test_cold_oil_of_another_kind_misleads_nobody() -> None:
    """Of worn fluid. Taken for closed, such films passed for friction half as large, at a stated 6 %."""
    case = Case(seed=120013, trace="udds", oil_degc=-10.0, has_mismatch=False, has_other_laws=True, loss_ratio=0.0)
    (outcome,) = driven(case)
    errors = np.array([(*look.absolute, *look.free) for look in outcome.looks])
    stds = np.array([(*look.absolute_std, *look.free_std) for look in outcome.looks])
    assert len(errors) > 50
    assert np.abs(errors / stds).max() < WORST_STD
    assert not outcome.wrong_verdicts
    assert used_of(outcome.slip_ms) > 0.75 * outcome.whole_slip_ms  # of launches the pieces after the film has closed
