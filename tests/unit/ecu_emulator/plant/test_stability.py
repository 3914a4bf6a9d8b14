import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.errors import CalibrationError
from ecu_emulator.plant import DriveSettings, Powertrain, nominal_parameters


def test_a_step_the_synchroniser_outruns_is_refused() -> None:
    parameters = nominal_parameters()
    with pytest.raises(CalibrationError, match=r"dt_s must be <= 3\.38e-04 s.*synchroniser of gear 1"):
        Powertrain(nominal_calibration(), parameters, DriveSettings(dt_s=5e-4))
    assert Powertrain(nominal_calibration(), parameters, DriveSettings(dt_s=2.5e-4)).time_s == 0.0
