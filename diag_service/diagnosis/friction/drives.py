"""What an event gives to its films and its balance: slip window and test functions, sensor zeros, drives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Final, Self

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import InputSide
from clutch_model.pack import clutch_later_k
from diag_service.diagnosis.alignment import GRID_S, NS_TO_S, TURNING_RAD_S, AlignedSignals, Resampled
from diag_service.diagnosis.friction.evidence import Evidence, State, open_drag_ratio
from diag_service.diagnosis.friction.film import PackLaws, PressureDrive

SLIP_DEGREE = 5  # a controller's slip profile over one piece: smooth start, smooth end
LOADED_PA = 0.25e5  # above its touch point by this much a clutch carries torque
RELEASED_PA = 0.10e5  # not above its touch point by more than this, twice the sensor noise, it carries none
SLIP_MIN_RAD_S = 0.8  # nearly three times the noise of the slip: slower may be locked; what is slow tells mu_S
SLIPPING_RAD_S = 5.0  # beyond it a row is one of a slip, however few there are
FADE_S = 0.02  # after a release: contact fades within a few film time constants
MIN_PIECE_S = 0.1  # ten samples; anything shorter is noise, or a shaft that still swings in its new gear
MAX_PIECE_S = 0.7  # the longest slip of a gear change, which one polynomial follows; a launch is cut into such pieces
RESTING_PA = -0.5e5  # below its touch point by this much a pack is open
MIN_REST_S = 1.0  # of the engine with both packs open: what is shorter tells the torque's zero to no better than 0.3 Nm


@dataclass(frozen=True, slots=True, kw_only=True)
class RowRange:
    """Grid rows ``first <= row < stop``."""

    first: int
    stop: int
    is_rest: bool = False  # both clutches are open: engine and hub turn by themselves


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipWindow:
    """Pieces of an event in which every clutch that carries torque slips, and of a rest before it, in order of time."""

    pieces: tuple[RowRange, ...]
    slipping: tuple[RowRange, ...]  # without the rest
    rows: slice  # from the first to the last one, with what lies between the pieces
    slip_rows: slice  # from the first to the last one in which a clutch slips under load

    @classmethod
    def of(cls, pieces: tuple[RowRange, ...]) -> "SlipWindow":
        """Return a window of some pieces, of which one at least slips."""
        slipping = tuple([piece for piece in pieces if not piece.is_rest])
        return cls(
            pieces=pieces,
            slipping=slipping,
            rows=slice(pieces[0].first, pieces[-1].stop),
            slip_rows=slice(slipping[0].first, slipping[-1].stop),
        )

    @classmethod
    def between(cls, first: int, stop: int) -> "SlipWindow":
        """Return a window of one piece."""
        return cls.of((RowRange(first=first, stop=stop),))


def find_window(
    grid_s: FloatArray, slip_rad_s: FloatArray, over_touch_pa: FloatArray, is_seen: BoolArray, row_s: float = 0.0
) -> SlipWindow | None:
    """Return the stretches in which a clutch is loaded, and each one slips one way or carries nothing; None if none.

    What slips before the event belongs to another one; but if both clutches were open then, that stretch tells what the
    torque reads where there is none.

    Parameters
    ----------
    grid_s : (n,) array
        Even grid [s] after the start of the event.
    slip_rad_s, over_touch_pa : (2, n) array
        Slip of clutch 1 and 2 [rad/s], and their piston pressures above the touch points [Pa].
    is_seen : (n,) array
        Where no frames are missing and the engine runs.
    row_s
        From row to row [s] of a table, by which pressures and speeds may be apart; else 0.
    """
    if len(grid_s) < 2:
        return None
    is_after = grid_s >= 0.0
    is_loaded = (over_touch_pa > LOADED_PA).any(axis=0)
    is_slipping = is_loaded & _slips_one_way(slip_rad_s, over_touch_pa).all(axis=0) & is_seen & is_after
    is_rest = (over_touch_pa < RESTING_PA).all(axis=0) & is_seen & ~is_after
    step_s = float(grid_s[1] - grid_s[0])
    fade, least = round((FADE_S + row_s) / step_s), round(MIN_PIECE_S / step_s)
    stretches = [(first + fade, stop) for first, stop in _stretches(is_slipping) if stop - first >= fade + least]
    pieces = [piece for first, stop in stretches for piece in _pieces(first, stop, round(MAX_PIECE_S / step_s))]
    rests = [rest for rest in _stretches(is_rest) if rest[1] - rest[0] >= round(MIN_REST_S / step_s)]
    rest = [RowRange(first=first, stop=stop, is_rest=True) for first, stop in rests[-1:]]
    return SlipWindow.of((*rest, *pieces)) if pieces else None


def _slips_one_way(slip_rad_s: FloatArray, over_touch_pa: FloatArray) -> BoolArray:
    """Return where each clutch slips the way it did when it last slipped under load, or carries nothing; (2, n)."""
    is_released = over_touch_pa < RELEASED_PA
    does_slip = ~is_released & (np.abs(slip_rad_s) > SLIP_MIN_RAD_S)
    rows = np.where(does_slip, np.arange(slip_rad_s.shape[1]), -1)
    last = np.maximum.accumulate(rows, axis=1)
    before = np.pad(last[:, :-1], ((0, 0), (1, 0)), constant_values=-1)  # the row of the last slip before each
    was_rad_s = np.where(before < 0, 0.0, np.take_along_axis(slip_rad_s, np.maximum(before, 0), axis=1))
    return is_released | (does_slip & (slip_rad_s * was_rad_s >= 0.0))


def _stretches(mask: BoolArray) -> list[list[int]]:
    """Return first row and the row after the last one of each run of true values."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    stretches: list[list[int]] = edges.reshape(-1, 2).tolist()
    return stretches


