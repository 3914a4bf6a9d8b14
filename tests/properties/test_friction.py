from hypothesis import given
from hypothesis import strategies as st

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    FrictionLaw,
    contact_pressure_pa,
    contact_torque_nm,
    film_law,
    kinetic_friction,
    viscous_torque_nm,
)

FILM = film_law(nominal_calibration().clutches[0])
SLIPS = st.floats(-400.0, 400.0)
FILMS = st.floats(FILM.min_film_m, FILM.open_gap_m)
LAWS = st.builds(
    FrictionLaw,
    mu_c=st.floats(0.02, 0.5),
    mu_s=st.floats(0.02, 0.5),
    stribeck_speed_rad_s=st.floats(0.5, 50.0),
    stribeck_exponent=st.sampled_from([0.5, 1.0, 2.0]),
    lock_band_rad_s=st.floats(0.0, 0.5),
)


def torque_nm(slip_rad_s: float, film_m: float, law: FrictionLaw) -> float:
    direction = 1.0 if slip_rad_s > 0.0 else -1.0
    contact_pa = contact_pressure_pa(film_m, FILM)
    contact_nm = contact_torque_nm(direction, kinetic_friction(slip_rad_s, law), contact_pa, FILM.contact_factor_m3)
    return contact_nm + viscous_torque_nm(slip_rad_s, film_m, 6.4e-3, FILM)


@given(SLIPS, FILMS, LAWS)
def test_friction_never_creates_energy(slip_rad_s: float, film_m: float, law: FrictionLaw) -> None:
    assert torque_nm(slip_rad_s, film_m, law) * slip_rad_s >= 0.0


@given(SLIPS.filter(lambda slip: slip != 0.0), FILMS, LAWS)
def test_torque_changes_sign_with_slip(slip_rad_s: float, film_m: float, law: FrictionLaw) -> None:
    assert torque_nm(-slip_rad_s, film_m, law) == -torque_nm(slip_rad_s, film_m, law)


@given(SLIPS, LAWS)
def test_friction_lies_between_its_limits(slip_rad_s: float, law: FrictionLaw) -> None:
    low, high = sorted((law.mu_c, law.mu_s))
    assert low * (1.0 - 1e-12) <= kinetic_friction(slip_rad_s, law) <= high * (1.0 + 1e-12)


@given(FILMS, FILMS)
def test_a_thinner_film_carries_more(first_m: float, second_m: float) -> None:
    thin, thick = sorted((first_m, second_m))
    assert contact_pressure_pa(thin, FILM) >= contact_pressure_pa(thick, FILM)
