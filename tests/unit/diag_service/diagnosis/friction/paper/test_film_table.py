"""The two readings of the table of film against pressure."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import applied_pressure_pa, contact_pressure_pa, film_law
from diag_service.diagnosis.friction.paper.friction_data import static_table

CLUTCHES = nominal_calibration().clutches


@pytest.mark.parametrize("clutch", CLUTCHES)
@pytest.mark.parametrize("over_touch_pa", [0.3e5, 1.0e5, 3.0e5, 8.0e5])
def test_in_the_static_table_the_asperities_carry_the_load(clutch: object, over_touch_pa: float) -> None:
    believed = CLUTCHES[0] if clutch is CLUTCHES[0] else CLUTCHES[1]
    law = film_law(believed)
    pressure_pa = believed.touch_pressure_pa + over_touch_pa
    film_m = float(static_table(law).film_at(np.array([pressure_pa]))[0])
    assert contact_pressure_pa(film_m, law) == pytest.approx(applied_pressure_pa(pressure_pa, law), rel=1e-3)


def test_below_the_touch_point_the_pack_stands_open() -> None:
    law = film_law(CLUTCHES[0])
    below_pa = np.array([-1.0e5, 0.0, CLUTCHES[0].touch_pressure_pa - 2.0e3])
    assert np.all(static_table(law).film_at(below_pa) == law.open_gap_m)
