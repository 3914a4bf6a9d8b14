"""Golden values: what an independent implementation of docs/model.md computed, beside what this project computes."""

from collections.abc import Iterator
from dataclasses import dataclass

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    FilmLaw,
    applied_pressure_pa,
    contact_pressure_pa,
    contact_torque_nm,
    equilibrium_film_m,
    film_law,
    film_mobility_m,
    friction_law,
    kinetic_friction,
    shear_factor_difference,
    viscosity_pa_s,
)
from clutch_model.units import k_from_degc, pa_from_bar
from diag_service.diagnosis.friction.paper.driveline import steady_kalman
from tests.support.film_laws import squeeze_rate_m_s

CALIBRATION = nominal_calibration()
LAWS = tuple(film_law(clutch) for clutch in CALIBRATION.clutches)
FRICTION = friction_law(CALIBRATION.clutches[0].friction)

SHEAR = {0.5: 0.207037, 1.0: 0.489824, 1.2: 0.671941, 1.5: 0.899603, 2.0: 1.013909, 3.0: 0.867053, 5.0: 0.996039}
CONTACT_PA = {0.5: 665672.97, 1.0: 233214.19, 1.5: 67453.70, 2.0: 14778.49}
SQUEEZE_M_S = {100.0: -7.177793e-2, 30.0: -2.429797e-3, 12.0: -7.015069e-5, 9.0: 3.261209e-4}
STRIBECK = {0.1: 0.119, 1.0: 0.121925, 6.0: 0.132145, 12.0: 0.137110, 50.0: 0.139995}
EQUILIBRIUM = (  # clutch, bar; applied Pa, film um, static capacity N m
    (1, 5.0, 249923.0, 8.152, 153.6),
    (1, 10.0, 591857.0, 4.709, 363.7),
    (2, 5.0, 266916.0, 7.904, 115.6),
    (2, 10.0, 648225.0, 4.320, 280.8),
)
TIME_CONSTANT_MS = {1.0: 4.9, 1.3: 8.1, 1.6: 13.1, 2.0: 27.0}
KALMAN_GAIN = (0.019099, 0.180670)  # T = 1 ms, q = 1.78e7, r = 535


@dataclass(frozen=True, slots=True, kw_only=True)
class Golden:
    """One value, with half a unit of the last digit that was printed as its tolerance."""

    name: str
    expected: float
    here: float
    tolerance: float


def viscosity_at(temperature_degc: float) -> float:
    """Return the nominal fluid's viscosity [Pa s]."""
    oil = CALIBRATION.viscosity
    return viscosity_pa_s(k_from_degc(temperature_degc), oil.a_pa_s, oil.b_k, oil.pole_k)


def golden_values() -> Iterator[Golden]:
    """Yield every golden value of the laws and of the paper's filter."""
    law, warm_pa_s = LAWS[0], viscosity_at(90.0)
    for ratio, expected in SHEAR.items():
        yield _value(f"phi_f - phi_fs, H = {ratio:g}", expected, shear_factor_difference(ratio), 6e-7)
    for ratio, expected in CONTACT_PA.items():
        yield _value(f"P_C [Pa], H = {ratio:g}", expected, contact_pressure_pa(ratio * law.roughness_m, law), 6e-3)
    yield _value("nu at 90 degC [Pa s]", 6.424e-3, warm_pa_s, 6e-7)
    yield _value("Q of clutch 1 [m^2]", 2.56171566e-4, law.squeeze_factor_m2, 6e-13)
    for film_um, expected in SQUEEZE_M_S.items():
        here = squeeze_rate_m_s(film_um * 1e-6, 1e5, warm_pa_s, law)
        yield _value(f"dh/dt at {film_um:g} um, 1 bar [m/s]", expected, here, 1e-6 * abs(expected))
    for slip, expected in STRIBECK.items():
        yield _value(f"mu_K, |s| = {slip:g} rad/s", expected, kinetic_friction(slip, FRICTION), 6e-7)
    for clutch, pressure_bar, applied_pa, film_um, capacity_nm in EQUILIBRIUM:
        yield from _equilibrium(clutch, pressure_bar, applied_pa, film_um, capacity_nm)
    for ratio, expected in TIME_CONSTANT_MS.items():
        yield _value(f"film time constant, H = {ratio:g} [ms]", expected, 1e3 * film_time_constant_s(ratio, law), 0.06)
    kalman = steady_kalman(1e-3, 1.78e7, 535.0)
    gains = kalman.value_gain, kalman.rate_gain_1_s
    for name, expected, here in zip(("w", "dw/dt"), KALMAN_GAIN, gains, strict=True):
        yield _value(f"Kalman gain of {name}", expected, here, 6e-7)


def film_time_constant_s(film_ratio: float, law: FilmLaw) -> float:
    """Return the time constant [s] with which a loaded film settles at 90 degC."""
    film_m, step_m = film_ratio * law.roughness_m, 1e-10
    slope_pa_m = (contact_pressure_pa(film_m + step_m, law) - contact_pressure_pa(film_m - step_m, law)) / (2 * step_m)
    return -viscosity_at(90.0) / (slope_pa_m * film_mobility_m(film_m, law))


def _equilibrium(
    clutch: int, pressure_bar: float, applied_pa: float, film_um: float, capacity_nm: float
) -> Iterator[Golden]:
    law = LAWS[clutch - 1]
    pressure_pa = applied_pressure_pa(float(pa_from_bar(pressure_bar)), law)
    film_m = equilibrium_film_m(pressure_pa, law)
    torque_nm = contact_torque_nm(1.0, FRICTION.mu_s, contact_pressure_pa(film_m, law), law.contact_factor_m3)
    where = f"clutch {clutch} at {pressure_bar:g} bar"
    yield _value(f"applied pressure, {where} [Pa]", applied_pa, pressure_pa, 0.6)
    yield _value(f"film, {where} [um]", film_um, film_m * 1e6, 6e-4)
    yield _value(f"capacity, {where} [N m]", capacity_nm, torque_nm, 0.06)


def _value(name: str, expected: float, here: float, tolerance: float) -> Golden:
    return Golden(name=name, expected=expected, here=here, tolerance=tolerance)
