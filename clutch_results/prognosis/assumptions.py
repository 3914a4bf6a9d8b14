"""Everything that a prognosis assumes beyond the results, as numbers.

Bends, random wear, powers of the work and the future load were tuned on simulated lives (seeds
below 2000); all else is chosen by reasoning: usual losses are usual intervals of change, with room on both sides.

Margin is ``mu_C - mu_S`` over that of new fluid: 1 when new, 0 where the slope turns. Level: ``mu_C`` over that of new.
"""

from dataclasses import dataclass
from typing import Final

REFERENCE_K: Final = 353.15  # oil temperature to which friction is reduced: 80 degC
LEAST_ROWS: Final = 8  # with fewer results of this fluid nothing is said
SURE_OF_AGEING: Final = 0.9  # below this probability that friction falls there is no trend yet
HORIZON_M: Final = 3.0e8  # 300,000 km: no prognosis looks farther
NEW_WITHIN_M: Final = 5.0e6  # a fluid first seen within 5,000 km of its fill counts as new
SERVICE_DISTANCE_M: Final = 1.5e7  # to the next service, where nobody says another

# How the work of a fluid may count; each with its probability before any result.
HEATS_PER_K: Final = {0.0: 0.4, 0.017: 0.25, 0.04: 0.2, 0.07: 0.15}  # exp(this * kelvins of oil): twice in 40, 17, 10 K
SHAPES: Final = {0.5: 0.01, 0.7: 0.02, 1.0: 0.94, 1.3: 0.02, 1.7: 0.01}  # wear is a power of the work: below 1 it slows
ENERGY_PROBABILITY: Final = 0.4  # that the work counts by the energy of slip, not by distance alone
RANDOMNESS: Final = {
    0.0: 0.72,
    0.05: 0.12,
    0.12: 0.09,
    0.25: 0.07,
}  # random wear after a usual life, as a share of the usual wear
USUAL_LIFE_M: Final = 9.5e7  # at which all shapes have the same wear

# A bend behind: the rate has changed once while this fluid was in.
BENT_PROBABILITY: Final = 0.2
BENT_FACTOR: Final = 2.2  # by which, the median, and the deviation of its natural logarithm
BENT_LOG_STD: Final = 0.75
RATE_BEFORE_STD: Final = 0.6  # of the rate before it, over the usual rate
CLEAR_BEND: Final = 1.5  # a smaller factor is no bend that lives are counted by
# A knee ahead makes the rate some times as large from a share of the life on; each with its chance where there is one.
KNEE_PROBABILITY: Final = 0.07
KNEE_FACTORS: Final = {1.7: 0.2, 2.5: 0.3, 3.5: 0.3, 5.0: 0.2}
KNEE_SHARES: Final = {0.45: 0.15, 0.6: 0.15, 0.7: 0.2, 0.78: 0.2, 0.85: 0.2, 0.93: 0.1}
HAND_SHARE: Final = 0.85  # of that probability, beside it: that the rate becomes so large at once, whatever the age
HAND_FACTOR: Final = 5.5
LOAD_LOG_STD: Final = 0.02  # future against recent load, natural logarithm
NEXT_FLUID_LOG_STD: Final = 0.35  # ageing rate of one vehicle from fluid to fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelPrior:
    """What is believed of margin or level before its first result, one standard deviation each."""

    start: float  # of the fluid when it was first seen
    start_std: float
    rate_std_per_m: float  # a weak belief that knows no sign: it alone says whether there is a trend
    typical_rate_per_m: float  # median loss; prognoses know that fluid ages
    typical_log_std: float  # of the natural logarithm of the loss
    fall: float  # over a whole life
    usual_wear: float  # after a usual life, what random wear is a share of
    temperature_std_per_k: float
    floor_std: float  # of a mean of any number of results: what does not average out


MARGIN_OF_NEW: Final = ChannelPrior(
    start=1.0,
    start_std=0.10,
    rate_std_per_m=2.5e-8,
    typical_rate_per_m=1.05e-8,  # 95,000 km for the whole margin
    typical_log_std=0.4,
    fall=1.0,
    usual_wear=1.0,
    temperature_std_per_k=2.0e-3,
    floor_std=0.01,
)
LEVEL_OF_NEW: Final = ChannelPrior(
    start=1.0,
    start_std=0.03,
    rate_std_per_m=2.0e-9,
    typical_rate_per_m=1.0e-9,  # 10 % in 100,000 km
    typical_log_std=0.8,
    fall=0.2,
    usual_wear=0.1,
    temperature_std_per_k=5.0e-4,  # the same as in the calibration
    floor_std=0.003,
)
UNKNOWN_MARGIN: Final = (0.6, 0.5)  # start and deviation of a fluid of unknown age
UNKNOWN_LEVEL: Final = (0.95, 0.06)
START_SCATTER: Final = {"margin": 0.08, "level": 0.015}  # of one lining with one fluid and the next, both new
