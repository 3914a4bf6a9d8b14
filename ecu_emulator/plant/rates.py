"""The assembled plant: torques and rates of change for a state; docs/model.md eqs. (1)-(6) and "Bodies"."""

from typing import NamedTuple

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import part
from clutch_model.pack import clutch_heating_rate_k_s, convected_w, sump_heating_rate_k_s
from ecu_emulator.plant import state as at
from ecu_emulator.plant.clutch import ClutchLaw, capacity_nm, contact_nm, viscous_nm
from ecu_emulator.plant.driveline import (
    ENGAGED,
    SYNCHRONISING,
    ConverterLaw,
    EngineParameters,
    FlywheelParameters,
    OutputParameters,
    ShaftParameters,
    SynchroniserParameters,
    VehicleParameters,
    brake_force_n,
    engine_losses_nm,
    geared_torque_nm,
    impeller_torque_nm,
    indicated_torque_nm,
    manifold_rate_pa_s,
    road_load_n,
    synchroniser_torque_nm,
    torque_ratio,
    twist_torque_nm,
    tyre_force_n,
)

_SLIP_DECAY_S = 0.005  # tb: what slip is left when a clutch locks fades with this time constant


class FluidLaw(NamedTuple):
    """Viscosity law of the transmission fluid."""

    a_pa_s: float
    b_k: float
    pole_k: float


class PlantLaw(NamedTuple):
    """Everything constant over a drive, as the kernels take it."""

    engine: EngineParameters
    flywheel: FlywheelParameters
    shafts: tuple[ShaftParameters, ShaftParameters]  # of the odd and the even gears
    synchroniser: SynchroniserParameters
    output: OutputParameters
    vehicle: VehicleParameters
    clutches: tuple[ClutchLaw, ClutchLaw]  # likewise
    fluid: FluidLaw
    engine_inertia_kg_m2: float  # J_E
    hub_inertia_kg_m2: float  # J_H
    hub_damping_nms_rad: float  # B_H
    sump_heat_capacity_j_k: float
    sump_convection_w_k: float
    air_k: float  # intake air
    coolant_k: float
    converter: ConverterLaw
    full_brake_m_s: float  # speed from which the brakes act with their full force


@part
def hub_pull(y: FloatArray, out: FloatArray, law: PlantLaw) -> float:
    """Return the acceleration that flywheel and drag alone would give the hub [rad/s^2]."""
    return float((out[at.T_FW] - out[at.T_IMPELLER] - law.hub_damping_nms_rad * y[at.W_H]) / law.hub_inertia_kg_m2)


@part
def shaft_drag(y: FloatArray, out: FloatArray, clutch: int, shaft: ShaftParameters) -> float:
    """Return the deceleration of a clutch's gearbox side by its shaft [rad/s^2], with the fading of residual slip."""
    slip_rad_s = y[at.W_H] - y[at.W_L + clutch]
    drag_nm = out[at.T_SI + clutch] + shaft.clutch_damping_nms_rad * y[at.W_L + clutch]
    return float(drag_nm / shaft.clutch_inertia_kg_m2 + slip_rad_s / _SLIP_DECAY_S)


@part
def locking_torque_nm(y: FloatArray, out: FloatArray, clutch: int, law: PlantLaw) -> float:
    """Return the torque that holds this clutch locked while the other one passes ``out[T_F]`` [N m]."""
    shaft = law.shafts[clutch]
    inverse_hub = 1.0 / law.hub_inertia_kg_m2
    pull = hub_pull(y, out, law) - out[at.T_F + 1 - clutch] * inverse_hub
    return float((pull + shaft_drag(y, out, clutch, shaft)) / (inverse_hub + 1.0 / shaft.clutch_inertia_kg_m2))


@part
def lock_both(y: FloatArray, out: FloatArray, law: PlantLaw) -> None:
    """Put the torques that hold both clutches locked into ``out``: two equations, coupled by the hub."""
    inverse_hub = 1.0 / law.hub_inertia_kg_m2
    diagonal1 = inverse_hub + 1.0 / law.shafts[0].clutch_inertia_kg_m2
    diagonal2 = inverse_hub + 1.0 / law.shafts[1].clutch_inertia_kg_m2
    pull = hub_pull(y, out, law)
    need1 = pull + shaft_drag(y, out, 0, law.shafts[0])
    need2 = pull + shaft_drag(y, out, 1, law.shafts[1])
    determinant = diagonal1 * diagonal2 - inverse_hub * inverse_hub
    out[at.T_F] = (need1 * diagonal2 - need2 * inverse_hub) / determinant
    out[at.T_F + 1] = (need2 * diagonal1 - need1 * inverse_hub) / determinant


@part
def limit_torque(y: FloatArray, u: FloatArray, clutch: int, out: FloatArray, law: PlantLaw) -> bool:
    """Limit a locked clutch's torque to its capacity; True if that was necessary."""
    capacity = capacity_nm(y, u, clutch, law.clutches[clutch])
    torque_nm = out[at.T_F + clutch]
    out[at.T_F + clutch] = max(-capacity, min(capacity, torque_nm))
    return bool(abs(torque_nm) > capacity)


