"""The picture of a demonstration shows the shifts that its table tells."""

from dataclasses import replace

from demo.runner import bus_picture
from tests.unit.demo.outcomes import good_outcome


def test_the_picture_is_of_the_shifts_on_the_bus() -> None:
    outcome = replace(good_outcome(), shifts=good_outcome().shifts[:6])
    panels = bus_picture(outcome).axes
    assert panels[0].get_title(loc="right") == "6 shifts on the bus"
    numbers = [x for axes in panels for bars in axes.containers[:1] for x in bars[0].get_xdata()]
    assert sorted(numbers) == [one.estimate.number for one in outcome.shifts]
