"""The paper's method over the shifts of a bus: each by itself, and the samples of all of them together."""

from dataclasses import dataclass, replace

from clutch_model.calibration import Calibration, both_clutches, clutch_of_gear
from clutch_model.pack import film_law
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.paper.differentiate import quiet_filter, steady_kalman
from diag_service.diagnosis.friction.paper.driveline import Driveline
from diag_service.diagnosis.friction.paper.fit import NOISY_GATES, PaperEstimate, fit
from diag_service.diagnosis.friction.paper.friction_data import FrictionData, pooled, static_table
from diag_service.diagnosis.friction.paper.method import Differentiators, analyse
from diag_service.diagnosis.friction.paper.vehicle_route import PERIOD_S, paper_signals
from diag_service.diagnosis.records import Reason

# q of the speed filter: matched with the hub acceleration of emulated shifts at 2 rpm of noise, as the paper does.
SPEED_RATE_VARIANCE = 2.0e6  # (rad/s^3)^2
RATE_GATE_STD = 4.0  # the gate of the pressure rate, in standard deviations of the rate's noise


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperShift:
    """What one shift says by the paper's method about the clutch that engaged."""

    number: int
    from_gear: int
    to_gear: int
    clutch: int
    reason: Reason | None  # why it says nothing; None: it was analysed
    estimate: PaperEstimate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledClutch:
    """What all shifts together say about one clutch; the method states no uncertainty and leads to no verdict."""

    clutch: int
    estimate: PaperEstimate | None  # None before the first usable shift
    shift_count: int


class PaperCollection:
    """Analyses shifts one by one and keeps their samples, some tens per shift."""

    def __init__(self, calibration: Calibration, driveline: Driveline) -> None:
        noise = calibration.noise
        rate_limit_pa_s = NOISY_GATES.pressure_rate_min_pa_s or 0.0
        self._calibration = calibration
        self._driveline = driveline
        self._differentiators = Differentiators(
            speed=steady_kalman(PERIOD_S, SPEED_RATE_VARIANCE, noise.hub_speed_rad_s**2),
            pressure=quiet_filter(PERIOD_S, noise.pressure_pa, rate_limit_pa_s / RATE_GATE_STD),
        )
        self._tables = both_clutches(static_table(film_law(clutch)) for clutch in calibration.clutches)
        self._samples: tuple[list[FrictionData], list[FrictionData]] = ([], [])

    def add(self, event: Event) -> PaperShift:
        """Analyse a shift and add its samples of both clutches to the pool."""
        shift = PaperShift(
            number=event.number,
            from_gear=event.from_gear,
            to_gear=event.to_gear,
            clutch=clutch_of_gear(event.to_gear),
            reason=None,
            estimate=None,
        )
        if clutch_of_gear(event.from_gear) == shift.clutch:
            return replace(shift, reason=Reason.NO_SLIP_WINDOW)
        signals = paper_signals(event, self._calibration, self._driveline)
        if isinstance(signals, Reason):
            return replace(shift, reason=signals)
        analysis = analyse(signals, self._differentiators, self._tables, self._calibration, self._driveline)
        for kept, clutch in zip(self._samples, analysis.clutches, strict=True):
            kept.append(clutch.data)
        return replace(shift, estimate=self._fitted(shift.clutch, analysis.clutches[shift.clutch - 1].data))

    def pooled(self) -> tuple[PooledClutch, PooledClutch]:
        """Return what the shifts so far say together."""
        return both_clutches(
            PooledClutch(
                clutch=clutch,
                estimate=self._fitted(clutch, pooled(samples)) if samples else None,
                shift_count=len(samples),
            )
            for clutch, samples in enumerate(self._samples, start=1)
        )

    def _fitted(self, clutch: int, data: FrictionData) -> PaperEstimate:
        return fit(data, NOISY_GATES, self._calibration.clutches[clutch - 1].friction)