@part
def clutch_torques(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> None:
    """Put the torques of both clutches into ``out``: kinetic where slipping, required up to capacity where locked."""
    for k in range(2):
        out[at.T_V + k] = 0.0
        if modes[at.STICK + k] == 0:
            clutch = law.clutches[k]
            out[at.T_V + k] = viscous_nm(y, u, k, clutch)
            out[at.T_F + k] = out[at.T_V + k] + contact_nm(y, u, k, clutch)
    if modes[at.STICK] != 0 and modes[at.STICK + 1] != 0:
        lock_both(y, out, law)
        if limit_torque(y, u, 0, out, law):
            out[at.T_F + 1] = locking_torque_nm(y, out, 1, law)
        if limit_torque(y, u, 1, out, law):
            out[at.T_F] = locking_torque_nm(y, out, 0, law)
            limit_torque(y, u, 0, out, law)
        return
    for k in range(2):
        if modes[at.STICK + k] != 0:
            out[at.T_F + k] = locking_torque_nm(y, out, k, law)
            limit_torque(y, u, k, out, law)


@part
def converter_rates(y: FloatArray, u: FloatArray, out: FloatArray, law: PlantLaw) -> None:
    """Fill ``out`` with the torques of the converter and what they and the gearbox's ratio change; eqs. (C1)-(C3)."""
    out[at.T_IMPELLER] = out[at.T_TURBINE] = out[at.T_TURBINE + 1] = 0.0
    out[at.CONVERTER] = out[at.GEAR_RATIO] = 0.0
    if law.converter.is_there == 0:
        return
    out[at.T_IMPELLER] = y[at.CONVERTER]
    out[at.T_TURBINE] = y[at.CONVERTER] * torque_ratio(y[at.W_H], y[at.W_G], law.converter)
    map_nm = impeller_torque_nm(y[at.W_H], y[at.W_G], law.converter)
    out[at.CONVERTER] = (map_nm - y[at.CONVERTER]) / law.converter.lag_s
    out[at.GEAR_RATIO] = u[at.RATIO_RATE]


@part
def input_rates(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> None:
    """Fill ``out`` from the engine to the input shafts; docs/model.md eqs. (1)-(3)."""
    engine_nm = indicated_torque_nm(y[at.P_M], y[at.SPARK], y[at.CRANK], law.air_k, law.engine)
    engine_nm -= engine_losses_nm(y[at.P_M], y[at.W_E], law.engine)
    engine_nm += u[at.STARTER]
    twist_rate = y[at.W_E] - y[at.W_H]
    out[at.T_E] = engine_nm
    out[at.T_FW] = twist_torque_nm(
        y[at.PHI_FW], twist_rate, law.flywheel.stiffness_nm_rad, law.flywheel.damping_nms_rad
    )
    converter_rates(y, u, out, law)
    for k in range(2):
        shaft = law.shafts[k]
        shaft_rate = y[at.W_L + k] - y[at.W_G + k]
        out[at.PHI_SI + k] = shaft_rate
        out[at.T_SI + k] = twist_torque_nm(y[at.PHI_SI + k], shaft_rate, shaft.stiffness_nm_rad, shaft.damping_nms_rad)
    clutch_torques(y, u, modes, out, law)
    for k in range(2):
        shaft = law.shafts[k]
        net_nm = out[at.T_F + k] - out[at.T_SI + k] - shaft.clutch_damping_nms_rad * y[at.W_L + k]
        out[at.W_L + k] = net_nm / shaft.clutch_inertia_kg_m2
    hub_nm = out[at.T_FW] - out[at.T_IMPELLER] - out[at.T_F] - out[at.T_F + 1] - law.hub_damping_nms_rad * y[at.W_H]
    out[at.W_E] = (engine_nm - out[at.T_FW]) / law.engine_inertia_kg_m2
    out[at.W_H] = hub_nm / law.hub_inertia_kg_m2
    out[at.PHI_FW] = twist_rate
    out[at.CRANK] = y[at.W_E]
    out[at.P_M] = manifold_rate_pa_s(y[at.P_M], u[at.AIR_FLOW], y[at.W_E], law.air_k, law.engine)


@part
def output_rates(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> None:
    """Fill ``out`` from the gears to the road."""
    output, vehicle = law.output, law.vehicle
    is_automatic = law.converter.is_there != 0
    inertia_kg_m2 = output.inertia_kg_m2
    net_nm = -output.damping_nms_rad * y[at.W_D]
    for k in range(2):
        shaft = law.shafts[k]
        ratio = y[at.GEAR_RATIO] if is_automatic and k == 0 else u[at.RATIO + k]
        gear_rad_s, shaft_nm = y[at.W_G + k], out[at.T_SI + k] + out[at.T_TURBINE + k]
        out[at.T_SY + k] = 0.0
        if modes[at.LINK + k] == ENGAGED:
            inertia_kg_m2 += ratio * ratio * shaft.gear_inertia_kg_m2
            efficiency = law.synchroniser.efficiency_ratio
            net_nm += ratio * geared_torque_nm(shaft_nm, gear_rad_s, efficiency, shaft.gear_damping_nms_rad)
            if is_automatic and k == 0:  # what the changing ratio makes the turbine faster
                net_nm -= ratio * shaft.gear_inertia_kg_m2 * u[at.RATIO_RATE] * y[at.W_D]
            continue
        if modes[at.LINK + k] == SYNCHRONISING:
            out[at.T_SY + k] = synchroniser_torque_nm(ratio * y[at.W_D] - gear_rad_s, law.synchroniser)
            net_nm -= ratio * out[at.T_SY + k]
        free_nm = shaft_nm + out[at.T_SY + k] - shaft.gear_damping_nms_rad * gear_rad_s
        out[at.W_G + k] = free_nm / shaft.gear_inertia_kg_m2
    twist_rate = y[at.W_D] - y[at.W_W]
    out[at.T_OS] = twist_torque_nm(y[at.PHI_OS], twist_rate, output.stiffness_nm_rad, output.shaft_damping_nms_rad)
    out[at.PHI_OS] = twist_rate
    out[at.W_D] = (net_nm - out[at.T_OS]) / inertia_kg_m2
    for k in range(2):
        if modes[at.LINK + k] == ENGAGED:
            out[at.W_G + k] = u[at.RATIO + k] * out[at.W_D]
    if is_automatic:
        out[at.W_G] = y[at.GEAR_RATIO] * out[at.W_D] + u[at.RATIO_RATE] * y[at.W_D]
    traction_n = tyre_force_n(y[at.W_W], y[at.V], vehicle)
    brake_n = brake_force_n(u[at.BRAKE], y[at.V], law.full_brake_m_s, vehicle)
    wheel_brake_nm = vehicle.driven_brake_ratio * brake_n * vehicle.wheel_radius_m
    wheel_nm = out[at.T_OS] - traction_n * vehicle.wheel_radius_m - vehicle.wheel_damping_nms_rad * y[at.W_W]
    road_n = (1.0 - vehicle.driven_brake_ratio) * brake_n + road_load_n(y[at.V], u[at.GRADE], vehicle)
    out[at.F_X] = traction_n
    out[at.W_W] = (wheel_nm - wheel_brake_nm) / vehicle.wheel_inertia_kg_m2
    out[at.V] = (traction_n - road_n) / vehicle.mass_kg
    if modes[at.HELD] != 0:
        out[at.W_W] = out[at.V] = 0.0
    out[at.DISTANCE] = y[at.V]


@part
def heat_rates(y: FloatArray, u: FloatArray, out: FloatArray, law: PlantLaw) -> None:
    """Fill ``out`` with the warming of clutches and sump."""
    to_oil_w = out[at.T_IMPELLER] * y[at.W_H] - out[at.T_TURBINE] * y[at.W_G]
    for k in range(2):
        clutch = law.clutches[k]
        power_w = abs(out[at.T_F + k] * (y[at.W_H] - y[at.W_L + k]))
        out[at.T_C + k] = clutch_heating_rate_k_s(
            power_w, y[at.T_C + k], y[at.T_OIL], clutch.heat_capacity_j_k, clutch.convection_w_k
        )
        to_oil_w += convected_w(y[at.T_C + k], y[at.T_OIL], clutch.convection_w_k)
    out[at.T_OIL] = sump_heating_rate_k_s(
        to_oil_w, y[at.T_OIL], u[at.COOLANT], law.sump_heat_capacity_j_k, law.sump_convection_w_k
    )


@part
def evaluate(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> None:
    """Put the rates of the state and the torques behind them into ``out``."""
    input_rates(y, u, modes, out, law)
    output_rates(y, u, modes, out, law)
    heat_rates(y, u, out, law)


@part
def lock_or_slip(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> bool:
    """Lock and unlock the clutches as the torques in ``out`` demand; True if a mode changed (Karnopp's rule)."""
    has_changed = False
    for k in range(2):
        clutch = law.clutches[k]
        capacity = capacity_nm(y, u, k, clutch)
        slip_rad_s = y[at.W_H] - y[at.W_L + k]
        if modes[at.STICK + k] != 0:
            if abs(out[at.T_F + k]) >= capacity:
                modes[at.STICK + k] = 0
                u[at.DIRECTION + k] = 1.0 if out[at.T_F + k] > 0.0 else -1.0
                has_changed = True
        elif abs(slip_rad_s) > clutch.friction.lock_band_rad_s:
            u[at.DIRECTION + k] = 1.0 if slip_rad_s > 0.0 else -1.0
        else:
            required_nm = locking_torque_nm(y, out, k, law)
            if abs(required_nm) <= capacity:
                modes[at.STICK + k] = 1
                has_changed = True
            else:
                u[at.DIRECTION + k] = 1.0 if required_nm > 0.0 else -1.0
    return has_changed
