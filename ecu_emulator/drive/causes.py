"""What is wrong with a car and why: each cause as what it does to clutches, hydraulics and sensors.

Strength 1 is the smallest that matters to a workshop. Every number is scaled with a factor that is drawn with the
vehicle, so that no two cars have the same fault. Sources: [L] literature as its authors summarise it, [C] chosen.

aged fluid
    mu_C falls, mu_S rises, the slope is lost on both clutches; thinner by shear. [L] degraded fluid flattens mu over
    speed: SAE 2003-01-3254; oxidation raises friction and lowers its slope: Friction 9 (2021) 401. Size: case 1 [C].
water
    Friction rises and becomes erratic, slope falls, an emulsion is thicker and drags more, valves answer later. [L]
    water raises friction at once, much of it makes shudder: Lubricants 11 (2023) 459; Fatima, Luleaa 2012. Sizes [C].
wrong fluid
    Viscosity and both coefficients are others from the fill on, either way. [C]
glazed lining
    One clutch: both coefficients fall, closed pores let the film go more slowly, its surface is smoother. [L] glazing
    alone does not end anti-shudder performance: SAE 2003-01-3254. Sizes [C].
worn lining
    One clutch: the piston goes further, .2 mm over eight faces, which its spring and its filling show. [C]
air
    Oil with bubbles is soft: the pack takes more oil for each bar, valves lag; it drags less as it foams. [C]
weak pump or leak
    The line no longer reaches what is asked for, and less flows. [C]
return spring
    One clutch: its preload has sagged. [C]
sensors
    The scale of one pressure, or of the engine's torque, has drifted, either way; zeros a little. [C]
dragging clutch
    One pack whose plates are bent opens less wide. [C]
synchroniser
    It takes less torque to speed. No signal of the service shows it. [C]
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from clutch_model.calibration import CONVERTERS, Calibration, ClutchCalibration, with_clutch
from ecu_emulator.plant.parameters import PlantParameters
from ecu_emulator.scenario.faults import Cause, CauseKind
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.scenario.signals import Sensors, generator
from ecu_emulator.truth import CauseTruth

EITHER_WAY: Final = frozenset({CauseKind.WRONG_FLUID, CauseKind.PRESSURE_SENSOR, CauseKind.TORQUE_SENSOR})
PER_STRENGTH: Final[Mapping[CauseKind, Mapping[str, float]]] = {  # natural logarithms of ratios, or what is added
    CauseKind.AGED_FLUID: {"mu_c": -0.05, "mu_s": 0.05, "viscosity": -0.03},
    CauseKind.WATER: {"mu_c": 0.015, "mu_s": 0.05, "erratic": 0.03, "viscosity": 0.06, "open_drag": 0.4,
                      "solenoid_lag": 0.25},
    CauseKind.WRONG_FLUID: {"mu_c": -0.04, "mu_s": 0.04, "viscosity": 0.15},
    CauseKind.AIR: {"pack_compliance": 0.5, "solenoid_lag": 0.15, "open_drag": -0.2},
    CauseKind.WEAK_PUMP: {"supply": -0.2, "orifice": -0.12},
    CauseKind.TORQUE_SENSOR: {"torque_gain": 0.04, "torque_zero_nm": 1.0},
    CauseKind.SYNCHRONISER: {"synchroniser_torque": -0.25},
    CauseKind.GLAZED_LINING: {"mu_c": -0.06, "mu_s": -0.05, "permeability": -0.5, "roughness": -0.05},
    CauseKind.WORN_LINING: {"fill_stroke": 0.1},
    CauseKind.RETURN_SPRING: {"spring_preload_n": -40.0},
    CauseKind.PRESSURE_SENSOR: {"pressure_gain": 0.04, "pressure_zero_pa": 1.5e3},
    CauseKind.DRAGGING_CLUTCH: {"open_gap": -0.4, "open_drag": 0.6},
}  # fmt: skip
SCATTER_LOG: Final = 0.25  # of each number from car to car, and of what all of a cause's have in common
_EACH: Final = ("clutch1", "clutch2")


@dataclass(frozen=True, slots=True, kw_only=True)
class CausedChanges:
    """What the causes of one car make of it, at their strength as a drive begins."""

    truths: tuple[CauseTruth, ...]
    both: Mapping[str, float]  # logarithms and summands, all causes together
    each: tuple[Mapping[str, float], Mapping[str, float]]  # of each clutch, with those of both

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return them; the same vehicle seed draws the same."""
        truths, both, each = [], dict[str, float](), (dict[str, float](), dict[str, float]())
        for cause in scenario.causes:
            strength = cause.strength_at(scenario.odometer_m)
            clutch, drawn = _drawn(cause, scenario.seed_of_vehicle)
            clutch = min(clutch, 1) if scenario.transmission in CONVERTERS else clutch  # whose only one is the first
            if strength == 0.0:
                continue
            changes = {name: strength * size for name, size in drawn.items()}
            for sums in (both, *each) if clutch == 0 else (each[clutch - 1],):
                for name, size in changes.items():
                    sums[name] = sums.get(name, 0.0) + size
            added = {name for name in changes if name == "erratic" or name.endswith(("_nm", "_n", "_pa"))}
            shown = {name: size if name in added else math.exp(size) for name, size in changes.items()}
            truths.append(CauseTruth(kind=cause.kind, strength=strength, clutch=clutch or None, changes=shown))
        return cls(truths=tuple(truths), both=both, each=each)

    def calibration(self, sound: Calibration) -> Calibration:
        """Return clutches and fluid as they are with these causes."""
        clutches = sound.clutches
        for number, (clutch, own) in enumerate(zip(sound.clutches, self.each, strict=True), start=1):
            clutches = with_clutch(clutches, number, _clutch(clutch, own))
        fluid = sound.viscosity
        return replace(
            sound, clutches=clutches, viscosity=replace(fluid, a_pa_s=fluid.a_pa_s * _ratio(self.both, "viscosity"))
        )

    def parameters(self, sound: PlantParameters) -> PlantParameters:
        """Return what is around the clutches."""
        both, valves, sync = self.both, sound.hydraulics, sound.synchroniser
        drags = (size * _ratio(own, "open_drag") for size, own in zip(sound.open_drags, self.each, strict=True))
        return replace(
            sound,
            hydraulics=valves._replace(
                supply_ratio=valves.supply_ratio * _ratio(both, "supply"),
                solenoid_lag_s=valves.solenoid_lag_s * _ratio(both, "solenoid_lag"),
                pack_compliance_m3_pa=valves.pack_compliance_m3_pa * _ratio(both, "pack_compliance"),
                orifice_m3_s_sqrt_pa=valves.orifice_m3_s_sqrt_pa * _ratio(both, "orifice"),
            ),
            synchroniser=sync._replace(torque_nm=sync.torque_nm * _ratio(both, "synchroniser_torque")),
            lining=sound.lining._replace(
                erratic_ratio=math.hypot(sound.lining.erratic_ratio, both.get("erratic", 0.0))
            ),
            open_drags=type(sound.open_drags)(*drags),
        )

    def sensors(self, sound: Sensors) -> Sensors:
        """Return how the sensors err."""
        drifted = dict(sound)
        errors = {f"{clutch}_pressure_pa": (own, "pressure") for clutch, own in zip(_EACH, self.each, strict=True)}
        errors |= {"lockup_pressure_pa": (self.each[0], "pressure"), "engine_torque_nm": (self.both, "torque")}
        for quantity, (own, name) in errors.items():
            unit = "pa" if name == "pressure" else "nm"
            sensor = drifted[quantity]
            drifted[quantity] = replace(
                sensor,
                gain_ratio=sensor.gain_ratio * _ratio(own, f"{name}_gain"),
                offset=sensor.offset + own.get(f"{name}_zero_{unit}", 0.0),
            )
        return drifted


