"""The one table of limits on the data of a shift: what they are held against, in which unit, and where it comes from.

Three questions are asked. *Usable*: is there enough to put on one clock? *Data quality*: how far can the samples be
believed, on any vehicle, from 0 to 1? *Plausibility*: do the signals of the torque balance agree, moment by moment? The
figures of sound drives are of 960 emulated shifts with and without production scatter (docs/model.md, section
"Estimator") unless another source is named.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """From where on a flaw costs data quality, and from where on it takes all of it."""

    start: float
    end: float

    def score(self, flaw: float) -> float:
        """Return 1 up to the start of the band, 0 from its end on, and a straight line between."""
        return min(1.0, max(0.0, (self.end - flaw) / (self.end - self.start)))


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityLimits:
    """Every limit on the data of a shift; each name ends in its unit."""

    # Usable: without this the signals cannot be put on one clock.
    gap_periods: float = 2.5  # one missing frame is bridged by interpolation; in a longer gap no friction is looked for
    lost_periods: float = 8.5  # a longer gap may hide anything: the event is not used
    nominal_period_s: float = 0.01  # of signals whose message states no cycle time
    oil_range_k: tuple[float, float] = (233.15, 443.15)  # -40..170 degC: where the fluid's viscosity law holds

    # Data quality: each part from 0 to 1, and the least product of all parts.
    least_score_ratio: float = 0.5
    lost_ratio: Band = Band(start=0.0, end=0.4)  # of frames: half of it rejects an event; gaps are left out besides
    optional_message_ratio: float = 0.9  # factor for each message that failed, though no estimate needs it
    late_periods: float = 3.0  # a sample this much later than its sender's schedule says little about time
    saturated_ratio: Band = Band(start=0.0, end=0.1)  # of samples at the end of the scale
    wheel_ratio: Band = Band(start=0.03, end=0.13)  # rms of wheel over output speed; a hard launch reaches 0.022
    least_wheel_m_s: float = 2.0  # below this, speed sensors resolve too little for a ratio
    hub_mean_rad_s: Band = Band(start=1.0, end=5.0)  # engine less hub, which a torsion damper ties together
    pressure_median_pa: Band = Band(start=0.3e5, end=1.3e5)  # pressure less its lagged command, over the whole cut
    calibration_years: Band = Band(start=5.0, end=15.0)  # age of a vehicle's own calibration

    # Plausibility: two to three times what sound signals reach.
    speeds_rad_s: float = 2.0  # between shafts that turn together; sound: 0.76, torsion of flywheel and shafts
    launch_speeds_rad_s: float = 8.0  # engine and hub in a launch, whose clutch may judder; sound: 3.7
    speeds_mean_s: float = 0.05  # five samples: noise falls by half, a fault shorter than that weighs little
    locked_s: float = 0.10  # before the shift one clutch is locked, at its end the other one
    settling_rad_s: float = 0.5  # in half of that time: so fast changes the slip of a clutch that is not locked yet
    turning_rad_s: float = 10.0  # slower, a shaft's speed sensor resolves too little for a ratio
    ringing_s: float = 0.05  # so long does a shaft swing after its synchroniser has engaged a gear
    in_gear_s: float = 0.10  # before its slip window the on-coming shaft stands in gear
    pressure_moment_pa: float = 0.20e5  # pressure of the slipping clutch less the expected one; sound: 0.10e5
    pressure_mean_s: float = 0.06  # the span of that moment
    command_clock_s: float = 0.01  # a command may be so far ahead of the speeds, to whose clock the pressures are moved
    following_ratio: float = 0.5  # of what a command is ahead of its pressure: no valve follows a jump to the letter
    travel_pa: float = 0.30e5  # so near its touch pressure a piston may still be on its way
    catching_up_s: float = 0.15  # until the pressure behind a piston that has arrived is the commanded one; sound: 0.10
    pressure_window_pa: float = 0.10e5  # the same over the whole slip window; sound: 0.05e5
    zero_gate: float = 25.0  # squared distance of a measured zero from the known one, in variances: 6e-7 by chance
    least_noise_steps: float = 0.75  # of the resolution; a ramp without noise seems to have up to 0.6
    repeats_chance: float = 1e-6  # that a sound signal repeats a value as often as one that is called frozen


LIMITS: Final = QualityLimits()
