"""How fast an input shaft twists, from its torque alone; docs/model.md eq. (3a) solved for the twist."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.paper.driveline import Shaft

_SPLINE_DEGREE = 5  # three smooth derivatives at the samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist:
    """Rate of an input shaft's twist, that is the speed of its clutch end over its gear end, and its derivative."""

    rate_rad_s: FloatArray  # (n,)
    acceleration_rad_s2: FloatArray  # (n,)


def shaft_twist(torque_nm: FloatArray, period_s: float, shaft: Shaft) -> Twist:
    """Return the twist rate that a shaft torque free of noise implies.

    ``T = k*phi + c*phi'`` gives ``phi = (T - r*T' + r^2*T'' - ...)/k`` with ``r = c/k``, a fifth of a millisecond: two
    terms beyond the first are exact to 0.5 % for the shaft's own ringing and to much less below it.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - scipy takes a second; only this method needs it

    times_s = period_s * np.arange(len(torque_nm))
    spline = make_interp_spline(times_s, torque_nm, k=_SPLINE_DEGREE)
    lag_s = shaft.damping_nms_rad / shaft.stiffness_nm_rad
    first, second, third = (np.asarray(spline(times_s, nu=order)) for order in (1, 2, 3))
    fourth = np.asarray(spline(times_s, nu=4))
    return Twist(
        rate_rad_s=(first - lag_s * second + lag_s**2 * third) / shaft.stiffness_nm_rad,
        acceleration_rad_s2=(second - lag_s * third + lag_s**2 * fourth) / shaft.stiffness_nm_rad,
    )
