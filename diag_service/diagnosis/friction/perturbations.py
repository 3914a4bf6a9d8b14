"""Small changes of what moves the films or of how they answer, for derivatives by finite differences."""

from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from diag_service.diagnosis.friction.film_track import PressureDrive
from diag_service.diagnosis.friction.parameters import Considered, moved


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """A change of what moves the films or of how they answer, for derivatives."""

    pressure_pa: float = 0.0
    area_ratio: float = 0.0
    latency_s: float = 0.0
    viscosity_ratio: float = 0.0
    stribeck_speed_ratio: float = 0.0
    contact_stiffness_ratio: float = 0.0
    film_mobility_log: float = 0.0
    stribeck_exponent_log: float = 0.0

    @property
    def moves_film(self) -> bool:
        """Whether the film answers: it knows the shape of the friction curve by its heat only, which is too little."""
        return self != Perturbation(
            stribeck_speed_ratio=self.stribeck_speed_ratio, stribeck_exponent_log=self.stribeck_exponent_log
        )

    def of_drive(self, drive: PressureDrive, grid_s: FloatArray) -> PressureDrive:
        """Return the changed drive of a film."""
        earlier_pa = np.interp(grid_s + self.latency_s, grid_s, drive.piston_pa)
        return replace(drive, piston_pa=(earlier_pa + self.pressure_pa) * (1.0 + self.area_ratio))

    def of_calibration(self, calibration: Calibration) -> Calibration:
        """Return the changed calibration."""
        displacements = {
            Considered.VISCOSITY: self.viscosity_ratio,
            Considered.STRIBECK_SPEED: self.stribeck_speed_ratio,
            Considered.CONTACT_STIFFNESS: self.contact_stiffness_ratio,
            Considered.FILM_MOBILITY: self.film_mobility_log,
            Considered.STRIBECK_EXPONENT: self.stribeck_exponent_log,
        }
        return moved(calibration, displacements) if any(displacements.values()) else calibration


OFFSET = Perturbation(pressure_pa=2.0e3)
COMMON = {
    Considered.VISCOSITY: (Perturbation(viscosity_ratio=0.05), 0.05),
    Considered.PRESSURE_LATENCY: (Perturbation(latency_s=1e-3), 1e-3),
    Considered.STRIBECK_SPEED: (Perturbation(stribeck_speed_ratio=0.05), 0.05),
    Considered.CONTACT_STIFFNESS: (Perturbation(contact_stiffness_ratio=0.05), 0.05),
    Considered.FILM_MOBILITY: (Perturbation(film_mobility_log=0.05), 0.05),
    Considered.STRIBECK_EXPONENT: (Perturbation(stribeck_exponent_log=0.05), 0.05),
}
"""What both clutches share: the change, and its size."""
AREA = (Perturbation(area_ratio=0.01), 0.01)
