"""The picture of a demonstration shows the shifts that its table tells."""

from dataclasses import replace

import numpy as np

from demo.runner import bus_picture
from tests.unit.demo.outcomes import good_outcome


def test_the_picture_is_of_the_shifts_on_the_bus() -> None:
    outcome = replace(good_outcome(), shifts=good_outcome().shifts[:6])
    (axes,) = bus_picture(outcome).axes
    assert axes.get_title(loc="right") == "6 shifts on the bus"
    lines = [one for one in axes.lines if str(one.get_label()).startswith("Clutch ")]
    places = np.concatenate([np.asarray(one.get_xdata(), np.float64) for one in lines])
    assert np.sort(places[np.isfinite(places)]).tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]  # without the gaps
