"""Records of what is known of friction without knowing its scale: against itself, its past, the other clutch."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleFreeFriction:
    """Friction coefficients of one clutch times gain of the torque reading and piston area: what driving alone tells.

    Gain and area count as ratios to what the calibration says. Divided by both the numbers are the coefficients; the
    uncertainty of the two, the common scale, is not in ``std_*``.
    """

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    correlation: float  # of the errors of mu_c and mu_s


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftScatter:
    """How much the estimates of single shifts of one clutch scatter about the running one, outliers clipped."""

    std_mu_c: float
    std_mu_s: float
    shift_count: int  # shifts in it


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionTrend:
    """Change of the running friction of one clutch since its baseline; a wrong scale cancels in the ratios."""

    change_mu_c: float
    change_mu_s: float
    std_change_mu_c: float
    std_change_mu_s: float
    change_mu_c_ratio: float  # 0.01 is one percent more than in the baseline
    change_mu_s_ratio: float
    std_change_mu_c_ratio: float
    std_change_mu_s_ratio: float
    baseline_end_bus_ns: int  # end of the shift after which the baseline was frozen
    baseline_shift_count: int  # shifts in the baseline
    later_shift_count: int  # shifts used since


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchRatio:
    """Friction of clutch 1 over that of clutch 2; the torque gain cancels, the piston areas do not."""

    mu_c_ratio: float
    mu_s_ratio: float
    std_mu_c_ratio: float
    std_mu_s_ratio: float
