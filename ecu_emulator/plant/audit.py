"""Where the energy goes: what the engine gives against what moves, is sprung, or turned to heat."""

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import kernel, part
from clutch_model.pack import convected_w
from ecu_emulator.plant import state as at
from ecu_emulator.plant.driveline import ENGAGED, brake_force_n, geared_torque_nm, road_load_n
from ecu_emulator.plant.rates import PlantLaw

# Places in the account.
ENGINE = 0
ENGINE_ABSOLUTE = 1
CLUTCH = 2
BEARINGS = 3
DAMPERS = 4
GEARS = 5
SYNCHRONISERS = 6
TYRES = 7
BRAKES = 8
ROAD = 9
COOLANT = 10
CONVERTER = 11
ACCOUNT_COUNT = 12


@part
def save_account(account: FloatArray) -> None:
    """Save the account in its second third; the last third is workspace."""
    for entry in range(account.size // 3):
        account[ACCOUNT_COUNT + entry] = account[entry]


@part
def restore_account(account: FloatArray) -> None:
    """Put the account back to what was saved."""
    for entry in range(account.size // 3):
        account[entry] = account[ACCOUNT_COUNT + entry]


@kernel
def stored_energy_j(y: FloatArray, law: PlantLaw) -> float:
    """Return kinetic and spring energy of all bodies [J]."""
    twice = law.engine_inertia_kg_m2 * y[at.W_E] ** 2 + law.hub_inertia_kg_m2 * y[at.W_H] ** 2
    twice += law.flywheel.stiffness_nm_rad * y[at.PHI_FW] ** 2 + law.output.stiffness_nm_rad * y[at.PHI_OS] ** 2
    twice += law.output.inertia_kg_m2 * y[at.W_D] ** 2
    twice += law.vehicle.wheel_inertia_kg_m2 * y[at.W_W] ** 2 + law.vehicle.mass_kg * y[at.V] ** 2
    for k in range(2):
        shaft = law.shafts[k]
        twice += shaft.clutch_inertia_kg_m2 * y[at.W_L + k] ** 2 + shaft.gear_inertia_kg_m2 * y[at.W_G + k] ** 2
        twice += shaft.stiffness_nm_rad * y[at.PHI_SI + k] ** 2
    return float(0.5 * twice)


@part
def shaft_powers(y: FloatArray, modes: Int64Array, out: FloatArray, powers: FloatArray, law: PlantLaw) -> None:
    """Add the losses of both input shafts, their gears and synchronisers to ``powers`` [W]."""
    for k in range(2):
        shaft = law.shafts[k]
        gear_rad_s = y[at.W_G + k]
        twist_rate = y[at.W_L + k] - gear_rad_s
        powers[CLUTCH] += out[at.T_F + k] * (y[at.W_H] - y[at.W_L + k])
        powers[DAMPERS] += shaft.damping_nms_rad * twist_rate * twist_rate
        bearing_nms = shaft.clutch_damping_nms_rad * y[at.W_L + k] ** 2 + shaft.gear_damping_nms_rad * gear_rad_s**2
        powers[BEARINGS] += bearing_nms
        if modes[at.LINK + k] == ENGAGED:
            efficiency = law.synchroniser.efficiency_ratio
            shaft_nm = out[at.T_SI + k] + out[at.T_TURBINE + k]
            powers[GEARS] += (shaft_nm - geared_torque_nm(shaft_nm, gear_rad_s, efficiency, 0.0)) * gear_rad_s


@part
def add_powers(
    account: FloatArray,
    weight_s: float,
    y: FloatArray,
    u: FloatArray,
    modes: Int64Array,
    out: FloatArray,
    law: PlantLaw,
) -> None:
    """Add the powers at one state, times ``weight_s``, to the account [J]; nothing if there is none."""
    if account.size == 0:
        return
    vehicle, output = law.vehicle, law.output
    powers = account[2 * ACCOUNT_COUNT :]
    powers[:] = 0.0
    powers[ENGINE] = out[at.T_E] * y[at.W_E]
    powers[ENGINE_ABSOLUTE] = abs(powers[ENGINE])
    shaft_powers(y, modes, out, powers, law)
    for k in range(2):
        powers[SYNCHRONISERS] += out[at.T_SY + k] * (u[at.RATIO + k] * y[at.W_D] - y[at.W_G + k])
    powers[BEARINGS] += law.hub_damping_nms_rad * y[at.W_H] ** 2 + output.damping_nms_rad * y[at.W_D] ** 2
    powers[BEARINGS] += vehicle.wheel_damping_nms_rad * y[at.W_W] ** 2
    powers[DAMPERS] += law.flywheel.damping_nms_rad * (y[at.W_E] - y[at.W_H]) ** 2
    powers[DAMPERS] += output.shaft_damping_nms_rad * (y[at.W_D] - y[at.W_W]) ** 2
    rim_m_s = vehicle.wheel_radius_m * y[at.W_W]
    powers[TYRES] = out[at.F_X] * (rim_m_s - y[at.V])
    brake_n = brake_force_n(u[at.BRAKE], y[at.V], law.full_brake_m_s, vehicle)
    share = vehicle.driven_brake_ratio
    powers[BRAKES] = brake_n * (share * rim_m_s + (1.0 - share) * y[at.V])
    powers[ROAD] = road_load_n(y[at.V], u[at.GRADE], vehicle) * y[at.V]
    powers[CONVERTER] = out[at.T_IMPELLER] * y[at.W_H] - out[at.T_TURBINE] * y[at.W_G]
    powers[COOLANT] = convected_w(y[at.T_OIL], u[at.COOLANT], law.sump_convection_w_k)
    for entry in range(ACCOUNT_COUNT):
        account[entry] += weight_s * powers[entry]
