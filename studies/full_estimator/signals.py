"""The full information about a drive: the paper's sensor set, the gears, and how noisy the sensors are."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class FullSignals:
    """Signals of a whole drive at even intervals; both clutches in one array, clutch 1 first."""

    period_s: float
    hub_rad_s: FloatArray  # (n,) w_H, noisy
    input_rad_s: FloatArray  # (2, n) w_L, noisy
    pressure_pa: FloatArray  # (2, n) P_K, noisy
    flywheel_nm: FloatArray  # (n,) T_FW, exact
    shaft_nm: FloatArray  # (2, n) T_si, exact
    oil_k: FloatArray  # (n,) sump
    gears: IntArray  # (2, n) gear engaged on each input shaft, 0 while none is
    speed_std_rad_s: FloatArray  # (3,) noise of hub, input 1, input 2
    pressure_std_pa: FloatArray  # (2,)
