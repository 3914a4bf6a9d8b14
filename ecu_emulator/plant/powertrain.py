"""The powertrain: assembles parameters into laws, holds the state, hands out rows."""

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, ClutchCalibration
from clutch_model.pack import applied_pressure_pa, contact_torque_nm, equilibrium_film_m, film_law, friction_law
from ecu_emulator.plant import state as at
from ecu_emulator.plant.clutch import ClutchLaw, cavity_law, refresh_contact
from ecu_emulator.plant.course import (
    ROWS_PER_S,
    DriveSettings,
    MachineCourse,
    as_record,
    check_step,
    cycle_table,
    idle_machine,
)
from ecu_emulator.plant.driveline import ENGAGED, converter_law
from ecu_emulator.plant.integration import Machine
from ecu_emulator.plant.loop import COLUMN_COUNT, DriveLaw, run
from ecu_emulator.plant.parameters import PlantParameters
from ecu_emulator.plant.rates import FluidLaw, PlantLaw
from ecu_emulator.shift_control import tcu_data, workshop
from ecu_emulator.shift_control.tcu_data import ClutchActuation, ControlParameters
from ecu_emulator.shift_control.touch_points import PressureSteps

_FULL_BRAKE_M_S = 1.0  # of the shift cycles, which never stop
_IDLE_RAD_S = 94.0  # engine speed when a drive begins at rest, about 900 rpm


