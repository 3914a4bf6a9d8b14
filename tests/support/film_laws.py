"""Laws of a film in the plain form, which the programs hold in faster ones."""

from canlog.jit import kernel
from clutch_model.pack import FilmLaw, contact_pressure_pa, film_mobility_m


@kernel
def squeeze_rate_m_s(film_m: float, applied_pa: float, viscosity: float, law: FilmLaw) -> float:
    """Return the film's rate under a load [m/s], no separator springs; docs/model.md eq. (7)."""
    return -(applied_pa - contact_pressure_pa(film_m, law)) * film_mobility_m(film_m, law) / viscosity