def _pieces(first: int, stop: int, longest: int) -> list[RowRange]:
    """Return a stretch in equal parts, none longer than ``longest`` rows."""
    count = -(-(stop - first) // longest)
    edges = np.linspace(first, stop, count + 1).round().astype(int).tolist()
    return [RowRange(first=begin, stop=end) for begin, end in pairwise(edges)]


def loaded_clutch(window: SlipWindow, slip_rad_s: FloatArray, over_touch_pa: FloatArray) -> int:
    """Return the clutch that carries most while it slips in a window, 1 or 2; arrays as for `find_window`."""
    carried_pa = np.where(np.abs(slip_rad_s) > SLIP_MIN_RAD_S, np.maximum(over_touch_pa, 0.0), 0.0)
    first, second = sum([carried_pa[:, piece.first : piece.stop].sum(axis=1) for piece in window.slipping])
    return 1 if first >= second else 2


Span = tuple[float, float]
"""First and last instant of a piece [s] after the start of its event."""


def spans_of(pieces: Sequence[RowRange], grid_s: FloatArray) -> tuple[Span, ...]:
    """Return when pieces begin and end."""
    return tuple([(float(grid_s[piece.first]), float(grid_s[piece.stop - 1])) for piece in pieces])


def on_other_grid(window: SlipWindow, grid_s: FloatArray, other_s: FloatArray) -> SlipWindow:
    """Return a window found on one grid on another one, as far as that reaches."""
    edges = np.searchsorted(other_s, spans_of(window.pieces, grid_s)).tolist()
    pairs = zip(window.pieces, edges, strict=True)
    return SlipWindow.of(
        tuple([
            RowRange(first=first, stop=min(last + 1, len(other_s)), is_rest=piece.is_rest)
            for piece, (first, last) in pairs
        ])
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Functions:
    """Functions of time, each on one piece of a window and zero elsewhere: as a matrix (k, len(rows)) mostly zeros."""

    rows: slice  # of the grid: from the first to the last of the window
    grid_rows: tuple[slice, ...]  # of each piece
    places: tuple[slice, ...]  # of the pieces among the rows
    bands: tuple[slice, ...]  # the functions of each piece among all of them
    blocks: tuple[FloatArray, ...]  # (functions, rows) of each piece

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Return the sums of values weighted with each function; ``values`` has shape (len(rows), ...)."""
        if len(self.blocks) == 1:
            return self.blocks[0] @ values[self.places[0]]
        return np.concatenate([block @ values[place] for block, place in zip(self.blocks, self.places, strict=True)])

    def __mul__(self, factor: FloatArray | float) -> "Functions":
        """Return each function times a number, or times one of each row, shape (len(rows),)."""
        of_rows = np.broadcast_to(factor, (self.rows.stop - self.rows.start,))
        blocks = [block * of_rows[place] for block, place in zip(self.blocks, self.places, strict=True)]
        return replace(self, blocks=tuple(blocks))

    def __add__(self, other: "Functions") -> "Functions":
        """Return the sums of two functions on the same pieces."""
        return replace(self, blocks=tuple(block + two for block, two in zip(self.blocks, other.blocks, strict=True)))

    def joined(self) -> "Functions":
        """Return the same functions on one piece, from the first to the last."""
        block = np.zeros((self.bands[-1].stop, self.rows.stop - self.rows.start))
        for band, place, part in zip(self.bands, self.places, self.blocks, strict=True):
            block[band, place] = part
        place, band = slice(0, block.shape[1]), slice(0, block.shape[0])
        return replace(self, grid_rows=(self.rows,), places=(place,), bands=(band,), blocks=(block,))

    def sums(self) -> FloatArray:
        """Return the sum of each function, shape (k,)."""
        return np.concatenate([block.sum(axis=1) for block in self.blocks])

    def fitted_on_samples(self, degree: int, signal: Resampled) -> tuple[FloatArray, ...]:
        """Return the weights of the samples of a signal in sums with polynomial fits to the functions, one a piece."""
        bases = [polynomials(block.shape[1], degree) for block in self.blocks]
        spread = signal.to_samples([np.ascontiguousarray(basis.T) for basis in bases], self.grid_rows)
        return tuple(
            (block @ basis) @ weights for block, basis, weights in zip(self.blocks, bases, spread, strict=True)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Sines that vanish at both ends of a piece and beyond, and their derivatives, times the grid step."""

    value: Functions
    rate: Functions

    rows: slice  # of the grid from the first to the last of the window

    def fitted(self, values: FloatArray, degree: int) -> FloatArray:
        """Return polynomial fits to values, shape (len(rows),), one on each piece; nothing in between."""
        fit = np.zeros_like(values)
        for place in self.value.places:
            basis = polynomials(place.stop - place.start, degree)
            fit[place] = (values[place] @ basis) @ basis.T
        return fit


def sines(window: SlipWindow, counts: Sequence[int]) -> Weights:
    """Return as many sine test functions as ``counts`` says for each piece of the window."""
    hull = window.rows
    first, ends = hull.start, list(accumulate(counts, initial=0))
    pairs = [_sines(piece.stop - piece.first, count) for piece, count in zip(window.pieces, counts, strict=True)]
    values, rates = zip(*pairs, strict=True)
    value = Functions(
        rows=hull,
        grid_rows=tuple([slice(piece.first, piece.stop) for piece in window.pieces]),
        places=tuple([slice(piece.first - first, piece.stop - first) for piece in window.pieces]),
        bands=tuple(map(slice, ends[:-1], ends[1:])),
        blocks=values,
    )
    return Weights(value=value, rate=replace(value, blocks=rates), rows=hull)


@lru_cache(maxsize=32)
def _sines(row_count: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Return sines and their derivatives on one piece as weights of its rows, each (count, row_count).

    Sums weighted with them are exact for what is linear between rows: each row's weight is the integral of the function
    times the hat that is 1 on this row and 0 on those beside it.
    """
    turn = np.arange(1, count + 1)[:, None] * (np.pi / (row_count - 1))  # of each function from row to row [rad]
    along, hat = turn * np.arange(row_count), (np.sin(0.5 * turn) / (0.5 * turn)) ** 2
    value, rate = np.sin(along) * hat * GRID_S, np.cos(along) * hat * turn
    half = GRID_S * (1.0 - np.sin(turn) / turn) / turn  # a hat at an end is half a one
    value[:, :1], value[:, -1:] = half, -half * np.cos(along[:, -1:]).round()
    rate[:, [0, -1]] *= 0.5
    return value, rate


def smoothed(values: FloatArray, window: SlipWindow, degree: int) -> FloatArray:
    """Return the values, shape (len(grid),), with a polynomial fit in place of those inside each piece of a window."""
    smooth = values.copy()
    for piece in window.pieces:
        basis = polynomials(piece.stop - piece.first, degree)
        smooth[piece.first : piece.stop] = (values[piece.first : piece.stop] @ basis) @ basis.T
    return smooth


@lru_cache(maxsize=256)
def polynomials(count: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of the polynomials on ``count`` even points, shape (count, degree + 1).

    ``(values @ basis) @ basis.T`` is the fit to values there. Fitting is symmetric: weights fitted and values as they
    are give the same sums as weights as they are and values fitted.
    """
    powers = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, count), degree)
    basis, _ = np.linalg.qr(powers)
    return basis


EMPTY_PA = 0.30e5  # an idle clutch reads less than this: it is empty, and the reading is the sensor's zero
EMPTY_S = 0.1  # of the cut, from its beginning: ten samples, whose mean is the zero
OVERLAP_NS = 1e9  # the cut of an event may begin in the event before; what is further back is another stretch of time
PRESSURE_DEGREE = 3  # of the polynomial through the pressures of one piece: it leaves a tenth of their noise
FILLING_PA: Final = 0.3e5  # so far a pressure is from its command only while oil flows: no sensor's noise reaches it


@dataclass(frozen=True, slots=True, kw_only=True)
class PackTemperatures:
    """How warm both packs were at an instant of bus time."""

    clutch_k: tuple[float, float]
    at_ns: int

    def later(self, oil_k: float, now_ns: float, laws: PackLaws) -> tuple[float, float]:
        """Return the temperatures of both packs [K], cooled towards the oil since."""
        elapsed_s = max(0.0, (now_ns - self.at_ns) * NS_TO_S)
        first_k, second_k = [
            clutch_later_k(then_k, oil_k, 0.0, elapsed_s, law.heat_capacity_j_k, law.convection_w_k)
            for then_k, law in zip(self.clutch_k, laws, strict=True)
        ]
        return first_k, second_k


def zeros_measured(signals: AlignedSignals, noise_pa: float) -> Evidence:
    """Return what clutches that are empty before the shift say about the zeros of their pressure sensors."""
    variance_pa2 = noise_pa**2
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
    signals: AlignedSignals, at: FloatArray, packs: PackTemperatures | None, start_ns: float, laws: PackLaws
) -> tuple[PressureDrive, PressureDrive]:
    """Return what drives the films as measured, freed of the offsets in the parameters ``at``.

    The signals' clock starts at ``start_ns``. Packs of which nothing is known (None) are as warm as oil. A piston on
    its way back rests on its springs: where the command let go, noise near the touch point does not press it again.
    """
    first_ns, clutch_k = start_ns + signals.grid_s[0] / NS_TO_S, (signals.oil_k, signals.oil_k)
    if packs is not None and first_ns >= packs.at_ns - OVERLAP_NS:
        clutch_k = packs.later(signals.oil_k, first_ns, laws)
    drives, drag_ratio = [], open_drag_ratio(at)
    for m, (expected_pa, law) in enumerate(zip(signals.expected_pa, laws, strict=True)):
        piston_pa = signals.pressure[m].on_grid - at[State.TOUCH1 + m] - at[State.ZERO1 + m]
        if expected_pa is not None:
            open_pa = law.touch_pressure_pa - RELEASED_PA  # clearly: at the touch point itself rounding would decide
            is_returning = (expected_pa - at[State.TOUCH1 + m] < open_pa) & (piston_pa < open_pa + 2.0 * RELEASED_PA)
            piston_pa = np.where(is_returning, np.minimum(piston_pa, open_pa), piston_pa)
        drives.append(
            PressureDrive(
                piston_pa=piston_pa,
                slip_rad_s=signals.slip_rad_s[m],
                oil_k=signals.oil_k,
                clutch_k=clutch_k[m],
                open_drag_ratio=drag_ratio,
            )
        )
    return drives[0], drives[1]


