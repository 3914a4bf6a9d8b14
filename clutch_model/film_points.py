"""The laws of a film as an estimator follows it: those of `film`, as short polynomials of the thickness.

A film is followed from point to point, and each waits for the one before. What its thickness alone decides takes
logarithms, powers and an error function; so the laws of `film` are asked once for each surface, and between what they
say a polynomial does. Divisions, which take longest then, are made of what is known early.
"""

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, unchecked_kernel
from clutch_model.film import (
    FilmLaw,
    applied_pressure_pa,
    contact_pressure_pa,
    film_mobility_m,
    shear_factor_difference,
)

# Slopes over the film are taken over this ratio.
_SLOPE_STEP: Final = 1e-4
# Polynomials in a film as thick as the roughness: the laws have their corners at whole roughnesses, where one ends.
_PIECES: Final = 128
_MOST_PIECES: Final = 2**14  # up to an open gap, whatever the surface: 2 MB
_COEFFICIENTS: Final = 5
_CONTACT, _MOBILITY, _SHEAR = range(3)
_KEPT_SURFACES: Final = 8


class FilmShape(NamedTuple):
    """What films of any thickness are by their surface alone, in the form the kernels take."""

    pieces: FloatArray  # (pieces, 3, _COEFFICIENTS): contact per stiffness, mobility times squeeze factor [m^3], shear
    per_piece_1_m: float


class FilmPoint(NamedTuple):
    """What a film of some thickness answers to any pressure and slip, and one that is a step thicker: for its slope."""

    film_m: float
    per_film_1_m: float  # its reciprocal
    contact_pa: float
    mobility_m: float
    shear: float  # `shear_factor_difference`
    thicker_contact_pa: float
    thicker_mobility_m: float
    thicker_shear: float
    step_m: float  # by which that one is thicker


def film_shape(law: FilmLaw) -> FilmShape:
    """Return the shape of a clutch's films: the same for all pistons, stiffnesses and mobilities of one surface."""
    return _shape(law.roughness_m, law.permeability_m2, law.lining_thickness_m, law.slip_coefficient, law.open_gap_m)


@lru_cache(maxsize=_KEPT_SURFACES)
def _shape(
    roughness_m: float, permeability_m2: float, lining_thickness_m: float, slip_coefficient: float, open_gap_m: float
) -> FilmShape:
    law = FilmLaw(*np.ones(len(FilmLaw._fields)).tolist())._replace(
        roughness_m=roughness_m,
        permeability_m2=permeability_m2,
        lining_thickness_m=lining_thickness_m,
        slip_coefficient=slip_coefficient,
    )
    piece_m = max(roughness_m / _PIECES, open_gap_m / _MOST_PIECES)
    count = int(open_gap_m / piece_m) + 2
    along = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_COEFFICIENTS) + 0.5) / _COEFFICIENTS)  # Chebyshev's points
    values = np.empty((count, 3, _COEFFICIENTS))
    _ask((np.arange(count)[:, None] + along) * piece_m, law, values)
    pieces = values @ np.linalg.inv(np.vander(along, increasing=True)).T
    return FilmShape(pieces=np.ascontiguousarray(pieces), per_piece_1_m=1.0 / piece_m)


@array_kernel
def _ask(film_m: FloatArray, law: FilmLaw, values: FloatArray) -> None:
    """Fill in what the laws say of some films; (n, m) of them and (n, 3, m) values."""
    for row in range(film_m.shape[0]):
        for column in range(film_m.shape[1]):
            one_m = film_m[row, column]
            values[row, _CONTACT, column] = contact_pressure_pa(one_m, law)
            values[row, _MOBILITY, column] = film_mobility_m(one_m, law)
            values[row, _SHEAR, column] = shear_factor_difference(one_m / law.roughness_m)


@unchecked_kernel
def film_point(film_m: float, law: FilmLaw, shape: FilmShape) -> FilmPoint:
    """Return contact, mobility and shear of a film not above its open gap, and of one a ten thousandth thicker."""
    place, pieces = film_m * shape.per_piece_1_m, shape.pieces
    piece = min(max(int(place), 0), len(pieces) - 1)  # also where a film is no number
    along = place - piece
    further = along + _SLOPE_STEP * place
    stiffness_pa, per_squeeze_1_m2 = law.contact_stiffness_pa, 1.0 / law.squeeze_factor_m2
    return FilmPoint(
        film_m,
        1.0 / film_m,
        stiffness_pa * max(0.0, _value(pieces, piece, _CONTACT, along)),
        per_squeeze_1_m2 * _value(pieces, piece, _MOBILITY, along),
        _value(pieces, piece, _SHEAR, along),
        stiffness_pa * max(0.0, _value(pieces, piece, _CONTACT, further)),
        per_squeeze_1_m2 * _value(pieces, piece, _MOBILITY, further),
        _value(pieces, piece, _SHEAR, further),
        _SLOPE_STEP * film_m,
    )


@unchecked_kernel
def _value(pieces: FloatArray, piece: int, law: int, along: float) -> float:
    """Return what the polynomial of one law says so far along a piece, whose length is 1."""
    c = pieces[piece, law]
    value: float = c[0] + along * (c[1] + along * (c[2] + along * (c[3] + along * c[4])))
    return value


@unchecked_kernel
def point_rate_m_s(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> float:
    """Return `film.measured_film_rate_m_s` of a film in oil of a ``fluidity`` [1/(Pa s)], one over its viscosity."""
    applied_pa = applied_pressure_pa(piston_pa, law)
    return _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)


@unchecked_kernel
def point_motion(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> tuple[float, float]:
    """Return `point_rate_m_s`, and how much faster a thicker film moves, per thickness [1/s]."""
    applied_pa, thicker_m = applied_pressure_pa(piston_pa, law), point.film_m + point.step_m
    rate_m_s = _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)
    thicker_m_s = _rate_m_s(thicker_m, point.thicker_contact_pa, point.thicker_mobility_m * fluidity, applied_pa, law)
    return rate_m_s, (thicker_m_s - rate_m_s) * (point.per_film_1_m * (1.0 / _SLOPE_STEP))


@unchecked_kernel
def _rate_m_s(film_m: float, contact_pa: float, yielding_m_pa_s: float, applied_pa: float, law: FilmLaw) -> float:
    """Return the rate of a film that yields so much to a pressure [m/(Pa s)]; ``film.film_rate_m_s``."""
    opening_m_s = (law.open_gap_m - film_m) * (1.0 / law.separation_time_s)
    if applied_pa <= 0.0:
        return opening_m_s
    springs_pa = law.separation_pressure_pa * (1.0 - film_m * (1.0 / law.open_gap_m))
    return min((springs_pa + contact_pa - applied_pa) * yielding_m_pa_s, opening_m_s)
