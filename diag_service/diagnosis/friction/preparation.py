"""From the signals of a shift to what its balance needs: sensor zeros, drives of the films, the slip window."""

from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches
from clutch_model.thermal import clutch_later_k
from diag_service.diagnosis.alignment import NS_TO_S, TURNING_RAD_S, AlignedSignals
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.evidence import Evidence
from diag_service.diagnosis.friction.film_track import PressureDrive
from diag_service.diagnosis.friction.parameters import State, open_drag_ratio
from diag_service.diagnosis.friction.window import SLIP_DEGREE, SlipWindow, find_window, loaded_clutch, smoothed

EMPTY_PA = 0.30e5  # an idle clutch reads less than this: it is empty, and the reading is the sensor's zero
EMPTY_S = 0.1
OVERLAP_NS = 1e9  # the cut of an event may begin in the event before; what is further back is another stretch of time
PRESSURE_DEGREE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class PackTemperatures:
    """How warm both packs were at an instant of bus time."""

    clutch_k: tuple[float, float]
    at_ns: int

    def later(self, m: int, oil_k: float, now_ns: float, calibration: Calibration) -> float:
        """Return the temperature of pack ``m`` [K], cooled towards the oil since."""
        thermal = calibration.clutches[m].thermal
        elapsed_s = max(0.0, (now_ns - self.at_ns) * NS_TO_S)
        return clutch_later_k(
            self.clutch_k[m], oil_k, 0.0, elapsed_s, thermal.heat_capacity_j_k, thermal.convection_w_k
        )


def zeros_seen(signals: AlignedSignals, calibration: Calibration) -> Evidence:
    """Return what clutches that are empty before the shift say about the zeros of their pressure sensors."""
    variance_pa2 = calibration.noise.pressure_pa**2
    rows, zeros_pa, of_mean_pa2 = [], [], []
    for m, pressure in enumerate(signals.pressure):
        early = pressure.value[: pressure.times_s.searchsorted(signals.grid_s[0] + EMPTY_S)].tolist()
        if len(early) < 3 or max(early) > EMPTY_PA:
            continue
        rows.append(State.ZERO1 + m)
        zeros_pa.append(sum(early) / len(early))
        of_mean_pa2.append(variance_pa2 / len(early))
    return Evidence.of_readings(rows, zeros_pa, of_mean_pa2)


def measured_drives(
    signals: AlignedSignals, at: FloatArray, packs: PackTemperatures | None, event: Event, calibration: Calibration
) -> tuple[PressureDrive, PressureDrive]:
    """Return what drives the films as measured, freed of the offsets in the parameters ``at``.

    ``packs`` is None where nothing is known of the packs: then they are as warm as the oil.
    """
    start_ns = event.start_ns + signals.grid_s[0] / NS_TO_S
    is_known = packs is not None and start_ns >= packs.at_ns - OVERLAP_NS
    return both_clutches(
        PressureDrive(
            piston_pa=signals.pressure[m].on_grid - at[State.TOUCH1 + m] - at[State.ZERO1 + m],
            slip_rad_s=signals.slip_rad_s(m + 1),
            oil_k=signals.oil_k,
            clutch_k=packs.later(m, signals.oil_k, start_ns, calibration) if packs and is_known else signals.oil_k,
            open_drag_ratio=open_drag_ratio(at),
        )
        for m in range(2)
    )


def planned_drives(
    signals: AlignedSignals, measured: tuple[PressureDrive, PressureDrive], window: SlipWindow
) -> tuple[PressureDrive, PressureDrive]:
    """Return what would drive the films without sensor noise: commanded pressure and smooth slip.

    Without a command on the bus the measured pressure is smoothed, which leaves a tenth of the noise.
    """
    return both_clutches(
        replace(
            drive,
            piston_pa=smoothed(drive.piston_pa, window, PRESSURE_DEGREE) if expected_pa is None else expected_pa,
            slip_rad_s=smoothed(drive.slip_rad_s, window, SLIP_DEGREE),
        )
        for drive, expected_pa in zip(measured, signals.expected_pa, strict=True)
    )


def slip_window(
    signals: AlignedSignals, drives: tuple[PressureDrive, PressureDrive], calibration: Calibration
) -> tuple[SlipWindow, int] | None:
    """Return where clutches slip under load, and the one that carries most of it; or None."""
    pairs = zip(drives, calibration.clutches, strict=True)
    over_pa = np.array([drive.piston_pa - one.touch_pressure_pa for drive, one in pairs])
    slip_rad_s = np.array([drive.slip_rad_s for drive in drives])
    is_turning = signals.engine_speed.on_grid > TURNING_RAD_S
    window = find_window(signals.grid_s, slip_rad_s, over_pa, signals.is_seen & is_turning)
    return None if window is None else (window, loaded_clutch(window, slip_rad_s, over_pa))
