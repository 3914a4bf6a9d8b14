"""The samples that speak of friction: a clutch slips in contact, and eq. (7) alone moves its film."""

from dataclasses import dataclass, replace

import numpy as np

from studies.full_estimator.inversion import contact_track_pa, film_track_m, piston_track_pa
from studies.full_estimator.signals import BoolArray, FullSignals
from studies.full_estimator.torques import ClutchState
from studies.reproduce.differences import central_difference
from canlog.arrays import FloatArray
from clutch_model.calibration import ClutchCalibration
from clutch_model.pack import FilmLaw, FrictionLaw, film_law, friction_law, piston_pressures_pa

SLIP_MIN_RAD_S = 0.3  # three times the slip at which a clutch locks: what is slower may be locked
TORQUE_MIN_NM = 1.0  # below, a sample says nothing
CONTACT_MIN_PA = 300.0  # likewise
LET_GO_PA = 3.0e3  # an applied pressure below this lets the pack open, and eq. (7) does not say how
WINDOW_MIN_COUNT = 20
TRIM_COUNT = 1  # at either end: the twist's spline rounds the kinks of locking and breaking loose


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Samples in a row in which one clutch slips one way; all arrays (n,)."""

    first: int  # row of the drive
    period_s: float
    torque_nm: FloatArray  # positive against the slip
    speed_rad_s: FloatArray  # size of the slip
    slip_std_rad_s: float  # of the slip where it is least
    viscosity: FloatArray
    reading_pa: FloatArray
    reading_std_pa: float

    def film_m(
        self, friction: FrictionLaw, law: FilmLaw, offset_rad_s: float = 0.0, rate_rad_s2: float = 0.0
    ) -> FloatArray:
        """Return the film that the torque implies [m], shape (n,); NaN where no contact passes it.

        Parameters
        ----------
        offset_rad_s, rate_rad_s2 : float
            Correction of the slip's size where it is least, and its growth away from there.
        """
        away_s = self.period_s * np.abs(np.arange(len(self.speed_rad_s)) - np.argmin(self.speed_rad_s))
        speed = self.speed_rad_s + offset_rad_s + rate_rad_s2 * away_s
        film_m: FloatArray = np.empty_like(speed)
        film_track_m(self.torque_nm, speed, self.viscosity, friction, law, film_m)
        return film_m

    def piston_pa(
        self, friction: FrictionLaw, law: FilmLaw, offset_rad_s: float = 0.0, rate_rad_s2: float = 0.0
    ) -> FloatArray:
        """Return the piston pressure that the torque implies [Pa], shape (n,); arguments as of `film_m`."""
        film_m = self.film_m(friction, law, offset_rad_s, rate_rad_s2)
        piston_pa = np.empty_like(film_m)
        piston_track_pa(film_m, central_difference(film_m, self.period_s).rate, self.viscosity, law, piston_pa)
        return piston_pa


def windows(
    signals: FullSignals, state: ClutchState, is_coupled: BoolArray, clutch: int, believed: ClutchCalibration
) -> list[Window]:
    """Return the windows of clutch 1 or 2 in a drive, in order, selected without a look at the pressure readings."""
    law, friction = film_law(believed), friction_law(believed.friction)
    found = []
    for direction in (1.0, -1.0):
        speed, torque_nm = direction * state.slip_rad_s, direction * state.torque_nm
        slips = is_coupled & (speed > SLIP_MIN_RAD_S) & (torque_nm > TORQUE_MIN_NM)
        for rows in stretches(slips, TRIM_COUNT):
            window = Window(
                first=rows.start,
                period_s=signals.period_s,
                torque_nm=torque_nm[rows],
                speed_rad_s=speed[rows],
                slip_std_rad_s=float(state.slip_std_rad_s[rows][np.argmin(speed[rows])]),
                viscosity=state.viscosity[rows],
                reading_pa=signals.pressure_pa[clutch - 1, rows],
                reading_std_pa=float(signals.pressure_std_pa[clutch - 1]),
            )
            found += _in_contact(window, friction, law)
    return sorted(found, key=lambda one: one.first)


def stretches(wanted: BoolArray, trim_count: int) -> list[slice]:
    """Return the runs of wanted samples, cut by ``trim_count`` at both ends, that are long enough for a window."""
    edges = np.flatnonzero(np.diff(np.concatenate(((False,), wanted, (False,))).astype(np.int8)))
    runs = (slice(int(first) + trim_count, int(stop) - trim_count) for first, stop in edges.reshape(-1, 2))
    return [run for run in runs if run.stop - run.start >= WINDOW_MIN_COUNT]


def _in_contact(window: Window, friction: FrictionLaw, law: FilmLaw) -> list[Window]:
    """Return the parts of a window in which the linings touch and are pressed."""
    film_m = window.film_m(friction, law)
    contact_pa = np.empty_like(film_m)
    contact_track_pa(film_m, law, contact_pa)
    let_go_pa = piston_pressures_pa(LET_GO_PA, law)
    touching = [_part(window, rows) for rows in stretches(contact_pa > CONTACT_MIN_PA, 0)]
    return [
        _part(part, rows)
        for part in touching
        for rows in stretches(part.piston_pa(friction, law) > let_go_pa, TRIM_COUNT)
    ]


def _part(window: Window, rows: slice) -> Window:
    return replace(
        window,
        first=window.first + rows.start,
        torque_nm=window.torque_nm[rows],
        speed_rad_s=window.speed_rad_s[rows],
        viscosity=window.viscosity[rows],
        reading_pa=window.reading_pa[rows],
    )
