"""From the signals of a shift to what its balance needs: sensor zeros, drives of the films, the slip window."""

import math
from dataclasses import replace

import numpy as np

from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches
from diag_service.diagnosis.alignment import NS_TO_S, AlignedSignals
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.film_track import PressureDrive
from diag_service.diagnosis.friction.filter_state import FilterState, Measurement
from diag_service.diagnosis.friction.parameters import Considered, State
from diag_service.diagnosis.friction.window import SLIP_DEGREE, SlipWindow, find_window, smoothed

EMPTY_PA = 0.30e5  # an idle clutch reads less than this: it is empty, and the reading is the sensor's zero
EMPTY_S = 0.1
PRESSURE_DEGREE = 3


def zeros_seen(signals: AlignedSignals, state: FilterState, calibration: Calibration) -> list[Measurement]:
    """Return what a clutch that is empty before the shift says about the zero of its pressure sensor."""
    std_pa = calibration.noise.pressure_pa
    seen = []
    for m, pressure in enumerate(signals.pressure):
        early = pressure.value[pressure.times_s < signals.grid_s[0] + EMPTY_S]
        if len(early) < 3 or np.max(early) > EMPTY_PA:
            continue
        row = np.zeros((1, len(State)))
        row[0, State.ZERO1 + m] = 1.0
        seen.append(
            Measurement(
                residual=np.array([np.mean(early) - state.mean[State.ZERO1 + m]]),
                by_state=row,
                by_considered=np.zeros((1, len(Considered))),
                noise=np.array([[std_pa**2 / len(early)]]),
            )
        )
    return seen


def zeroed(signals: AlignedSignals, state: FilterState, calibration: Calibration) -> FilterState:
    """Return the state with the pressure sensors' zeros measured on the clutch that is empty before the shift."""
    for seen in zeros_seen(signals, state, calibration):
        state, _ = state.updated(seen)
    return state


def measured_drives(
    signals: AlignedSignals, state: FilterState, event: Event, calibration: Calibration
) -> tuple[PressureDrive, PressureDrive]:
    """Return what drives the films as measured, freed of the offsets that are believed."""
    return both_clutches(
        PressureDrive(
            piston_pa=signals.pressure[m].on_grid - state.mean[State.TOUCH1 + m] - state.mean[State.ZERO1 + m],
            slip_rad_s=signals.slip_rad_s(m + 1),
            oil_k=signals.oil_k,
            clutch_k=_clutch_k(m, signals.oil_k, state, event.start_ns + signals.grid_s[0] / NS_TO_S, calibration),
        )
        for m in range(2)
    )


def _clutch_k(m: int, oil_k: float, state: FilterState, now_ns: float, calibration: Calibration) -> float:
    """Return the temperature of a pack: what it had, cooled towards the oil since."""
    if state.clutch_temperature_k is None or now_ns < state.temperature_ns:
        return oil_k
    thermal = calibration.clutches[m].thermal
    elapsed_s = (now_ns - state.temperature_ns) * NS_TO_S
    kept = math.exp(-elapsed_s * thermal.convection_w_k / thermal.heat_capacity_j_k)
    return oil_k + (state.clutch_temperature_k[m] - oil_k) * kept


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
    signals: AlignedSignals, drives: tuple[PressureDrive, PressureDrive], clutch: int, calibration: Calibration
) -> SlipWindow | None:
    """Return the slip window of the on-coming clutch, or None."""
    over_pa = [drive.piston_pa - one.touch_pressure_pa for drive, one in zip(drives, calibration.clutches, strict=True)]
    on, off = clutch - 1, 2 - clutch
    return find_window(signals.grid_s, drives[on].slip_rad_s, over_pa[on], over_pa[off])
