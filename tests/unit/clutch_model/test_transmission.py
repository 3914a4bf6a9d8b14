"""Transmissions and their units."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clutch_model import units
from clutch_model.calibration import DESCRIBED, clutch_of_gear, shipped_table
from clutch_model.errors import CalibrationError
from clutch_model.transmission import Transmission, read_transmission
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.shift_control.tcu import clutch_of

PUBLISHED = {1: 4.696, 2: 3.130, 3: 2.104, 4: 1.667, 5: 1.285, 6: 1.000, 7: 0.839, 8: 0.667, -1: -3.297}


def test_an_epicyclic_automatic_has_the_published_ratios() -> None:
    found = read_transmission(Path("8hp70"))
    assert {one.number: found.ratio(one) for one in found.gears} == pytest.approx(PUBLISHED, rel=1e-3)


@pytest.mark.parametrize("name", ["nominal", "gs7"])
def test_a_dual_clutch_is_described_as_it_is_emulated(name: str) -> None:
    found, gearbox = read_transmission(Path(name)), nominal_parameters(name).gearbox
    ratios = np.multiply(gearbox.gear_ratios, gearbox.final_drive_ratios)
    assert [gear.ratio for gear in found.gears] == pytest.approx(ratios, rel=1e-4)
    for gear in found.gears:
        assert found.levers(gear) == pytest.approx({f"clutch {2 - gear.number % 2}": 1.0})
    ways = {(one.lower, one.upper): one for one in found.changes()}
    for lower, upper in pairwise(found.gears):
        change = ways[lower.number, upper.number]
        assert [slip.by_input for slip in change.slips] == pytest.approx([1.0, 1.0])
        assert [slip.by_output for slip in change.slips] == pytest.approx([-upper.ratio, -lower.ratio])


@pytest.mark.parametrize("name", DESCRIBED)
def test_an_element_no_longer_slips_in_its_own_gear(name: str) -> None:
    found = read_transmission(Path(name))
    for change in found.changes():
        lower = next(one for one in found.gears if one.number == change.lower)
        upper = next(one for one in found.gears if one.number == change.upper)
        coming, going = change.slips
        assert coming.by_input * found.ratio(upper) == pytest.approx(-coming.by_output)  # it is closed in its gear
        assert going.by_input * found.ratio(lower) == pytest.approx(-going.by_output)


@pytest.mark.parametrize("name", DESCRIBED)
def test_the_torque_of_an_element_is_the_same_by_balance_and_by_virtual_work(name: str) -> None:
    """With one element slipping the input's torque is its own times its lever: the two ways share no code."""
    found = read_transmission(Path(name))
    for change in found.changes():
        upper = next(one for one in found.gears if one.number == change.upper)
        assert abs(found.levers(upper)[change.coming] * change.slips[0].by_input) == pytest.approx(1.0)


def wrong(change: str) -> dict[str, Any]:
    table: dict[str, Any] = shipped_table("8hp70")["transmission"]
    gears: list[dict[str, Any]] = table["gears"]
    match change:
        case "teeth":
            table["planetary_sets"][3]["sun_teeth"] = 28
        case "free":
            gears[0]["elements"] = ["A", "B"]
        case "blocked":
            gears[0]["elements"] = ["A", "B", "C", "D", "E"]
        case "element":
            gears[0]["elements"] = ["A", "B", "F"]
        case "pair":
            gears[0]["gear_pairs"] = ["1"]
        case "shaft":
            table["output"] = "wheels"
        case "format":
            table["format"] = 2
    return table


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("teeth", r"gear 1: its parts make 4\.0357, not 4\.6960"),
        ("free", "gear 1: its parts leave the output free"),
        ("blocked", "gear 1: its parts block each other"),
        ("element", "gear 1: no element 'F'"),
        ("pair", "no gear pair '1'"),
        ("shaft", "no part has the shaft 'wheels'"),
        ("format", "transmission.format must be 1, got 2"),
    ],
)
def test_a_description_that_does_not_work_is_refused(change: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        Transmission.from_mapping(wrong(change))


@pytest.mark.parametrize(("gear", "clutch"), [(1, 1), (2, 2), (3, 1), (4, 2), (5, 1), (6, 2), (7, 1), (8, 2), (0, 2)])
def test_clutch_1_carries_the_odd_gears(gear: int, clutch: int) -> None:
    assert clutch_of_gear(gear) == clutch
    assert clutch_of(gear) == clutch - 1  # the place in pairs, as the compiled control takes it


@pytest.mark.parametrize(
    ("convert", "value", "expected"),
    [
        (units.rad_s_from_rpm, 60.0, 2.0 * np.pi),
        (units.rpm_from_rad_s, np.pi, 30.0),
        (units.pa_from_bar, 1.35, 135_000.0),
        (units.bar_from_pa, 101_325.0, 1.01325),
        (units.k_from_degc, -40.0, 233.15),
        (units.degc_from_k, 363.15, 90.0),
        (units.m_s_from_km_h, 36.0, 10.0),
        (units.km_h_from_m_s, 1.0, 3.6),
    ],
)
def test_known_values(convert: Callable[[float], float], value: float, expected: float) -> None:
    assert convert(value) == pytest.approx(expected, rel=1e-12)
