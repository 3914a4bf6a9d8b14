"""The rows of the mismatch table: what each puts into the vehicle, and by what way it reaches the friction."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from diag_service.diagnosis.friction.evidence import REFERENCE_K
from ecu_emulator.plant.clutch import friction_ratio
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.scenario.scenario import Effects, Scenario

TORQUE = ("engine_torque_nm",)
PRESSURES = ("clutch1_pressure_pa", "clutch2_pressure_pa")
SPEEDS = ("engine_speed_rad_s", "hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mismatch:
    """One way in which a vehicle differs from what the service believes."""

    name: str
    way: str  # how it reaches the estimate
    effects: Effects = field(default_factory=Effects)
    lag_s: Mapping[str, float] = field(default_factory=dict)  # of the sensors, by quantity
    truth: Mapping[str, object] = field(default_factory=dict)  # what is true of the vehicle, by dotted key

    def applied(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this effect and no other."""
        sensors = dict(scenario.sensors)
        for quantity, lag_s in self.lag_s.items():
            sensors[quantity] = replace(sensors[quantity], lag_s=lag_s)
        truth = replace(scenario.truth, calibration={**scenario.truth.calibration, **self.truth})
        return replace(scenario, effects=self.effects, sensors=sensors, truth=truth)

    @property
    def friction_ratio(self) -> float:
        """Friction at the temperature for which it is stated, over what is drawn."""
        lining = nominal_parameters().lining._replace(fade_per_k=self.effects.friction_fade_per_k)
        return friction_ratio(REFERENCE_K, lining)


def exponent_of(exponent: float) -> dict[str, object]:
    """Return the truth about a vehicle whose friction follows another exponent over the slip, both clutches."""
    return {f"clutch{clutch}.friction.stribeck_exponent": exponent for clutch in (1, 2)}


MATCHED = Mismatch(name="none", way="the belief is right")
_STRIBECK = (
    "the curve is fitted with a wrong width, so that mu_S, which lies at its end, is extrapolated; the error has the "
    "sign of the slope and nearly cancels in the bias over the fluids"
)
_EXPONENT = "the curve has another shape between mu_S and mu_C"
_TIGHT = "the real film follows the pressure more slowly than the believed one: fine grooves, a tight lining"
_VISCOSITY = "the film follows the pressure with another delay, and the drag torque scales"
_CONTACT = "the film settles elsewhere: other transients, the same equilibrium load"
_GROOVES = "the real film follows the pressure faster than the believed one"
_LAG = "an unmodelled lag, far beyond the latency that the calibration allows for (3.5 ms of torque, 1 ms of pressure)"
_RIPPLE = "the speed moves within a segment, and its mean over the segment does not"
_PISTON = "the real piston pushes harder than believed, which is taken for friction"
_SPRING = "the touch point, which is estimated, shifts by about 0.06 bar, a little more than its prior deviation"
_SAMPLED = "the service takes the speed for the mean of a segment, and so for half a segment older than it is"
_DAMPING = "other vibrations; the balance of the input side does not contain them"
_MOTORING = "a gain error on negative torque only; it acts in downshifts"
_FRAMES = "fewer samples"
_LOSS = "gaps are bridged, and cost their stretch of the window: less is known, no bias"

