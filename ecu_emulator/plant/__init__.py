"""The emulated vehicle: engine, hydraulics, wet dual clutch, driveline, road."""

from ecu_emulator.plant.course import DriveSettings, FrictionFactors
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters, plant_table
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col

__all__ = [
    "Col",
    "DriveSettings",
    "FrictionFactors",
    "PlantParameters",
    "Powertrain",
    "nominal_parameters",
    "plant_table",
]
