"""Signals of a bus and rows of a table differ in the model of their noise alone."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.records import LEAST_SLIP_ROWS
from diag_service.diagnosis.alignment import AlignedSignals, usable_signals
from diag_service.diagnosis.friction.balance import (
    Balance,
    BusNoise,
    NoiseModel,
    RowNoise,
    Sensitivity,
    measurements_of,
    noise_of,
)
from diag_service.diagnosis.friction.drives import measured_drives, slip_window
from diag_service.diagnosis.friction.film import VehicleLaws
from diag_service.diagnosis.friction.posterior import Posterior
from tests.support.shifts_of_a_drive import first_shifts

CALIBRATION = nominal_calibration()
AT = Posterior.fresh(CALIBRATION).known.mean
EVENT = first_shifts()[0]


def signals(row_s: float = 0.0) -> AlignedSignals:
    found = usable_signals(EVENT, CALIBRATION)
    assert isinstance(found, AlignedSignals)
    return replace(found, row_s=row_s)


def balance(of: AlignedSignals, torque: TorqueSource = TorqueSource.MEASURED) -> Balance:
    laws = VehicleLaws.of(replace(CALIBRATION, torque=torque))
    drives = measured_drives(of, AT, None, EVENT.start_ns, laws.packs)
    found = slip_window(of, drives, laws.packs)
    assert found is not None
    return Balance(of, found[0], drives, laws, AT)


def test_a_bus_and_a_table_have_models_of_their_own() -> None:
    bus, table = noise_of(signals()), noise_of(signals(0.02))
    assert (type(bus), type(table)) == (BusNoise, RowNoise)
    assert [bus.scale_ratio, table.scale_ratio] == pytest.approx([0.0, 0.03 * (0.02 / 0.06) ** 2])
    assert (bus.is_alike, table.is_alike) == (False, True)
    assert (bus.least_count, table.least_count) == (0, LEAST_SLIP_ROWS)


@pytest.mark.parametrize("row_s", [0.0, 0.02])
def test_what_a_model_says_of_a_balance_is_a_covariance(row_s: float) -> None:
    found = balance(signals(row_s))
    model: NoiseModel = noise_of(found.signals)
    covariances = model.covariances(Sensitivity(found))
    assert sum(len(one) for one in covariances) == len(found.residual_nms())
    for covariance in covariances:
        assert covariance == pytest.approx(covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_samples_that_err_by_themselves_err_alike_in_both_models() -> None:
    """Rows without a curve through them are samples of a bus: the models differ by the means that one takes."""

    def stds(of: AlignedSignals) -> FloatArray:
        return np.asarray(
            np.sqrt(np.concatenate([np.diag(one.covariance) for one in measurements_of(balance(of), noise_of(of))]))
        )

    apart = signals(1e-9)  # a table so fast that its rows are never apart
    assert stds(apart) == pytest.approx(stds(signals()), rel=0.05)


def test_a_modelled_torque_tells_less_whatever_its_samples_are() -> None:
    for of in (signals(), signals(0.02)):
        plain, modelled = (
            measurements_of(balance(of, torque), noise_of(of))[0].covariance
            for torque in (TorqueSource.MEASURED, TorqueSource.MODELLED)
        )
        assert np.linalg.eigvalsh(modelled - plain).min() > -1e-9 * np.trace(modelled)
        assert np.trace(modelled) > 2.0 * np.trace(plain)