def _drawn(cause: Cause, seed: int) -> tuple[int, dict[str, float]]:
    """Return the clutch, 0 of both, and what a strength of 1 does in this vehicle."""
    rng = generator(seed, f"cause {cause.kind}")
    clutch, sign = int(rng.integers(1, 3)), float(rng.choice((-1.0, 1.0)))
    common = float(rng.standard_normal())
    own = rng.standard_normal(len(PER_STRENGTH[cause.kind]))
    factors: Sequence[float] = np.exp(SCATTER_LOG * (0.5 * common + 0.75 * own)).tolist()
    sign = sign if cause.kind in EITHER_WAY else 1.0
    sizes = PER_STRENGTH[cause.kind].items()
    drawn = {name: sign * size * factor for (name, size), factor in zip(sizes, factors, strict=True)}
    return (cause.clutch or clutch) if cause.kind.is_of_one_clutch else 0, drawn


def _ratio(changes: Mapping[str, float], name: str) -> float:
    return math.exp(changes.get(name, 0.0))


def _clutch(clutch: ClutchCalibration, own: Mapping[str, float]) -> ClutchCalibration:
    curve, piston, film = clutch.friction, clutch.piston, clutch.film
    return replace(
        clutch,
        friction=replace(curve, mu_c=curve.mu_c * _ratio(own, "mu_c"), mu_s=curve.mu_s * _ratio(own, "mu_s")),
        piston=replace(
            piston,
            spring_preload_n=piston.spring_preload_n + own.get("spring_preload_n", 0.0),
            fill_stroke_m=piston.fill_stroke_m * _ratio(own, "fill_stroke"),
        ),
        film=replace(
            film,
            permeability_m2=film.permeability_m2 * _ratio(own, "permeability"),
            roughness_m=film.roughness_m * _ratio(own, "roughness"),
            open_gap_m=film.open_gap_m * _ratio(own, "open_gap"),
        ),
    )
