"""What the paper's method needs to know: evenly sampled signals and the sides of the clutches they act on."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSignals:
    """Signals of a drive or of a shift at even intervals; both clutches in one array, clutch 1 first."""

    period_s: float
    hub_rad_s: FloatArray  # (n,) w_H
    input_rad_s: FloatArray  # (2, n) w_L
    pressure_pa: FloatArray  # (2, n) P_K
    flywheel_nm: FloatArray  # (n,) T_FW
    shaft_nm: FloatArray  # (2, n) T_si
    oil_k: FloatArray  # (n,) sump
    is_shifting: BoolArray  # (n,) a shift is under way and its clutch has not stuck yet
