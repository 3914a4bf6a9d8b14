"""What the linings do beyond the shared laws: friction that fades with heat, grooves that drain the film."""

from typing import NamedTuple

from canlog.jit import kernel
from clutch_model.film import FilmLaw


class LiningParameters(NamedTuple):
    """Numbers of both clutches' linings, as the kernels take them; the shipped ones have no effect."""

    fade_per_k: float  # k_muT: share of the friction lost per kelvin
    fade_reference_k: float  # temperature at which the calibration's friction is true
    film_mobility_ratio: float  # on the squeeze rate of the film


@kernel
def friction_ratio(clutch_k: float, p: LiningParameters) -> float:
    """Return the factor on mu_C and mu_S at a pack temperature; docs/model.md eq. (X1)."""
    return 1.0 - p.fade_per_k * (clutch_k - p.fade_reference_k)


def grooved(law: FilmLaw, p: LiningParameters) -> FilmLaw:
    """Return the film law of a lining whose grooves shorten the way of the oil; docs/model.md eq. (X2)."""
    return law._replace(squeeze_factor_m2=law.squeeze_factor_m2 / p.film_mobility_ratio)
