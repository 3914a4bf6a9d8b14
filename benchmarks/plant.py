"""The plant against its golden values: laws, power balance, error of the step, speed, the nominal cycle.

python benchmarks/plant.py
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from clutch_model.calibration import nominal_calibration
from clutch_model.film import (
    applied_pressure_pa,
    contact_pressure_pa,
    equilibrium_film_m,
    film_law,
    shear_factor_difference,
    squeeze_rate_m_s,
)
from clutch_model.friction import friction_law, kinetic_friction
from clutch_model.units import k_from_degc, pa_from_bar
from clutch_model.viscosity import viscosity_pa_s
from ecu_emulator.plant import Col, DriveSettings, Powertrain, nominal_parameters

CALIBRATION = nominal_calibration()
PARAMETERS = nominal_parameters()
COMPARED_S = 10.0
CYCLE_LIMIT_S = 80.0
SPEED_RUNS = 5
STEPS_S = (2.5e-4, 2.0e-4, 1.0e-4)
SHEAR = ((0.5, 0.207037), (1.0, 0.489824), (1.2, 0.671941), (1.5, 0.899603), (2.0, 1.013909), (3.0, 0.867053))
CONTACT = ((0.5, 665672.97), (1.0, 233214.19), (1.5, 67453.70), (2.0, 14778.49))
SQUEEZE = ((100.0, -7.177793e-2), (30.0, -2.429797e-3), (12.0, -7.015069e-5), (9.0, 3.261209e-4))
STRIBECK = ((0.1, 0.119), (1.0, 0.121925), (6.0, 0.132145), (12.0, 0.137110), (50.0, 0.139995))
CAPACITY = ((0, 5.0, 153.6), (0, 10.0, 363.7), (1, 5.0, 115.6), (1, 10.0, 280.8))


def train(dt_s: float, *, is_audited: bool = False) -> Powertrain:
    return Powertrain(CALIBRATION, PARAMETERS, DriveSettings(dt_s=dt_s), is_audited=is_audited)


def golden_values(console: Console) -> None:
    laws = [film_law(clutch) for clutch in CALIBRATION.clutches]
    law, friction, oil = laws[0], friction_law(CALIBRATION.clutches[0].friction), CALIBRATION.viscosity
    warm_pa_s = viscosity_pa_s(k_from_degc(90.0), oil.a_pa_s, oil.b_k, oil.pole_k)
    rows = [(f"phi_f - phi_fs, H = {ratio}", value, shear_factor_difference(ratio)) for ratio, value in SHEAR]
    rows += [(f"P_C [Pa], H = {h}", value, contact_pressure_pa(h * law.roughness_m, law)) for h, value in CONTACT]
    rows += [("nu(90 degC) [Pa s]", 6.424e-3, warm_pa_s), ("Q, clutch 1 [m^2]", 2.56171566e-4, law.squeeze_factor_m2)]
    rows += [
        (f"dh/dt at {h:g} um, 1 bar [m/s]", value, squeeze_rate_m_s(h * 1e-6, 1e5, warm_pa_s, law))
        for h, value in SQUEEZE
    ]
    rows += [(f"mu_K, |s| = {slip} rad/s", value, kinetic_friction(slip, friction)) for slip, value in STRIBECK]
    for clutch, pressure_bar, value in CAPACITY:
        own = laws[clutch]
        film_m = equilibrium_film_m(applied_pressure_pa(pa_from_bar(pressure_bar), own), own)
        capacity_nm = own.contact_factor_m3 * friction.mu_s * contact_pressure_pa(film_m, own)
        rows.append((f"capacity of clutch {clutch + 1} at {pressure_bar:g} bar [N m]", value, capacity_nm))
    table = Table("golden value", "expected", "here", "difference", title="Laws")
    for name, expected, here in rows:
        table.add_row(name, f"{expected:.7g}", f"{here:.7g}", f"{here / expected - 1.0:+.1e}")
    console.print(table)


def power_balance(console: Console) -> None:
    audited = train(DriveSettings().dt_s, is_audited=True)
    rows = audited.advance(CYCLE_LIMIT_S)
    gears = rows[:, Col.CURRENT_GEAR]
    console.print(f"nominal cycle: {np.count_nonzero(np.diff(gears))} shifts, {rows[-1, Col.T_S]:.2f} s")
    balance = audited.power_balance
    console.print(
        f"power balance: {balance.engine_absolute_j / 1e3:.0f} kJ through the crankshaft, "
        f"residual {balance.residual_ratio:.1e}; clutch heat {balance.clutch_j / 1e3:.1f} kJ, "
        f"residual {balance.heat_residual_ratio:.1e}"
    )


def step_halving(console: Console) -> None:
    table = Table("step [s]", "dw_H [rad/s]", "dT_F [N m]", title=f"Halving the step, {COMPARED_S:g} s")
    for dt_s in STEPS_S:
        change = np.abs(train(dt_s).advance(COMPARED_S) - train(dt_s / 2.0).advance(COMPARED_S))
        torque_nm = change[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]].max()
        table.add_row(f"{dt_s:g} -> {dt_s / 2:g}", f"{change[:, Col.HUB_SPEED].max():.1e}", f"{torque_nm:.1e}")
    console.print(table)


def speed(console: Console) -> None:
    for dt_s in STEPS_S:
        times_s, simulated_s = [], 0.0
        for _ in range(SPEED_RUNS):
            plant = train(dt_s)
            start_s = time.process_time()
            simulated_s = len(plant.advance(CYCLE_LIMIT_S)) * 1e-3
            times_s.append(time.process_time() - start_s)
        mark = " (default)" if dt_s == DriveSettings().dt_s else ""
        console.print(f"plant speed at {dt_s:g} s{mark}: {simulated_s / min(times_s):.0f} x real time on one core")


def main() -> None:
    console = Console(markup=False)  # units stand in brackets
    train(DriveSettings().dt_s).advance(0.01)  # compiles, or loads the cache
    golden_values(console)
    power_balance(console)
    step_halving(console)
    speed(console)


if __name__ == "__main__":
    main()
