"""Viscosity of the transmission fluid."""

import math

from canlog.jit import kernel


@kernel
def viscosity_pa_s(temperature_k: float, a_pa_s: float, b_k: float, pole_k: float) -> float:
    """Return the dynamic viscosity [Pa s]: Vogel law ``a * exp(b / (T - T0))``, docs/model.md eq. (5).

    Valid well above the pole T0; the caller keeps ``temperature_k`` there.
    """
    return a_pa_s * math.exp(b_k / (temperature_k - pole_k))