class Powertrain(MachineCourse):
    """A vehicle on its shift cycles, one row of `Col` per millisecond.

    Deterministic: the same arguments give the same rows to the last bit, however `advance` is called. Raises
    `CalibrationError` on construction if the step is too long for the plant.

    Parameters
    ----------
    truth : Calibration
        True clutches, fluid and inertias.
    parameters : PlantParameters
        The vehicle around them.
    drive : DriveSettings
        Cycles, driver, temperatures, step.
    touch_pressures_pa : tuple of two, or None
        Touch points that the control believes in; None: those of the clutches.
    """

    def __init__(
        self,
        truth: Calibration,
        parameters: PlantParameters,
        drive: DriveSettings,
        *,
        touch_pressures_pa: tuple[float, float] | None = None,
    ) -> None:
        self._settings = drive
        law = drive_law(truth, parameters, drive)
        check_step(drive.dt_s, law.plant, law.overall_ratios, starts_in_neutral=drive.has_routine)
        self._law = as_record(law)
        super().__init__(self._law, touch_pressures_pa)
        self._machine = _initial_machine(self._law, drive, parameters.control)

    def become(self, truth: Calibration, parameters: PlantParameters) -> None:
        """Go on from the next row with other clutches or surroundings, of which the control does not know."""
        self._law = as_record(drive_law(truth, parameters, self._settings))
        self._obey(self._law)

    @property
    def finished(self) -> bool:
        return bool(self._machine.memory[tcu_data.IS_FINISHED])

    @property
    def endless_shift(self) -> str:
        """What is to be said of a shift that does not end, or never begins; empty: there is none."""
        memory = self._machine.memory
        if memory[tcu_data.IS_FINISHED] != tcu_data.IS_STUCK:
            return ""
        if memory[tcu_data.PHASE] == tcu_data.HOLD:
            gear, most_s = memory[tcu_data.CURRENT_GEAR], tcu_data.LONGEST_GEAR_S
            return f"no shift begins: gear {gear:.0f} for {most_s:.0f} s, the car does not reach the speed of the next"
        gears = f"gear {memory[tcu_data.CURRENT_GEAR]:.0f} to {memory[tcu_data.TARGET_GEAR]:.0f}"
        return f"the shift does not end: {gears} slips for {tcu_data.LONGEST_SHIFT_S:.0f} s, the clutch cannot hold"

    @property
    def is_waiting(self) -> bool:
        """Whether the car waits at rest for somebody to ask for the workshop routine."""
        return bool(self._machine.memory[tcu_data.ROUTINE] == tcu_data.WAITING)

    def begin_routine(self, open_revs: int, closed_revs: int) -> None:
        """Begin the workshop routine with the next row; a car that does not wait for it drives on."""
        if not self.is_waiting:
            return
        memory = self._machine.memory
        memory[tcu_data.OPEN_REV_COUNT] = open_revs
        memory[tcu_data.CLOSED_REV_COUNT] = closed_revs
        memory[tcu_data.ROUTINE] = tcu_data.OPEN_REVS

    def begin_steps(self, steps: PressureSteps) -> None:
        """Begin pressure steps with the next row, if the car waits."""
        if not self.is_waiting:
            return
        memory = self._machine.memory
        memory[tcu_data.STEP_CLUTCH] = steps.clutch - 1
        memory[tcu_data.STEP_TOP] = steps.top_pa
        memory[tcu_data.STEP_DOWN] = steps.down_pa
        memory[tcu_data.STEP_COUNT] = steps.count
        workshop.enter_stage(memory, tcu_data.STEPS_ENGAGING)

    def stop_steps(self) -> None:
        """Break pressure steps off: the car empties its clutches and waits."""
        if self._machine.memory[tcu_data.ROUTINE] >= tcu_data.STEPS_ENGAGING:
            workshop.enter_stage(self._machine.memory, tcu_data.STEPS_RELEASING)

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, shape (n, len(Col)).

        ``n`` is ``duration_s`` in whole milliseconds, less where the drive ends, and 0 after that.
        """
        rows = np.empty((round(duration_s * ROWS_PER_S), COLUMN_COUNT))
        if self.finished:
            return rows[:0]
        return rows[: run(self._machine, self._law, rows)]


def _clutch_law(clutch: ClutchCalibration, parameters: PlantParameters, open_drag_ratio: float) -> ClutchLaw:
    lining = parameters.lining._replace(open_drag_ratio=parameters.lining.open_drag_ratio * open_drag_ratio)
    film = film_law(clutch)
    return ClutchLaw(
        # Grooves shorten the way of the oil; docs/model.md eq. (X2).
        film=film._replace(squeeze_factor_m2=film.squeeze_factor_m2 / lining.film_mobility_ratio),
        friction=friction_law(clutch.friction),
        cavity=cavity_law(clutch),
        valve=parameters.hydraulics,
        heat_capacity_j_k=float(clutch.thermal.heat_capacity_j_k),
        convection_w_k=float(clutch.thermal.convection_w_k),
        lining=lining,
    )


def _plant_law(truth: Calibration, parameters: PlantParameters, drive: DriveSettings) -> PlantLaw:
    first, second = (
        _clutch_law(clutch, parameters, ratio)
        for clutch, ratio in zip(truth.clutches, parameters.open_drags, strict=True)
    )
    hub_inertia_kg_m2 = truth.input_side.hub_inertia_kg_m2
    if truth.converter is not None:  # there is no second clutch, and the hub is the impeller
        lining = second.lining._replace(open_drag_ratio=0.0, open_drag_limit_nm=0.0)
        second = second._replace(film=second.film._replace(viscous_factor_m4=0.0), lining=lining)
        hub_inertia_kg_m2 = truth.converter.impeller_inertia_kg_m2
    return PlantLaw(
        engine=parameters.engine,
        flywheel=parameters.flywheel,
        shafts=parameters.shafts,
        synchroniser=parameters.synchroniser,
        output=parameters.output,
        vehicle=parameters.vehicle,
        clutches=(first, second),
        fluid=FluidLaw(float(truth.viscosity.a_pa_s), float(truth.viscosity.b_k), float(truth.viscosity.pole_k)),
        engine_inertia_kg_m2=float(truth.input_side.engine_inertia_kg_m2),
        hub_inertia_kg_m2=float(hub_inertia_kg_m2),
        hub_damping_nms_rad=float(truth.input_side.hub_damping_nms_rad),
        sump_heat_capacity_j_k=parameters.sump.heat_capacity_j_k,
        sump_convection_w_k=parameters.sump.convection_w_k,
        air_k=float(drive.ambient_k),
        coolant_k=float(drive.coolant_k),
        converter=converter_law(truth.converter),
        full_brake_m_s=_FULL_BRAKE_M_S,
    )


def _actuation(plant: PlantLaw, friction_coefficient: float) -> ClutchActuation:
    def slope(clutch: ClutchLaw) -> float:
        film = clutch.film
        torque_nm_pa = contact_torque_nm(1.0, friction_coefficient, 1.0, film.contact_factor_m3)
        return film.lining_area_m2 / (torque_nm_pa * film.piston_area_m2)

    first, second = plant.clutches
    return ClutchActuation(
        touch_pressure_pa=(first.cavity.touch_pressure_pa, second.cavity.touch_pressure_pa),
        pressure_per_torque_pa_nm=(slope(first), slope(second)),
        inertia_kg_m2=plant.engine_inertia_kg_m2 + plant.hub_inertia_kg_m2,
    )


def _padded(values: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Return as many numbers, whatever the gearbox, for which kernels are compiled once: zeros for gears it has not."""
    return (*values, *[0.0] * (count - len(values)))


