"""The paper's lookup table of film thickness against clutch pressure, in two readings.

The paper does not say how its table was made. *Static*: the film at which the asperities carry the whole load.
*Trajectory*: the film that is usual at a pressure while clutches engage, seen in one cycle of a simulation.
"""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.film import FilmLaw, applied_pressure_pa, equilibrium_film_m

TABLE_END_PA = 16.0e5  # above the line pressure
TABLE_STEP_PA = 500.0
BIN_PA = 1.0e4
MIN_BIN_COUNT = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmTable:
    """Film thickness over clutch pressure; linear between the points, constant beyond them."""

    pressure_pa: FloatArray  # (k,), rising
    film_m: FloatArray  # (k,)

    def film_at(self, pressure_pa: FloatArray) -> FloatArray:
        """Return the film thickness [m] at each pressure, same shape."""
        film_m: FloatArray = np.interp(pressure_pa, self.pressure_pa, self.film_m)
        return film_m


def static_table(law: FilmLaw) -> FilmTable:
    """Return the table of equilibria: inverse of P_C, the open gap below the touch point."""
    pressure_pa = np.arange(0.0, TABLE_END_PA, TABLE_STEP_PA)
    film_m = np.array([equilibrium_film_m(applied_pressure_pa(float(one), law), law) for one in pressure_pa])
    return FilmTable(pressure_pa=pressure_pa, film_m=film_m)


def trajectory_table(pressure_pa: FloatArray, film_m: FloatArray, law: FilmLaw) -> FilmTable:
    """Return the median film at each pressure that engaging clutches passed; the static table where none did.

    Parameters
    ----------
    pressure_pa, film_m : (n,) array
        Pressure and film of on-coming clutches in one calibration cycle.
    """
    fallback = static_table(law)
    edges_pa = np.arange(0.0, TABLE_END_PA + BIN_PA, BIN_PA)
    centres_pa = edges_pa[:-1] + 0.5 * BIN_PA
    bins = np.digitize(pressure_pa, edges_pa) - 1
    medians_m = fallback.film_at(centres_pa)
    for row in np.flatnonzero(np.bincount(bins[bins >= 0], minlength=len(centres_pa)) >= MIN_BIN_COUNT):
        medians_m[row] = np.median(film_m[bins == row])
    return FilmTable(pressure_pa=centres_pa, film_m=medians_m)