def planned_drives(
    signals: AlignedSignals, measured: tuple[PressureDrive, PressureDrive], window: SlipWindow
) -> tuple[PressureDrive, PressureDrive]:
    """Return what would drive the films without sensor noise: commanded pressure and smooth slip.

    Without a command on the bus the measured pressure is smoothed, which leaves a tenth of the noise. A piston that is
    being filled is where the measured pressure says: no film feels the pulse that fills it.
    """
    planned = []
    for drive, expected_pa in zip(measured, signals.expected_pa, strict=True):
        if expected_pa is None:
            piston_pa = smoothed(drive.piston_pa, window, PRESSURE_DEGREE)
        else:
            piston_pa = np.where(np.abs(expected_pa - drive.piston_pa) < FILLING_PA, expected_pa, drive.piston_pa)
        slip_rad_s = smoothed(drive.slip_rad_s, window, SLIP_DEGREE)
        planned.append(replace(drive, piston_pa=piston_pa, slip_rad_s=slip_rad_s))
    return planned[0], planned[1]


def slip_window(
    signals: AlignedSignals, drives: tuple[PressureDrive, PressureDrive], laws: PackLaws
) -> tuple[SlipWindow, int] | None:
    """Return where clutches slip under load, and the one that carries most of it; or None."""
    over_pa = np.array([drive.piston_pa - law.touch_pressure_pa for drive, law in zip(drives, laws, strict=True)])
    slip_rad_s = np.array([drive.slip_rad_s for drive in drives])
    is_turning = signals.engine_speed.on_grid > TURNING_RAD_S
    sure_rad_s = _sure_slip(signals, slip_rad_s) if signals.row_s else slip_rad_s
    window = find_window(signals.grid_s, sure_rad_s, over_pa, signals.is_seen & is_turning, signals.row_s)
    return None if window is None else (window, loaded_clutch(window, slip_rad_s, over_pa))