def drive_law(truth: Calibration, parameters: PlantParameters, drive: DriveSettings) -> DriveLaw:
    """Return everything constant over a drive, in the form the kernels take after `as_record`."""
    plant, control, gearbox = _plant_law(truth, parameters, drive), parameters.control, parameters.gearbox
    ratios = (ratio * final for ratio, final in zip(gearbox.gear_ratios, gearbox.final_drive_ratios, strict=True))
    return DriveLaw(
        plant=plant,
        actuation=_actuation(plant, control.friction_coefficient),
        control=control._replace(
            upshift_speeds_rad_s=_padded(control.upshift_speeds_rad_s, tcu_data.MOST_GEARS),
            downshift_speeds_rad_s=_padded(control.downshift_speeds_rad_s, tcu_data.MOST_GEARS),
        ),
        workshop=parameters.workshop,
        overall_ratios=_padded((0.0, *ratios), tcu_data.MOST_GEARS + 2),
        steps_per_millisecond=drive.steps_per_millisecond,
    )


def _initial_machine(law: DriveLaw, drive: DriveSettings, control: ControlParameters) -> Machine:
    """Return the state in which a drive begins: rolling in 1st gear or, for the workshop routine, idling at rest."""
    machine = idle_machine(
        cycle_table(drive, control),
        law.plant,
        drive.initial_oil_k,
        memory_count=tcu_data.MEMORY_COUNT,
        sense_count=tcu_data.SENSE_COUNT,
        command_count=tcu_data.COMMAND_COUNT,
    )
    if drive.has_routine:  # neutral on both shafts, both clutches open; those soon drag the shafts along
        machine.y[[at.W_E, at.W_H]] = _IDLE_RAD_S
        machine.memory[tcu_data.OPEN_REV_COUNT] = drive.open_revs
        machine.memory[tcu_data.CLOSED_REV_COUNT] = drive.closed_revs
        machine.memory[tcu_data.ROUTINE] = tcu_data.WAITING if drive.waits else tcu_data.OPEN_REVS
    else:
        _roll(machine, law, drive)
    machine.memory[tcu_data.IS_DRIVING] = 1.0
    return machine


def _roll(machine: Machine, law: DriveLaw, drive: DriveSettings) -> None:
    """Clutch 1 locked in 1st gear, 2nd gear preselected, foot off the pedal."""
    y, plant, actuation = machine.y, law.plant, law.actuation
    first = plant.clutches[0]
    hold_pa = actuation.touch_pressure_pa[0] + law.control.hold_margin_nm * actuation.pressure_per_torque_pa_nm[0]
    y[at.P_V] = hold_pa
    compressed_m3 = (hold_pa - first.cavity.touch_pressure_pa) * first.valve.pack_compliance_m3_pa
    y[at.VOLUME] = first.cavity.full_volume_m3 + compressed_m3
    y[at.FILM] = equilibrium_film_m(applied_pressure_pa(hold_pa, first.film), first.film)
    refresh_contact(y, 0, first)
    machine.modes[at.STICK] = 1
    machine.modes[at.LINK : at.LINK + 2] = ENGAGED
    machine.modes[at.GEAR : at.GEAR + 2] = (1, 2)
    machine.u[at.RATIO : at.RATIO + 2] = law.overall_ratios[1:3]
    machine.memory[tcu_data.CURRENT_GEAR] = machine.memory[tcu_data.TARGET_GEAR] = 1
    machine.commands[tcu_data.WANTED_GEAR : tcu_data.WANTED_GEAR + 2] = (1, 2)
    output_rad_s = drive.initial_engine_rad_s / law.overall_ratios[1]
    y[[at.W_E, at.W_H, at.W_L, at.W_G]] = drive.initial_engine_rad_s
    y[[at.W_L + 1, at.W_G + 1]] = output_rad_s * law.overall_ratios[2]
    y[[at.W_D, at.W_W]] = output_rad_s
    y[at.V] = output_rad_s * plant.vehicle.wheel_radius_m
