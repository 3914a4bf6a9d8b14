"""The parameters of one clutch: lining, geometry, piston, film and heat, range-checked once.

Symbols in the comments are those of ``docs/model.md``.
"""

import math
from dataclasses import dataclass

from clutch_model.errors import CalibrationError
from clutch_model.tables import Ranged, require


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionCurve(Ranged):
    """Stribeck curve of one clutch, eq. (8)."""

    mu_c: float  # Coulomb coefficient, reached at high slip
    mu_s: float  # static coefficient, reached at zero slip
    stribeck_speed_rad_s: float  # w_S
    stribeck_exponent: float  # lambda_S
    lock_band_rad_s: float  # w_rel

    def __post_init__(self) -> None:
        """Check that the coefficients are those of a lubricated friction lining."""
        Ranged.__post_init__(self)
        for name in ("mu_c", "mu_s"):
            if not 0.02 <= (mu := getattr(self, name)) <= 0.5:
                raise CalibrationError(f"{name} must be 0.02..0.5, got {mu}")
        require(self.stribeck_speed_rad_s > 0.0, "stribeck_speed_rad_s must be > 0")
        require(self.stribeck_exponent > 0.0, "stribeck_exponent must be > 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchGeometry(Ranged):
    """Fixed geometry of one clutch pack."""

    outer_radius_m: float  # Ro
    inner_radius_m: float  # Ri
    interface_count: int  # Np
    piston_area_m2: float  # A_K

    def __post_init__(self) -> None:
        """Check that the ring exists and the piston pushes."""
        Ranged.__post_init__(self)
        require(
            0.0 < self.inner_radius_m < self.outer_radius_m,
            "inner_radius_m must lie between 0 and outer_radius_m",
        )
        require(self.interface_count >= 1, "interface_count must be >= 1")
        require(self.piston_area_m2 > 0.0, "piston_area_m2 must be > 0")

    @property
    def lining_area_m2(self) -> float:
        """Area of one friction face [m^2], A_lining."""
        return math.pi * (self.outer_radius_m**2 - self.inner_radius_m**2)

    @property
    def contact_factor_m3(self) -> float:
        """Torque per friction coefficient and contact pressure [m^3], C of eq. (6)."""
        return self.interface_count * 2.0 * math.pi / 3.0 * (self.outer_radius_m**3 - self.inner_radius_m**3)

    @property
    def viscous_factor_m4(self) -> float:
        """Torque per shear rate and viscosity [m^4], Vg of eq. (5)."""
        return self.interface_count * math.pi / 2.0 * (self.outer_radius_m**4 - self.inner_radius_m**4)

    @property
    def squeeze_factor_m2(self) -> float:
        """Geometric factor of the annular squeeze film [m^2], Q of eq. (7)."""
        outer2, inner2 = self.outer_radius_m**2, self.inner_radius_m**2
        return 1.5 * ((outer2 + inner2) - (outer2 - inner2) / math.log(self.outer_radius_m / self.inner_radius_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class Piston(Ranged):
    """Return spring and stroke of one clutch piston."""

    spring_preload_n: float  # F_pre
    spring_rate_n_m: float  # K_K
    fill_stroke_m: float  # x_fill

    @property
    def closed_spring_force_n(self) -> float:
        """Spring force with the pack closed [N], F_s."""
        return self.spring_preload_n + self.spring_rate_n_m * self.fill_stroke_m


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmSurface(Ranged):
    """Rough, permeable lining surface and the oil film on it, eq. (7)."""

    roughness_m: float  # sigma, combined rms roughness
    contact_stiffness_pa: float  # K_c = K'E'
    permeability_m2: float  # Phi
    lining_thickness_m: float  # d
    slip_coefficient: float  # a_BJ, Beavers-Joseph
    open_gap_m: float  # h0
    separation_time_s: float  # tau_sep
    separation_pressure_pa: float  # p_sep
    min_film_m: float  # h_min
    mobility_ratio: float = 1.0  # of the film's rate to what the rest says

    def __post_init__(self) -> None:
        """Check that the film law has no zero denominator."""
        Ranged.__post_init__(self)
        lengths = ("roughness_m", "contact_stiffness_pa", "permeability_m2", "open_gap_m", "separation_time_s")
        for name in (*lengths, "mobility_ratio"):
            if not getattr(self, name) > 0.0:
                raise CalibrationError(f"{name} must be > 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchThermal(Ranged):
    """Lumped thermal mass of one clutch pack."""

    heat_capacity_j_k: float  # C_th
    convection_w_k: float  # hA

    def __post_init__(self) -> None:
        """Check that the pack has a heat capacity."""
        Ranged.__post_init__(self)
        require(self.heat_capacity_j_k > 0.0, "heat_capacity_j_k must be > 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchCalibration:
    """Everything about one clutch that plant and estimator both use."""

    friction: FrictionCurve
    geometry: ClutchGeometry
    piston: Piston
    film: FilmSurface
    thermal: ClutchThermal

    @property
    def touch_pressure_pa(self) -> float:
        """Piston pressure at which the pack just closes [Pa], F_s / A_K."""
        return self.piston.closed_spring_force_n / self.geometry.piston_area_m2