def _sure_slip(signals: AlignedSignals, slip_rad_s: FloatArray) -> FloatArray:
    """Return slips, zero where speeds of one row may be apart by as much as they change until the next."""
    engine_rad_s = signals.engine_speed.on_grid
    both_rad_s = engine_rad_s[None]
    if signals.engine_speed.curve is not None:  # one table: columns of one row are up to a row apart, the shafts', too
        both_rad_s = np.concatenate((both_rad_s, engine_rad_s - slip_rad_s))
    changing_rad_s = np.abs(np.gradient(both_rad_s, GRID_S, axis=1)).max(axis=0) * signals.row_s
    return np.where(np.abs(slip_rad_s) > changing_rad_s + SLIP_MIN_RAD_S, slip_rad_s, 0.0)


def rows_in_slip(signals: AlignedSignals, drives: tuple[PressureDrive, PressureDrive], laws: PackLaws) -> int:
    """Return in how many rows of a table a clutch slips under load, as far as rows show it."""
    is_slipping = np.zeros(len(signals.grid_s), np.bool_)
    for drive, law in zip(drives, laws, strict=True):
        is_loaded = drive.piston_pa - law.touch_pressure_pa > LOADED_PA
        is_slipping |= is_loaded & (np.abs(drive.slip_rad_s) > SLIPPING_RAD_S) & (signals.grid_s >= 0.0)
    at = np.searchsorted(signals.grid_s, signals.pressure[0].times_s)
    return int(np.count_nonzero(is_slipping[at[(at > 0) & (at < len(is_slipping))]]))


