"""Vehicles that differ from their type, drawn by seed; drives of one vehicle share all but noise and driver."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from clutch_model.calibration import nominal_calibration, shipped_calibration
from clutch_model.pack import viscosities_pa_s
from ecu_emulator.scenario.scenario import Effects, FluidCondition, Scenario, Truth, WorkshopRoutine
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import FLUIDS

CYCLES = 3
SPEEDS = ("engine_speed_rad_s", "hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s", "output_speed_rad_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """One drawn vehicle; what it truly is."""

    seed: int
    fluid: FluidCondition
    torque_gain: float
    torque_offset_nm: float
    inertia_ratio: float
    shaft_inertia_ratio: float
    area_ratios: tuple[float, float]
    zeros_pa: tuple[float, float]
    touches_pa: tuple[float, float]
    torque_latency_s: float
    pressure_latency_s: float
    speed_latency_s: float
    effects: Effects
    transmission: str = "nominal"
    oil: Mapping[str, float] = field(default_factory=dict, hash=False)  # of another viscosity, as a scenario has it

    def scenario(self, drive: int, routine: WorkshopRoutine) -> Scenario:
        """Return one of its drives; noise and driver differ from drive to drive."""
        base = load_scenario("noise_only")
        sensors = {
            name: replace(sensor, latency_s=self.speed_latency_s) if name in SPEEDS else sensor
            for name, sensor in base.sensors.items()
        }
        sensors["engine_torque_nm"] = replace(
            sensors["engine_torque_nm"],
            gain_ratio=self.torque_gain,
            offset=self.torque_offset_nm,
            latency_s=self.torque_latency_s,
        )
        for m in range(2):
            name = f"clutch{m + 1}_pressure_pa"
            sensors[name] = replace(sensors[name], offset=self.zeros_pa[m], latency_s=self.pressure_latency_s)
        return replace(
            base,
            seed=10 * self.seed + drive,
            transmission=self.transmission,
            cycles=CYCLES,
            fluid=replace(base.fluid, condition=self.fluid),
            sensors=sensors,
            effects=self.effects,
            truth=Truth(calibration=self._overrides()),
            routine=routine,
        )

    def _overrides(self) -> dict[str, object]:
        nominal = shipped_calibration(self.transmission)
        side = nominal.input_side
        shafts = [value * (1.0 + self.shaft_inertia_ratio) for value in side.input_shaft_inertias_kg_m2]
        overrides: dict[str, object] = {
            "input_side.engine_inertia_kg_m2": side.engine_inertia_kg_m2 * (1.0 + self.inertia_ratio),
            "input_side.input_shaft_inertias_kg_m2": shafts,
        }
        for m, clutch in enumerate(nominal.clutches):
            area_m2 = clutch.geometry.piston_area_m2 * (1.0 + self.area_ratios[m])
            preload_n = clutch.piston.spring_preload_n + self.touches_pa[m] * area_m2
            overrides |= {
                f"clutch{m + 1}.geometry.piston_area_m2": area_m2,
                f"clutch{m + 1}.piston.spring_preload_n": preload_n,
            }
        return overrides | dict(self.oil)


WARM_K, HOT_K = 313.15, 373.15  # where viscosities of oils are stated
OPEN_DRAGS = ("peak", "bounded", "none")


def with_other_laws(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle that obeys laws of the cold which the estimator does not have, by its seed.

    Open packs drag with a peak over slip, a third to three times as much; or as the film law says, bounded at 4 to
    15 Nm; or next to not. The oil has its viscosities at 40 and 100 degC by another Vogel pole: at -10 degC it is three
    quarters to one and a half times as thick. Films yield a third to three times as fast.
    """
    rng = np.random.default_rng([vehicle.seed, 1146])
    form = OPEN_DRAGS[int(rng.integers(len(OPEN_DRAGS)))]
    peak_ratio, limit_nm = float(np.exp(rng.uniform(-np.log(3.0), np.log(3.0)))), float(rng.uniform(4.0, 15.0))
    oil = nominal_calibration().viscosity
    thick, thin = (float(viscosities_pa_s(one, oil.a_pa_s, oil.b_k, oil.pole_k)) for one in (WARM_K, HOT_K))
    pole_k = float(rng.uniform(155.0, 195.0))
    ratios = [float(np.log(viscosities_pa_s(one, 1.0, 1.0, pole_k))) for one in (WARM_K, HOT_K)]
    b_k = math.log(thick / thin) / (ratios[0] - ratios[1])
    effects = replace(
        vehicle.effects,
        open_drag_ratio={"peak": peak_ratio, "bounded": 1.0, "none": 0.05}[form],
        open_drag_limit_nm=limit_nm if form == "bounded" else 0.0,
        viscosity_ratio=float(np.exp(rng.uniform(-np.log(1.2), np.log(1.2)))),
        film_mobility_ratio=float(np.exp(rng.uniform(-np.log(3.0), np.log(3.0)))),
    )
    other = {
        "viscosity.a_pa_s": thick * math.exp(-b_k * ratios[0]), "viscosity.b_k": b_k,
        "viscosity.pole_k": pole_k,
    }  # fmt: skip
    return replace(vehicle, effects=effects, oil=other)


def draw(seed: int, *, has_mismatch: bool) -> Vehicle:
    """Return the vehicle of a seed."""
    rng = np.random.default_rng([seed, 2015])
    normal = partial(rng.normal, 0.0)

    def pair(std: float) -> tuple[float, float]:
        return float(normal(std)), float(normal(std))

    def factor(limit: float) -> float:
        return float(np.exp(rng.uniform(-np.log(limit), np.log(limit))))

    effects = Effects()
    if has_mismatch:
        effects = Effects(
            film_mobility_ratio=factor(1.5),
            viscosity_ratio=factor(1.2),
            stribeck_speed_ratio=factor(1.25),
            contact_stiffness_ratio=factor(1.25),
            spring_force_n=float(rng.uniform(-15.0, 15.0)),
        )
    return Vehicle(
        seed=seed,
        fluid=FLUIDS[seed % len(FLUIDS)],
        torque_gain=1.0 + float(normal(0.03)),
        torque_offset_nm=float(normal(5.0)),
        inertia_ratio=float(normal(0.03)),
        shaft_inertia_ratio=float(normal(0.005)),
        area_ratios=pair(0.01),
        zeros_pa=pair(5.0e3),
        touches_pa=pair(5.0e3),
        torque_latency_s=float(rng.uniform(0.0, 0.040)),
        pressure_latency_s=float(rng.uniform(0.0, 0.020)),
        speed_latency_s=float(rng.uniform(0.0, 0.010)),
        effects=effects,
    )
