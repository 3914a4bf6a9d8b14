"""Stretches of a drive with about a minute of slip of the lock-up clutch: where they lie, and what each says."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import EndReason, EventKind, Shudder
from clutch_results.records import EventFit, Reason, ShiftEstimate, Status
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.estimator import without_friction
from diag_service.diagnosis.lockup.state import (
    LEAST_PRESSURE_PA,
    LEAST_SLIP_RAD_S,
    MISFIT_RATIO,
    MOST_SLIP_RAD_S,
    MOST_SLIP_RATE_RAD_S2,
    LockupSamples,
    LockupState,
    cut,
    is_slipping,
    samples_of,
)
from diag_service.diagnosis.shifts.tracking import Bounds, EventFinder, SampleHistory, held_values

LINE_HZ: Final = 2.0  # to either side of a line: what a window of this length makes of it
LEAST_SHARE: Final = 0.6  # of what swings in the band
LEAST_SWING_RATIO: Final = 0.25  # amplitude of the line over mean slip
LEAST_SWING_RAD_S: Final = 0.8
ORDERS: Final = (0.5, 1.0)  # of the engine, that fall into the band
ORDER_HZ: Final = 1.0
ENGINE_SHARE: Final = 0.6  # engine's swing over the turbine's: it has several times the inertia, so it swings less


@dataclass(frozen=True, slots=True, kw_only=True)
class SwingBand:
    """Where swings of slip are looked for, and in windows of how many steps."""

    step_s: float = 0.01
    slowest_s: float = 0.02  # from sample to sample: half of its rate is above the band
    window: int = 128
    band_hz: tuple[float, float] = (5.0, 20.0)
    line_hz: float = LINE_HZ


def shudder(samples: LockupSamples, calibration: Calibration) -> Shudder | None:
    """Return what swings in a stretch; None where signals are too slow, or the clutch never slips for long enough."""
    carries_pa = calibration.clutches[0].touch_pressure_pa + LEAST_PRESSURE_PA
    noise = calibration.noise.engine_speed_rad_s**2 + calibration.noise.input_speed_rad_s**2
    return swings(samples, SwingBand(), carries_pa, noise)


def swings(samples: LockupSamples, band: SwingBand, carries_pa: float, noise_rad2_s2: float = 0.0) -> Shudder | None:
    """Return what swings within a band while a clutch has more than some pressure, by sensors with some variance."""
    at_s, window = (samples.t_ns - samples.t_ns[0]) / NS_PER_S, band.window
    if float(np.median(np.diff(at_s))) > band.slowest_s:
        return None
    grid_s = np.arange(0.0, at_s[-1], band.step_s)
    slip = np.interp(grid_s, at_s, samples.slip_rad_s)
    engine = np.interp(grid_s, at_s, samples.engine_rad_s)
    pressure_pa = np.interp(grid_s, at_s, samples.pressure_pa)
    starts = np.arange(0, len(grid_s) - window + 1, window // 2)
    if not len(starts):
        return None
    rows = starts[:, None] + np.arange(window)
    slips, mean = slip[rows], slip[rows].mean(axis=1)
    trend = np.linspace(-0.5, 0.5, window)
    rise = slips @ trend / (trend @ trend)
    held = (
        (pressure_pa[rows].min(axis=1) > carries_pa)
        & (mean > LEAST_SLIP_RAD_S)
        & (mean < MOST_SLIP_RAD_S)
        & (np.abs(rise) < MOST_SLIP_RATE_RAD_S2 * window * band.step_s)
    )
    if not held.any():
        return None
    mean, engine = mean[held], engine[rows][held]
    turning_hz = engine.mean(axis=1) / (2.0 * np.pi)
    frequency_hz = np.fft.rfftfreq(window, band.step_s)
    power = _power(slips[held])
    in_band = (frequency_hz >= band.band_hz[0]) & (frequency_hz <= band.band_hz[1])
    floor = 2.0 * noise_rad2_s2 / window
    swing = np.maximum(power - floor, 0.0) * in_band
    line_hz = frequency_hz[swing.argmax(axis=1)]
    on_line = np.abs(frequency_hz - line_hz[:, None]) <= band.line_hz
    line = (swing * on_line).sum(axis=1)
    total = swing.sum(axis=1)
    amplitude = np.sqrt(2.0 * line)
    orders_hz = np.outer(ORDERS, turning_hz)
    orders_hz = np.abs(orders_hz - np.rint(orders_hz * band.step_s) / band.step_s)  # as rows show what is too fast
    by_engine = np.abs(line_hz - orders_hz).min(axis=0) < ORDER_HZ
    by_engine &= (_power(engine) * on_line).sum(axis=1) > ENGINE_SHARE**2 * (
        _power(engine - slips[held]) * on_line
    ).sum(axis=1)
    is_swinging = (
        (line > LEAST_SHARE * total)
        & (amplitude > np.maximum(LEAST_SWING_RATIO * mean, LEAST_SWING_RAD_S))
        & ~by_engine
    )
    return Shudder(
        window_count=len(mean),
        seen_count=int(np.count_nonzero(is_swinging)),
        frequency_hz=float(np.median(line_hz[is_swinging])) if is_swinging.any() else None,
        amplitude_rad_s=float(np.sqrt(total.mean())),
    )


def _power(rows: FloatArray) -> FloatArray:
    """Return by frequency how rows vary about a parabola, so that the sum of a row is that variance."""
    window = rows.shape[1]
    taper = np.hanning(window)
    slow, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, window), 3))
    rest = rows - rows @ slow @ slow.T
    power: FloatArray = 2.0 * np.abs(np.fft.rfft(rest * taper)) ** 2 / (window * (taper @ taper))
    return power


ENOUGH_SLIP_S: Final = 60.0
LEAST_SLIP_S: Final = 5.0  # of a stretch that is worth a result
LONGEST_S: Final = 300.0  # of a stretch, and of what is kept in memory
CHANGED_COUNT: Final = 3  # stretches in a row that contradict: the clutch or its fluid is another


class StretchFinder:
    """Finds stretches in whole seconds of bus time, each by its own samples alone, however the stream is cut."""

    def __init__(self, calibration: Calibration) -> None:
        self._touch_pa = calibration.clutches[0].touch_pressure_pa
        self._forget()

    def _forget(self) -> None:
        self.open_ns: int | None = None
        self._next_ns = 0
        self._slip_s = 0.0

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        if self.open_ns is None:
            ahead = history.ahead(Signal.ENGINE_SPEED, until_ns).t_ns
            if not len(ahead):
                return []
            self.open_ns = int(ahead[0])
            self._next_ns = (self.open_ns // NS_PER_S + 1) * NS_PER_S
        ended: list[Bounds] = []
        while self._next_ns < until_ns:
            self._slip_s += self._slipped_s(history, self._next_ns - NS_PER_S, self._next_ns)
            lasts_s = (self._next_ns - self.open_ns) / NS_PER_S
            if self._slip_s >= ENOUGH_SLIP_S or lasts_s >= LONGEST_S:
                ended += self._ended(history, self._next_ns)
                self.open_ns, self._slip_s = self._next_ns, 0.0
            self._next_ns += NS_PER_S
        return ended

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        """End the stretch, whose slip counts however long it lasted, and forget everything."""
        ended = [] if self.open_ns is None else self._ended(history, now_ns)
        self._forget()
        return ended

    def _ended(self, history: SampleHistory, end_ns: int) -> list[Bounds]:
        if self._slip_s < LEAST_SLIP_S or self.open_ns is None:
            return []
        gears = history.samples(Signal.CURRENT_GEAR, self.open_ns, end_ns).value
        gear = max(int(gears[-1]), 0) if len(gears) else 0
        return [Bounds(gear, gear, self.open_ns, end_ns, EndReason.COMPLETE, EventKind.MICRO_SLIP)]

    def _slipped_s(self, history: SampleHistory, start_ns: int, stop_ns: int) -> float:
        """Return for how much of a second the clutch slipped while it carried."""
        engine, turbine, pressure = (
            history.samples(signal, start_ns, stop_ns)
            for signal in (Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_PRESSURE)
        )
        if not (len(engine.t_ns) and len(turbine.t_ns) and len(pressure.t_ns)):
            return 0.0
        slip = engine.value - held_values(turbine, engine.t_ns, float(turbine.value[0]))
        pressed_pa = held_values(pressure, engine.t_ns, float(pressure.value[0])) - self._touch_pa
        return float(np.mean(is_slipping(pressed_pa, slip))) * (stop_ns - start_ns) / NS_PER_S


class SlipFinder(EventFinder):
    """Finds the stretches of a drive in which the lock-up clutch slips."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(StretchFinder(calibration), 0, 0)

    @property
    def is_expecting(self) -> bool:
        """Whether a result is about to come: a stretch is always open, and nobody waits for its end."""
        return self.due_ns is not None