ROWS: tuple[Mismatch, ...] = (
    MATCHED,
    Mismatch(
        name="friction falls 0.1 % per K above 80 degC",
        way="friction is stated, and compared, for packs of 90 degC; those of events are some kelvin colder or hotter",
        effects=Effects(friction_fade_per_k=0.001),
    ),
    Mismatch(
        name="friction falls 0.2 % per K above 80 degC",
        way="the same, twice as much",
        effects=Effects(friction_fade_per_k=0.002),
    ),
    Mismatch(name="Stribeck exponent 1.5", way=_EXPONENT, truth=exponent_of(1.5)),
    Mismatch(name="Stribeck exponent 2", way=_EXPONENT, truth=exponent_of(2.0)),
    Mismatch(name="w_S x 1.5", way=_STRIBECK, effects=Effects(stribeck_speed_ratio=1.5)),
    Mismatch(name="w_S x 0.67", way=_STRIBECK, effects=Effects(stribeck_speed_ratio=0.67)),
    Mismatch(name="viscosity x 1.25", way=_VISCOSITY, effects=Effects(viscosity_ratio=1.25)),
    Mismatch(name="viscosity x 0.8", way=_VISCOSITY, effects=Effects(viscosity_ratio=0.8)),
    Mismatch(name="K_c x 1.5", way=_CONTACT, effects=Effects(contact_stiffness_ratio=1.5)),
    Mismatch(name="K_c x 0.67", way=_CONTACT, effects=Effects(contact_stiffness_ratio=0.67)),
    Mismatch(name="grooves, film mobility x 2", way=_GROOVES, effects=Effects(film_mobility_ratio=2.0)),
    Mismatch(name="grooves, film mobility x 4", way=_GROOVES, effects=Effects(film_mobility_ratio=4.0)),
    Mismatch(name="film mobility x 0.25", way=_TIGHT, effects=Effects(film_mobility_ratio=0.25)),
    Mismatch(name="A_K x 1.01", way=_PISTON, effects=Effects(piston_area_ratio=1.01)),
    Mismatch(name="spring force + 30 N", way=_SPRING, effects=Effects(spring_force_n=30.0)),
    Mismatch(name="crank ripple 0.5", way=_RIPPLE, effects=Effects(crank_ripple_ratio=0.5)),
    Mismatch(name="engine speed sampled, not averaged", way=_SAMPLED, effects=Effects(engine_speed_is_sampled=True)),
    Mismatch(
        name="crank ripple 0.5, engine speed sampled",
        way="the firing ripple aliases into the balance as slow speed errors, times the engine's inertia",
        effects=Effects(crank_ripple_ratio=0.5, engine_speed_is_sampled=True),
    ),
    Mismatch(name="torque lag 10 ms", way=_LAG, lag_s=dict.fromkeys(TORQUE, 0.010)),
    Mismatch(
        name="torque lag 25 ms", way=f"{_LAG}; upshifts do not fit and are not used", lag_s=dict.fromkeys(TORQUE, 0.025)
    ),
    Mismatch(name="pressure lag 5 ms", way=_LAG, lag_s=dict.fromkeys(PRESSURES, 0.005)),
    Mismatch(name="all speeds lag 10 ms", way=_LAG, lag_s=dict.fromkeys(SPEEDS, 0.010)),
    Mismatch(name="driveline damping x 0.5", way=_DAMPING, effects=Effects(driveline_damping_ratio=0.5)),
    Mismatch(name="driveline damping x 2", way=_DAMPING, effects=Effects(driveline_damping_ratio=2.0)),
    Mismatch(name="motoring torque reads x 0.9", way=_MOTORING, effects=Effects(motoring_torque_ratio=0.9)),
    Mismatch(name="motoring torque reads x 1.1", way=_MOTORING, effects=Effects(motoring_torque_ratio=1.1)),
    Mismatch(name="frames every 20 ms", way=_FRAMES, effects=Effects(least_cycle_ms=20)),
    Mismatch(name="1 % of the frames lost", way=_LOSS, effects=Effects(frame_loss_ratio=0.01)),
    Mismatch(name="5 % of the frames lost", way=_LOSS, effects=Effects(frame_loss_ratio=0.05)),
    Mismatch(
        name="film, viscosity, w_S, K_c and touch point together",
        way="mobility x 1.5, viscosity x 1.1, w_S x 1.2, K_c x 1.2, spring + 15 N",
        effects=Effects(
            film_mobility_ratio=1.5,
            viscosity_ratio=1.1,
            stribeck_speed_ratio=1.2,
            contact_stiffness_ratio=1.2,
            spring_force_n=15.0,
        ),
    ),
)
# Of single drives alone: the table has what is on both sides of it.
HALF = Mismatch(name="film mobility x 0.5", way=_TIGHT, effects=Effects(film_mobility_ratio=0.5))
BY_NAME: Mapping[str, Mismatch] = {row.name: row for row in (*ROWS, HALF)}
