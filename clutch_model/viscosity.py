"""Viscosity of the transmission fluid."""

import numpy as np

from canlog.jit import kernel
from clutch_model.units import Quantity


def viscosities_pa_s(temperature_k: Quantity, a_pa_s: float, b_k: float, pole_k: float) -> Quantity:
    """Return the dynamic viscosity [Pa s]: Vogel law ``a * exp(b / (T - T0))``, docs/model.md eq. (8a).

    Valid well above the pole T0; the caller keeps ``temperature_k`` there.
    """
    viscosity: Quantity = a_pa_s * np.exp(b_k / (temperature_k - pole_k))
    return viscosity


viscosity_pa_s = kernel(viscosities_pa_s)  # the same law, for other kernels