Blocks = tuple[FloatArray, ...]  # one of each piece of a window


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """The weights of single samples in the weighted sums over the grid that no friction changes; (k, samples) each."""

    torque_value: Blocks
    engine_rate: Blocks
    hub_value: Blocks
    hub: Blocks  # by its inertia and its damping
    input_value: tuple[Blocks, Blocks]
    pressure_value: tuple[Blocks, Blocks]

    @classmethod
    def of(cls, signals: AlignedSignals, weights: Weights, side: InputSide) -> Self:
        """Return those of a window's test functions; signals of one message share theirs."""
        value, rate = weights.value, weights.rate
        sampled = (signals.engine_torque, signals.hub_speed, *signals.input_speed, *signals.pressure)
        by_instant: dict[bytes, Blocks] = {}
        instants = [signal.times_s.tobytes() for signal in sampled]
        for instant, signal in zip(instants, sampled, strict=True):
            if instant not in by_instant:
                by_instant[instant] = signal.to_samples(value.blocks, value.grid_rows)
        torque, hub, first, second, first_pressure, second_pressure = map(by_instant.__getitem__, instants)
        inertia, damping = side.hub_inertia_kg_m2, side.hub_damping_nms_rad
        hub_rate = signals.hub_speed.to_samples(rate.blocks, rate.grid_rows)
        return cls(
            torque_value=torque,
            engine_rate=signals.engine_speed.to_samples(rate.blocks, rate.grid_rows),
            hub_value=hub,
            hub=tuple(
                [inertia * by_rate - damping * by_value for by_rate, by_value in zip(hub_rate, hub, strict=True)]
            ),
            input_value=(first, second),
            pressure_value=(first_pressure, second_pressure),
        )
