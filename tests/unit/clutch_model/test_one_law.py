"""Each law of the clutch is written once, in `clutch_model` (decision 0001), and holds for numbers and arrays alike."""

import ast
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    contact_torque_nm,
    contact_torques_nm,
    film_law,
    friction_law,
    piston_pressure_pa,
    piston_pressures_pa,
    stribeck_weight,
    stribeck_weights,
    viscosities_pa_s,
    viscosity_pa_s,
)
from tests.support.distributions import ROOT, modules_of

USERS = ("ecu_emulator", "diag_service", "studies", "demo")
# Numbers that mean something in a law only: who calculates with them himself writes that law a second time.
OF_LAWS = {
    "contact_factor_m3": "(6)",
    "viscous_factor_m4": "(5)",
    "squeeze_factor_m2": "(7)",
    "closed_spring_force_n": "(H6)",
    "b_k": "(8a)",
    "pole_k": "(8a)",
    "convection_w_k": "(T1)",
}
ALLOWED = {
    ("studies/converter_car.py", "contact_factor_m3"),  # a plant of its own, to be held against
    ("ecu_emulator/plant/powertrain.py", "squeeze_factor_m2"),  # (X2): grooves are another number for the same law
    ("diag_service/diagnosis/friction/film.py", "squeeze_factor_m2"),  # likewise a film that yields more quickly
}
CLUTCH = nominal_calibration().clutches[0]
LAW, FRICTION, OIL = film_law(CLUTCH), friction_law(CLUTCH.friction), nominal_calibration().viscosity


def calculated_with(source: str) -> Iterator[tuple[str, int]]:
    """Yield each of the laws' numbers that is an operand in this source, with its line."""
    for node in (one for one in ast.walk(ast.parse(source)) if isinstance(one, ast.BinOp)):
        for operand in (node.left, node.right):
            name = operand.attr if isinstance(operand, ast.Attribute) else getattr(operand, "id", "")
            if name in OF_LAWS:
                yield name, node.lineno


def test_nobody_else_writes_a_law_again() -> None:
    again = [
        f"{path.relative_to(ROOT)}:{line}: eq. {OF_LAWS[name]} by {name}"
        for package in USERS
        for path in modules_of(package)
        for name, line in calculated_with(path.read_text(encoding="utf-8"))
        if (path.relative_to(ROOT).as_posix(), name) not in ALLOWED
    ]
    assert again == []


@pytest.mark.parametrize(
    ("of_one", "of_many", "points"),
    [
        (lambda x: stribeck_weight(x, FRICTION), lambda x: stribeck_weights(x, FRICTION), (-400.0, 400.0)),
        (lambda x: contact_torque_nm(-1.0, 0.1, x, 5e-3), lambda x: contact_torques_nm(-x / x, 0.1, x, 5e-3), (1, 1e6)),
        (lambda x: piston_pressure_pa(x, LAW), lambda x: piston_pressures_pa(x, LAW), (0.0, 15e5)),
        (
            lambda x: viscosity_pa_s(x, OIL.a_pa_s, OIL.b_k, OIL.pole_k),
            lambda x: viscosities_pa_s(x, OIL.a_pa_s, OIL.b_k, OIL.pole_k),
            (240.0, 440.0),
        ),
    ],
    ids=["(8)", "(6)", "(H6)", "(8a)"],
)
def test_a_law_is_the_same_for_one_number_and_for_an_array(
    of_one: Callable[[float], float], of_many: Callable[[FloatArray], FloatArray], points: tuple[float, float]
) -> None:
    values = np.linspace(*points, 101)
    assert of_many(values) == pytest.approx([of_one(float(value)) for value in values], rel=1e-13)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_the_weight_is_that_of_the_model_for_every_exponent(exponent: float) -> None:
    law = FRICTION._replace(stribeck_exponent=exponent)
    slips = np.array([0.0, 0.05, law.lock_band_rad_s, 1.0, -6.0, 50.0])
    beyond = np.maximum(np.abs(slips) - law.lock_band_rad_s, 0.0) / law.stribeck_speed_rad_s
    expected = np.where(beyond > 0.0, np.exp(-(beyond**exponent)), 1.0)
    assert [stribeck_weight(float(slip), law) for slip in slips] == pytest.approx(expected, rel=1e-14)
