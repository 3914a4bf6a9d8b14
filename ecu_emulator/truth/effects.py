"""Puts the effects of a scenario that belong to the vehicle into its true calibration and parameters."""

from dataclasses import replace

from clutch_model.calibration import Calibration
from clutch_model.clutch import ClutchCalibration
from ecu_emulator.plant.parameters import PlantParameters
from ecu_emulator.scenario.scenario import Effects


def affected_calibration(calibration: Calibration, effects: Effects) -> Calibration:
    """Return the calibration as the effects make it, equal to the given one without any."""
    first, second = (_affected_clutch(clutch, effects) for clutch in calibration.clutches)
    fluid = calibration.viscosity
    return replace(
        calibration,
        clutches=(first, second),
        viscosity=replace(fluid, a_pa_s=fluid.a_pa_s * effects.viscosity_ratio),
    )


def affected_parameters(parameters: PlantParameters, effects: Effects) -> PlantParameters:
    """Return the plant's parameters as the effects make them.

    Raises
    ------
    CalibrationError
        If an effect leads outside a physical range.
    """
    damping = effects.driveline_damping_ratio
    first, second = (shaft._replace(damping_nms_rad=shaft.damping_nms_rad * damping) for shaft in parameters.shafts)
    flywheel, output, engine = parameters.flywheel, parameters.output, parameters.engine
    lining = parameters.lining
    return replace(
        parameters,
        engine=engine._replace(ripple_ratio=engine.ripple_ratio + effects.crank_ripple_ratio),
        flywheel=flywheel._replace(damping_nms_rad=flywheel.damping_nms_rad * damping),
        shafts=(first, second),
        output=output._replace(shaft_damping_nms_rad=output.shaft_damping_nms_rad * damping),
        lining=lining._replace(
            fade_per_k=lining.fade_per_k + effects.friction_fade_per_k,
            film_mobility_ratio=lining.film_mobility_ratio * effects.film_mobility_ratio,
        ),
    )


def _affected_clutch(clutch: ClutchCalibration, effects: Effects) -> ClutchCalibration:
    friction, geometry, piston, film = clutch.friction, clutch.geometry, clutch.piston, clutch.film
    return replace(
        clutch,
        friction=replace(friction, stribeck_speed_rad_s=friction.stribeck_speed_rad_s * effects.stribeck_speed_ratio),
        geometry=replace(geometry, piston_area_m2=geometry.piston_area_m2 * effects.piston_area_ratio),
        piston=replace(piston, spring_preload_n=piston.spring_preload_n + effects.spring_force_n),
        film=replace(film, contact_stiffness_pa=film.contact_stiffness_pa * effects.contact_stiffness_ratio),
    )
