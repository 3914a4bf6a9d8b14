"""Where the energy of an audited drive went: whether the plant gains or loses any."""

from dataclasses import dataclass, fields

from canlog.arrays import FloatArray
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import ACCOUNT_COUNT, stored_energy_j
from ecu_emulator.plant.course import MachineCourse
from ecu_emulator.plant.rates import PlantLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerBalance:
    """Energies since the start of a drive [J]; the residuals are what the integration gained or lost."""

    engine_j: float  # from here on in the order of the account
    engine_absolute_j: float  # integral of |power|: the scale of the residual
    clutch_j: float
    bearing_j: float
    damper_j: float
    gear_j: float
    synchroniser_j: float
    tyre_j: float
    brake_j: float
    road_j: float
    coolant_j: float
    converter_j: float
    stored_j: float  # change of kinetic and spring energy
    heated_j: float  # change of the heat in clutches and sump

    @property
    def residual_j(self) -> float:
        """Energy that appeared from nowhere [J]."""
        lost_j = self.clutch_j + self.bearing_j + self.damper_j + self.gear_j
        lost_j += self.synchroniser_j + self.tyre_j + self.brake_j + self.road_j + self.converter_j
        return self.stored_j + lost_j - self.engine_j

    @property
    def residual_ratio(self) -> float:
        """Mechanical residual over the energy that went through the crankshaft."""
        return self.residual_j / self.engine_absolute_j

    @property
    def heat_residual_ratio(self) -> float:
        """Part of the heat of clutches and converter that is neither stored nor carried away."""
        made_j = self.clutch_j + self.converter_j
        return (made_j - self.heated_j - self.coolant_j) / made_j


def stored_heat_j(y: FloatArray, law: PlantLaw) -> float:
    """Return the heat in clutches and sump above 0 K [J]."""
    heat_j = law.sump_heat_capacity_j_k * y[at.T_OIL]
    heat_j += law.clutches[0].heat_capacity_j_k * y[at.T_C]
    return float(heat_j + law.clutches[1].heat_capacity_j_k * y[at.T_C + 1])


def power_balance(course: MachineCourse) -> PowerBalance:
    """Return the energies of a drive since its `audit` began."""
    account, before, after, law = course.account
    stored_j = stored_energy_j(after, law) - stored_energy_j(before, law)
    heated_j = stored_heat_j(after, law) - stored_heat_j(before, law)
    names = [member.name for member in fields(PowerBalance)]
    return PowerBalance(**dict(zip(names, (*account[:ACCOUNT_COUNT].tolist(), stored_j, heated_j), strict=True)))
