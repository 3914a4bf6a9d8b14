"""How far one event may be from the vehicle, above all in cold oil, where the film, not the lining, carries the torque.

Viscosity, film and drag are believed as at work; the colder a pack, the farther off they may be, each event in its own
way: how oil and air fill a closing pack, how a filled one opens, how warm its oil is between the linings. Friction
differs a little from event to event at any temperature.
"""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.balance import Balance
from diag_service.diagnosis.friction.parameters import (
    FRICTION_COUNT,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    State,
    friction_rows,
)
from diag_service.diagnosis.quality.averages import mean

WORKING_K: Final = 353.15  # of a pack: from there on the film is as believed
COLD_SPAN_K: Final = 60.0  # below that temperature, where the deviations are as large as these:
TOUCH_PRESSURE_PA: Final = 20e3
VISCOSITY_RATIO: Final = 0.2
PRESSURE_LATENCY_S: Final = 0.02  # a film that closes or opens earlier or later
CONTACT_STIFFNESS_RATIO: Final = 0.2
FILM_MOBILITY_LOG: Final = 1.0
OPEN_DRAG_LOG: Final = 1.0
OPEN_DRAG_SPEED_LOG: Final = 0.7  # also at work: twice or half; how drag goes with the slip is another in every pack
FRICTION_RATIO: Final = 0.01  # of mu, also at work: heat, oil and load are spread over the linings anew each time
MOST_FILM_SHARE: Final = 0.4  # of the torque in the slip window: beyond it nothing is said of friction


def _cold_variance() -> FloatArray:
    """Return how far the parameters of one event may be off in oil that is colder than at work by the whole span."""
    variance = np.zeros(PARAMETER_COUNT)
    variance[[State.TOUCH1, State.TOUCH2]] = TOUCH_PRESSURE_PA**2
    variance[STATE_COUNT + Considered.VISCOSITY] = VISCOSITY_RATIO**2
    variance[STATE_COUNT + Considered.PRESSURE_LATENCY] = PRESSURE_LATENCY_S**2
    variance[STATE_COUNT + Considered.CONTACT_STIFFNESS] = CONTACT_STIFFNESS_RATIO**2
    variance[STATE_COUNT + Considered.FILM_MOBILITY] = FILM_MOBILITY_LOG**2
    variance[STATE_COUNT + Considered.OPEN_DRAG] = OPEN_DRAG_LOG**2
    return variance


_COLD_VARIANCE: Final = _cold_variance()


def own_variance(balance: Balance, clutch: int) -> FloatArray:
    """Return how far the parameters of one event may be from those of the vehicle, shape (PARAMETER_COUNT,)."""
    pack_k = mean(balance.tracks[clutch - 1].clutch_k[balance.window.slip_rows])
    variance = _COLD_VARIANCE * max(0.0, (WORKING_K - pack_k) / COLD_SPAN_K) ** 2
    variance[STATE_COUNT + Considered.OPEN_DRAG] += OPEN_DRAG_SPEED_LOG**2
    variance[:FRICTION_COUNT] = (FRICTION_RATIO * balance.at[:FRICTION_COUNT]) ** 2
    return variance


def film_share(balance: Balance, clutch: int) -> float:
    """Return which part of a clutch's torque its sheared film carries in the slip window, 0 to 1."""
    rows, track = balance.window.slip_rows, balance.tracks[clutch - 1]
    first = balance.weights.rows.start
    by_friction_nm = balance.torques.contact_nm[clutch - 1, :, rows.start - first : rows.stop - first]
    contact = float(np.abs(balance.at[friction_rows(clutch)] @ by_friction_nm).sum())
    film = float(np.abs(track.viscous_nm[rows]).sum())
    return film / max(film + contact, 1e-9)
