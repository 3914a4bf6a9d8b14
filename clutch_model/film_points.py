"""The laws of a film as an estimator follows it: those of `film`, arranged so that the next step waits for little.

A film is followed from point to point, and each waits for the one before. So divisions, which take longest, are made
of what is known early, and what belongs to one thickness is computed once for all pressures.
"""

import math
from typing import NamedTuple

from canlog.jit import kernel
from clutch_model.film import (
    CONTACT_END,
    CONTACT_EXPONENT,
    FLOW_RATE,
    FilmLaw,
    applied_pressure_pa,
    contact_pressure_pa,
)

# Slopes over the film are taken over this ratio; a series is exact where the overlap is so many steps.
_SLOPE_STEP = 1e-4
_SERIES_SPAN = 1e3
_THIRD = 1.0 / 3.0
_POWER_SERIES = tuple((CONTACT_EXPONENT - n) / (n + 1.0) for n in range(4))  # binomial


class FilmPoint(NamedTuple):
    """What a film of some thickness answers to any pressure, and one that is a step thicker: for its slope."""

    film_m: float
    per_film_1_m: float  # its reciprocal
    contact_pa: float
    mobility_m: float
    thicker_contact_pa: float
    thicker_mobility_m: float
    step_m: float  # by which that one is thicker


@kernel
def film_point(film_m: float, law: FilmLaw) -> FilmPoint:
    """Return contact and mobility of a film, and of one a ten thousandth thicker.

    The step is so small that a few terms of a series give what follows the step as exactly as `contact_pressure_pa`
    and `film_mobility_m` would, which take most of the time of following a film.
    """
    ratio = film_m * (1.0 / law.roughness_m)
    step = _SLOPE_STEP * ratio
    obstruction, gap_slope = math.exp(FLOW_RATE * ratio), 0.5 * (1.0 + math.erf(ratio * math.sqrt(0.5)))
    fall, density = FLOW_RATE * step, math.exp(-0.5 * ratio * ratio) / math.sqrt(2.0 * math.pi)
    thicker_obstruction = obstruction * (1.0 + fall * (1.0 + 0.5 * fall * (1.0 + _THIRD * fall)))
    rise = step * (1.0 - 0.5 * step * (ratio - _THIRD * step * (ratio * ratio - 1.0)))  # of a normal distribution
    thicker_m = film_m + _SLOPE_STEP * film_m
    contact_pa, overlap = contact_pressure_pa(film_m, law), CONTACT_END - ratio
    if overlap > _SERIES_SPAN * step:
        lost, (p1, p2, p3, p4) = step / overlap, _POWER_SERIES
        thicker_contact_pa = contact_pa * (1.0 - lost * p1 * (1.0 - lost * p2 * (1.0 - lost * p3 * (1.0 - lost * p4))))
    else:
        thicker_contact_pa = contact_pressure_pa(thicker_m, law)
    return FilmPoint(
        film_m,
        1.0 / film_m,
        contact_pa,
        _mobility_m(film_m, obstruction, gap_slope, law),
        thicker_contact_pa,
        _mobility_m(thicker_m, thicker_obstruction, gap_slope + density * rise, law),
        _SLOPE_STEP * film_m,
    )


@kernel
def _mobility_m(film_m: float, obstruction: float, gap_slope: float, law: FilmLaw) -> float:
    """Return `film.film_mobility_m` by ``(1 - phi) / 0.9`` and g, over one denominator."""
    depth = film_m * (1.0 / math.sqrt(law.permeability_m2))
    slipping, slip = depth * (1.0 + law.slip_coefficient * depth), depth + 2.0 * law.slip_coefficient
    through_film = film_m * film_m * film_m * (1.0 - 0.9 * obstruction) * (slipping + 3.0 * slip)
    through_lining = 12.0 * law.permeability_m2 * law.lining_thickness_m * slipping
    return (through_film + through_lining) / (law.squeeze_factor_m2 * slipping * gap_slope)


@kernel
def point_rate_m_s(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> float:
    """Return `film.measured_film_rate_m_s` of a film in oil of a ``fluidity`` [1/(Pa s)], one over its viscosity."""
    applied_pa = applied_pressure_pa(piston_pa, law)
    return _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)


@kernel
def point_slope_1_s(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> float:
    """Return how much faster a thicker film moves, per thickness [1/s]."""
    applied_pa, thicker_m = applied_pressure_pa(piston_pa, law), point.film_m + point.step_m
    rate_m_s = _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)
    thicker_m_s = _rate_m_s(thicker_m, point.thicker_contact_pa, point.thicker_mobility_m * fluidity, applied_pa, law)
    return (thicker_m_s - rate_m_s) * (point.per_film_1_m * (1.0 / _SLOPE_STEP))


@kernel
def _rate_m_s(film_m: float, contact_pa: float, yielding_m_pa_s: float, applied_pa: float, law: FilmLaw) -> float:
    """Return the rate of a film that yields so much to a pressure [m/(Pa s)]; ``film.film_rate_m_s``."""
    opening_m_s = (law.open_gap_m - film_m) * (1.0 / law.separation_time_s)
    if applied_pa <= 0.0:
        return opening_m_s
    springs_pa = law.separation_pressure_pa * (1.0 - film_m * (1.0 / law.open_gap_m))
    return min((springs_pa + contact_pa - applied_pa) * yielding_m_pa_s, opening_m_s)
