"""People read bar, degrees Celsius, kilometres and rpm, with four digits at most; programs read SI."""

import re

import pytest

from clutch_model.units import for_people
from clutchdiag_io.people import digits
from diag_service.diagnosis.records import shift_record
from diag_service.report.history import shift_lines
from diag_service.tester.trouble import values_text
from tests.support.builders import shift_result

TOO_MANY = re.compile(r"\d\.\d{7}|e[+-]\d")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.1209111254, "0.1209"), (61001.2615, "61001"), (2.48, "2.48"), (88.98, "88.98"), (0.0, "0"), (-0.5, "-0.5"),
     (248000.0, "248000"), (1.0, "1"), (1e-9, "0"), (-1e-9, "0"), (0.000427512, "0.000428")],
)  # fmt: skip
def test_a_number_has_the_digits_that_tell_something(value: float, text: str) -> None:
    assert digits(value) == text


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [("touch_error_pa", 2.48e5, "touch_error 2.48 bar"), ("peak1_k", 362.13, "peak1 88.98 °C"),
     ("odometer_m", 61001261.5, "odometer 61001 km"), ("peak_slip_rad_s", 46.7233, "peak_slip 446.2 rpm"),
     ("temperature_rise_k", 12.0, "temperature_rise 12 K"), ("slope_s_rad", -0.00141, "slope_s_rad -0.00141")],
)  # fmt: skip
def test_a_quantity_has_the_unit_of_a_workshop(name: str, value: float, told: str) -> None:
    label, shown, unit = for_people(name, value)
    assert f"{label} {digits(shown)} {unit}".strip() == told


def test_what_is_stored_of_a_shift_is_shown_for_people_and_kept_in_si() -> None:
    record = shift_record(shift_result(1))
    lines = [line.plain.strip() for line in shift_lines(record)]
    assert {"odometer  1.234 km", "sump_temperature  80 °C", "slip_energy  8.4 kJ"} <= set(lines)
    assert not [line for line in lines if TOO_MANY.search(line)]
    assert record["sump_temperature_k"] == 353.15


def test_what_a_controller_tells_has_few_digits() -> None:
    assert values_text({"pressure [bar]": 2.4812345678}) == "2.481 bar"