class LockupEstimator:
    """Estimates friction of a lock-up clutch from stretches of slip; holds nothing but the calibration."""

    def __init__(self, calibration: Calibration) -> None:
        if calibration.converter is None:
            raise ValueError("the calibration has no converter")
        self._calibration = calibration
        self._converter = calibration.converter

    def estimate(
        self, event: Event, state: LockupState, against: tuple[Reason, ...] = ()
    ) -> tuple[LockupState, ShiftEstimate, Shudder | None]:
        """Return what is known after a stretch, what it says alone, and whether its slip swung by itself.

        Alone it uses what is known of everything but friction. A stretch of which nothing can be believed is rejected;
        one that contradicts the others is kept apart until a third in a row says that the clutch has changed.
        """
        samples = samples_of(event.columns)
        if samples is None:
            return state, self._named(without_friction(event, Status.UNOBSERVED, Reason.SIGNAL_MISSING)), None
        if against:
            return state, self._named(without_friction(event, Status.REJECTED, *against)), None
        swings = shudder(samples, self._calibration)
        blocks = cut(samples, self._calibration, self._converter)
        estimate = self._named(without_friction(event, Status.UNOBSERVED, Reason.NO_SLIP_WINDOW))
        if blocks.slip_s < LEAST_SLIP_S:
            return state, estimate, swings
        alone = state.with_unknown_friction().fused(blocks)
        if (misfit := alone.misfit(blocks)) > MISFIT_RATIO:
            return state, replace(estimate, status=Status.REJECTED, reasons=(Reason.MISFIT,)), swings
        alone = replace(alone, slip_s=blocks.slip_s)
        reasons: tuple[Reason, ...] = ()
        if state.shift_count and state.contradicts(alone):
            state = replace(state, contradiction_count=state.contradiction_count + 1)
            reasons = (Reason.NOT_UPDATED,)
            if state.contradiction_count == CHANGED_COUNT:
                state, reasons = state.with_new_fluid(), ()
        if not reasons:
            used, slip_s = state.fused(blocks).with_lags(blocks), state.slip_s + blocks.slip_s
            used = replace(used, shift_count=state.shift_count + 1, slip_s=slip_s, contradiction_count=0)
            state = used.aged().with_baseline(event.end_ns)
        estimate = replace(
            estimate,
            status=Status.VALID,
            reasons=reasons,
            friction=alone.friction(),
            scale_free=alone.scale_free(),
            fit=EventFit(
                sample_count=len(blocks.place),
                window_s=blocks.slip_s,
                chi_square_ratio=misfit,
                quality=min(1.0, blocks.slip_s / ENOUGH_SLIP_S) / (1.0 + event.bad_frame_count / len(samples.t_ns)),
            ),
            conditions=replace(estimate.conditions, slip_energy_j=blocks.energy_j),
            micro_slip=alone.micro_slip(swings),
        )
        return state, estimate, swings

    def _named(self, estimate: ShiftEstimate) -> ShiftEstimate:
        return replace(estimate, clutch=1, element=self._calibration.elements[0])
