"""docs/model.md against the code: cited equations exist, values in its tables are those of the files."""

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant import DriveSettings, nominal_parameters

ROOT = Path(__file__).parents[2]
MODEL = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
PACKAGES = ("benchmarks", "clutch_model", "diag_service", "ecu_emulator")
LABEL = r"[A-Z]?\d+[a-z]?"

CLUTCHES = nominal_calibration().clutches
PLANT = nominal_parameters()
UNCERTAINTY = nominal_calibration().uncertainty
BIAS = nominal_calibration().bias


def both(part: str, name: str) -> tuple[float, ...]:
    """Return a number of both clutches, once where it is the same."""
    return tuple(dict.fromkeys(float(getattr(getattr(clutch, part), name)) for clutch in CLUTCHES))


ROWS: dict[str, Sequence[float]] = {
    "mu_C, mu_S": (*both("friction", "mu_c"), *both("friction", "mu_s")),
    "w_S, lambda_S": (*both("friction", "stribeck_speed_rad_s"), *both("friction", "stribeck_exponent")),
    "w_rel": both("friction", "lock_band_rad_s"),
    "Ro": both("geometry", "outer_radius_m"),
    "Ri": both("geometry", "inner_radius_m"),
    "Np": both("geometry", "interface_count"),
    "A_K": both("geometry", "piston_area_m2"),
    "C": both("geometry", "contact_factor_m3"),
    "Vg": both("geometry", "viscous_factor_m4"),
    "sigma": both("film", "roughness_m"),
    "K_c": both("film", "contact_stiffness_pa"),
    "Phi, d": (*both("film", "permeability_m2"), *both("film", "lining_thickness_m")),
    "F_pre, K_K, x_fill": (
        *both("piston", "spring_preload_n"),
        *both("piston", "spring_rate_n_m"),
        *both("piston", "fill_stroke_m"),
    ),
    "C_th, hA": (*both("thermal", "heat_capacity_j_k"), *both("thermal", "convection_w_k")),
    "C_oil, hA_oil": PLANT.sump,
    "P_line, tau_sol": PLANT.hydraulics[:2],
    "C_pack, k_or, dP_lam": PLANT.hydraulics[2:],
    "k_FW, c_FW": PLANT.flywheel,
    "k_OS, c_OS": PLANT.output[2:],
    "ratio 1 to 6": PLANT.gearbox.gear_ratios,
    "m, R_w, f_r, CdA, rho": (
        PLANT.vehicle.mass_kg,
        PLANT.vehicle.wheel_radius_m,
        PLANT.vehicle.rolling_resistance_ratio,
        PLANT.vehicle.drag_area_m2,
        PLANT.vehicle.air_density_kg_m3,
    ),
    "w_up(1..5)": PLANT.control.upshift_speeds_rad_s,
    "w_dn(2..6)": PLANT.control.downshift_speeds_rad_s,
    "torque gain, engine inertia": (
        100.0 * UNCERTAINTY.torque_gain_ratio,
        100.0 * UNCERTAINTY.engine_inertia_ratio,
    ),
    "piston area, viscosity": (100.0 * UNCERTAINTY.piston_area_ratio, 100.0 * UNCERTAINTY.viscosity_ratio),
    "torque latency, pressure latency": (
        1e3 * UNCERTAINTY.torque_latency_s,
        1e3 * UNCERTAINTY.pressure_latency_s,
    ),
    "the same, in the middle": (1e3 * BIAS.torque_latency_s, 1e3 * BIAS.pressure_latency_s),
    "film mobility, Stribeck exponent, of both clutches": (
        UNCERTAINTY.film_mobility_log,
        UNCERTAINTY.stribeck_exponent_log,
    ),
    "change of friction with the temperature of the pack": (UNCERTAINTY.friction_temperature_1_k,),
    "torque offset": (UNCERTAINTY.torque_offset_nm,),
}


@pytest.mark.parametrize("symbol", ROWS)
def test_a_value_in_the_tables_is_the_one_in_use(symbol: str) -> None:
    written = next(
        line.split("|")[2] for line in MODEL.splitlines() if line.startswith(f"| {symbol} |") and len(line) > 9
    )
    numbers = [float(number) for number in re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?", written)]
    assert numbers == pytest.approx(list(ROWS[symbol]), rel=1e-4)


def test_the_step_of_the_integration_is_the_default() -> None:
    assert f"Runge-Kutta method in steps of {DriveSettings().dt_s * 1e3:g} ms" in " ".join(MODEL.split())


def test_every_equation_that_the_code_cites_is_in_the_document() -> None:
    known = set(re.findall(rf"\(({LABEL})\)", MODEL))
    cited = {
        (label, path.name)
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for citation in re.findall(r"\beqs?\. ((?:\([^)]+\)(?:, | and | to )?)+)", path.read_text(encoding="utf-8"))
        for label in re.findall(rf"\(({LABEL})\)", citation)
    }
    assert len(cited) > 50
    assert {one for one in cited if one[0] not in known} == set()
