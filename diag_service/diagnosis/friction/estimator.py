"""One shift in, one friction estimate and a new running state out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, TorqueSource, clutch_of_gear
from clutch_model.errors import CalibrationError
from clutch_results.records import EventConditions, EventFit, FrictionSlope, Reason, Revision, ShiftEstimate, Status
from diag_service.diagnosis.alignment import NS_TO_S, EventSamples, aligned
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.balance import (
    LEAST_SECANT,
    WORKING_K,
    Balance,
    NoiseModel,
    measurements_of,
    noise_of,
    slower_films,
)
from diag_service.diagnosis.friction.drives import (
    PackTemperatures,
    measured_drives,
    on_other_grid,
    rows_in_slip,
    slip_window,
    spans_of,
    zeros_measured,
)
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    FRICTION_PRIOR_STD,
    FRICTION_ROWS,
    OMISSION_COST,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    Fusion,
    JudgedEvent,
    Knowledge,
    Measurement,
    State,
    fuse,
    skew_variance,
)
from diag_service.diagnosis.friction.film import VehicleLaws
from diag_service.diagnosis.friction.posterior import Posterior, both_frictions
from diag_service.diagnosis.quality import SlippingClutch, plausibility_faults

OPEN_DRAG_SPEED_LOG: Final = 0.7  # natural logarithm, at any temperature: packs drag twice or half as much
FRICTION_RATIO: Final = 0.01  # of mu, at any temperature: each event spreads heat, oil and load otherwise
COLD_LEAST_SCATTER: Final = 0.7  # ratio to the stated variance of events: cold ones err alike in part
MOST_FILM_SHARE: Final = 0.5  # of the torque in a piece of the slip window: beyond it friction is not told there


def event_variance(balance: Balance, noise: NoiseModel) -> FloatArray:
    """Return the variance of an event's own parameters about those of the vehicle, shape (PARAMETER_COUNT,)."""
    variance = np.zeros(PARAMETER_COUNT)
    variance[STATE_COUNT + Considered.OPEN_DRAG] = OPEN_DRAG_SPEED_LOG**2
    variance[[STATE_COUNT + Considered.TORQUE_GAIN, STATE_COUNT + Considered.ENGINE_INERTIA]] = noise.scale_ratio**2
    variance[:FRICTION_COUNT] = (FRICTION_RATIO * balance.at[:FRICTION_COUNT]) ** 2
    return variance


def telling_part(balance: Balance, clutch: int) -> Balance | None:
    """Return the balance on those pieces in which the film carries little enough to tell friction; None: there is none.

    Of a launch in the cold these are the ones after its film has closed. There the film is one that yields as slowly as
    it may: where that would not close, a belief that it does is no evidence.
    """
    rows = balance.weights.rows
    is_cold = balance.film_steps[clutch - 1] >= LEAST_SECANT
    track = (slower_films(balance, balance.measured) if is_cold else balance.tracks)[clutch - 1]
    by_friction_m3 = np.abs(balance.at[FRICTION_ROWS[clutch - 1]] @ balance.torques.lever_m3[clutch - 1])
    film_nm = np.abs(track.viscous_nm[rows])
    excess_nm = film_nm - MOST_FILM_SHARE * (film_nm + by_friction_m3 * track.contact_pa[rows])
    spans = [(piece, slice(piece.first - rows.start, piece.stop - rows.start)) for piece in balance.window.pieces]
    telling = tuple([piece for piece, span in spans if piece.is_rest or excess_nm[span].sum() <= 0.0])
    if len(telling) == len(spans):
        return balance
    if all(piece.is_rest for piece in telling):
        return None
    return balance.within(telling)


ALGORITHM_VERSION = "torque-impulse-23"
MAX_PASS_COUNT = 4  # linearisations: the first events of a vehicle move latencies beyond the reach of one
CONVERGED = 0.2  # of a standard deviation
NEAR_STEP = 0.5  # standard deviations of the type: a shorter step keeps the Jacobian
LONGEST_STEP = 2.0  # standard deviations of the type: beyond it the balance is not linear
MAX_MISFIT = 4.0  # chi-square per degree of freedom; a clean shift stays below 2.5
MAX_EXCESS = 48.0  # of chi-square over its expectation: an error adds as much to few numbers as to many
SURE_STD, LEAST_FRICTION = 3.0, 0.07  # no wet lining has less than 0.07; an estimate must be 3 deviations below it
SCORE_GATE = 5.5  # displacement of a parameter over its deviation: in sound drives one event in 340 reaches 4.7
LEAST_LEARNT = 0.03  # of the prior deviation: an event that narrows a parameter less cannot contradict it
FULL_WINDOW_S = 0.25  # the shortest slip window that every regular shift offers
ZERO_GATE = 25.0  # squared distance of a measured zero from the known one, in variances: 6e-7 by chance
LEAST_LOSS = 1e-6  # of the variance of a zero: far above what doubles lose, far below what a measurement tells
_ZEROS = slice(State.ZERO1, State.ZERO2 + 1)
_UNKNOWN_FRICTION = np.eye(2) * FRICTION_PRIOR_STD**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearisation:
    """The evidence of an event, linearised about one point of all parameters."""

    clutch: int  # 1 or 2: the one that carries most while it slips
    balance: Balance
    noise: NoiseModel
    measurements: tuple[Measurement, ...]
    zeros: Evidence  # of empty clutches, on the zeros of their pressure sensors
    evidence: Evidence  # of all of it


class NotLinearised(NamedTuple):
    """Why an event cannot be linearised."""

    reason: Reason
    row_count: int = 0  # of a table, in the slip, where these are too few


def linearise(  # noqa: PLR0911 - each stage may find that it ends there
    samples: EventSamples,
    laws: VehicleLaws,
    packs: PackTemperatures | None,
    at: FloatArray,
    earlier: Linearisation | None = None,
    *,
    keeps_jacobian: bool = False,
) -> Linearisation | NotLinearised:
    """Return an event linearised about ``at``, shape (PARAMETER_COUNT,), or why it cannot be.

    Parameters
    ----------
    laws
        Of the vehicle, without what the parameters say.
    packs
        How warm the clutches were before it.
    earlier, keeps_jacobian
        The same event about another point, whose clutch stays; with ``keeps_jacobian`` also its window and Jacobian.
    """
    try:
        laws = laws.displaced(at)
    except CalibrationError:  # no vehicle is like that
        return NotLinearised(Reason.MISFIT)
    signals = aligned(samples, laws, earlier.balance.signals if earlier else None)
    if isinstance(signals, Reason):
        return NotLinearised(signals)
    near, noise = earlier if keeps_jacobian else None, noise_of(signals)
    drives = measured_drives(signals, at, packs, samples.event.start_ns, laws.packs)
    if near is None:
        window_and_clutch = slip_window(signals, drives, laws.packs)
    else:
        window_and_clutch = on_other_grid(near.balance.window, near.balance.signals.grid_s, signals.grid_s), near.clutch
    if window_and_clutch is None:
        row_count = rows_in_slip(signals, drives, laws.packs)
        is_too_few = 0 < row_count < noise.least_count
        return NotLinearised(Reason.FEW_SAMPLES, row_count) if is_too_few else NotLinearised(Reason.NO_SLIP_WINDOW)
    window, clutch = window_and_clutch
    whole = Balance(signals, window, drives, laws, at)
    if (balance := telling_part(whole, clutch) if near is None else whole) is None:
        return NotLinearised(Reason.NO_SLIP_WINDOW)
    if balance.sample_count < noise.least_count:
        return NotLinearised(Reason.FEW_SAMPLES, balance.sample_count)
    measurements = measurements_of(balance, noise, near.measurements if near else ())
    zeros = zeros_measured(signals, laws.noise.pressure_pa)
    evidence = Evidence.of(measurements, at, zeros, event_variance(balance, noise))
    if not np.isfinite(evidence.constant):  # by laws that no lining or oil has
        return NotLinearised(Reason.MISFIT)
    return Linearisation(
        clutch=earlier.clutch if earlier else clutch,
        balance=balance,
        noise=noise,
        measurements=measurements,
        zeros=zeros,
        evidence=evidence,
    )


def iterate(
    first: Linearisation,
    linearised: Callable[[FloatArray, Linearisation, bool], Linearisation | NotLinearised],
    posterior: Callable[[Linearisation], Knowledge | None],
    type_std: FloatArray,
) -> Linearisation | None:
    """Return an event linearised at its ``posterior``; None where that says nothing of friction.

    Gauss-Newton: it stops when a step is below ``CONVERGED`` of what is then known, after ``MAX_PASS_COUNT``
    linearisations, or where there is none. Steps are cut to ``LONGEST_STEP`` of ``type_std``, friction aside.
    """
    last = first
    for _ in range(MAX_PASS_COUNT - 1):
        at, after = last.balance.at, posterior(last)
        if after is None:
            return None
        step = after.mean - at
        if (np.abs(step) / np.maximum(after.std(), 1e-30)).max() < CONVERGED:
            break
        longest = float((np.abs(step) / type_std).max())
        following = linearised(at + step / max(1.0, longest / LONGEST_STEP), last, longest < NEAR_STEP)
        if isinstance(following, NotLinearised):
            if following.reason is Reason.NO_SLIP_WINDOW:
                return None
            break
        last = following
    return last


class AtPosterior(NamedTuple):
    """An event linearised at the posterior, and what is believed without it and with it."""

    linearisation: Linearisation
    earlier: Posterior
    judged: Posterior
    is_agreed: bool  # of all other events the same is believed


class Estimator:
    """Estimates friction from shifts; holds nothing but what the calibration says."""

    def __init__(self, calibration: Calibration) -> None:
        self._laws = VehicleLaws.of(calibration)
        self._type = Posterior.fresh(calibration).base

    def estimate(
        self, event: Event, samples: EventSamples | Reason, state: Posterior, against: tuple[Reason, ...] = ()
    ) -> tuple[Posterior, ShiftEstimate]:
        """Return what is known after a shift, and what the shift alone says about the on-coming clutch.

        The shift's own estimate uses what is known of everything but the friction of its clutch. A shift whose signals
        contradict each other, or that does not fit the model, is rejected; one that fits, but contradicts the others,
        is shown and left out, until three of the clutch agree that it has changed. One with anything ``against`` its
        data is described and rejected; it leaves no trace in what is known, and is not even held against the others.
        Where the first events have led to a vehicle unlike its type, they are left out, and it begins again once.
        """
        begun = state.begun_again() if state.is_unlike_type else state
        now, estimate = self._estimate(event, samples, begun, against)
        if begun is not state:
            left = [one for one, is_used in zip(state.recent, state.is_used, strict=True) if is_used]
            revisions = [self._revised(one, begun.known, now, is_used=False) for one in left]
            estimate = replace(estimate, revisions=(*revisions, *estimate.revisions))
        return now, estimate

    def _estimate(
        self, event: Event, samples: EventSamples | Reason, state: Posterior, against: tuple[Reason, ...]
    ) -> tuple[Posterior, ShiftEstimate]:
        """Return the same, without a new beginning."""
        if isinstance(samples, Reason):
            is_unknown = samples is Reason.TORQUE_UNKNOWN
            return state, without_friction(event, Status.UNOBSERVED if is_unknown else Status.REJECTED, samples)
        type_ = self._type.less_sure(skew_variance(samples.skew_s))
        state = _of_skewed(state, type_, samples.skew_s)
        first = linearise(samples, self._laws, state.packs, state.fusion.knowledge.mean)
        if isinstance(first, NotLinearised):
            return state, _unobserved(event, first, against)
        slipping = SlippingClutch(
            number=first.clutch,
            rows=first.balance.window.slip_rows,
            pressure_zero_pa=_zero_pa(type_, first.zeros, state.fusion.knowledge, first.clutch),
            touch_pressure_pa=self._laws.packs[first.clutch - 1].touch_pressure_pa,
        )
        if faults := plausibility_faults(event, first.balance.signals, slipping):
            return state, without_friction(event, Status.REJECTED, *faults)
        before = self._unknown_friction(state.fusion.knowledge, first.clutch)
        result = self._linearised_at_posterior(samples, state, first, before, type_)
        if result is None:  # at the posterior the film carries too much
            return state, _unobserved(event, NotLinearised(Reason.NO_SLIP_WINDOW), against)
        linearisation = result.linearisation
        packs = PackTemperatures(clutch_k=linearisation.balance.final_clutch_k, at_ns=event.end_ns)
        is_misfit = _is_misfit(type_, fuse(type_, linearisation.evidence), linearisation.evidence.count)
        if is_misfit or against:
            state = replace(state, packs=packs) if is_misfit else state
            estimate = self._described(event, linearisation, state, fuse(before, linearisation.evidence))
            return state, _rejected(estimate, *((Reason.MISFIT,) if is_misfit else against))
        return self._judged(event, result, packs)

    def _judged(self, event: Event, result: AtPosterior, packs: PackTemperatures) -> tuple[Posterior, ShiftEstimate]:
        """Return what is known after an event, and its estimate: used or left out, and why."""
        linearisation, earlier, state = result.linearisation, result.earlier, replace(result.judged, packs=packs)
        others = earlier.fusion.knowledge if result.is_agreed else state.without(len(state.recent) - 1)
        before = self._unknown_friction(others, linearisation.clutch)
        alone = fuse(before, linearisation.evidence)
        estimate = self._described(event, linearisation, state, alone)
        if not result.is_agreed:
            estimate = replace(estimate, revisions=tuple(self._revisions(earlier, state)))
        if state.weights[-1]:
            return state, estimate
        reason = _why_left_out(before, alone, linearisation.evidence.count)
        if reason is not Reason.NOT_UPDATED:
            return state, _rejected(estimate, reason)
        return state, replace(estimate, reasons=(reason,))

    def _revisions(self, earlier: Posterior, state: Posterior) -> Iterator[Revision]:
        """Yield the events before the newest one whose use it has changed, estimated anew."""
        before = {id(event): used for event, used in zip(earlier.recent, earlier.is_used, strict=True)}
        for place, (event, is_used) in enumerate(zip(state.recent[:-1], state.is_used, strict=False)):
            if before.get(id(event), is_used) == is_used:
                continue
            yield self._revised(event, state.without(place), state, is_used=is_used)

    def _revised(self, event: JudgedEvent, others: Knowledge, state: Posterior, *, is_used: bool) -> Revision:
        """Return an earlier event as it is judged now; ``others`` is what is known without it."""
        known = self._unknown_friction(others, event.clutch)
        alone = fuse(known, event.evidence)
        reasons = () if is_used else (_why_left_out(known, alone, event.evidence.count),)
        is_valid = reasons in {(), (Reason.NOT_UPDATED,)}
        friction, free = both_frictions(state, event.clutch, alone.knowledge) if is_valid else (None, None)
        is_measured = state.torque is TorqueSource.MEASURED
        return Revision(
            clutch=event.clutch,
            end_bus_ns=event.end_ns,
            status=Status.VALID if is_valid else Status.REJECTED,
            reasons=reasons,
            friction=friction if is_measured else None,
            scale_free=free,
            slope=None if free is None or is_measured else FrictionSlope.of(free, state.torque),
        )

    def _unknown_friction(self, known: Knowledge, clutch: int) -> Knowledge:
        """Return knowledge with the prior of one clutch's friction in place of what is known of it."""
        rows = FRICTION_ROWS[clutch - 1]
        mean, covariance = known.mean.copy(), known.covariance.copy()
        mean[rows] = self._type.mean[rows]
        covariance[rows, :] = 0.0
        covariance[:, rows] = 0.0
        covariance[rows, rows] = _UNKNOWN_FRICTION
        return Knowledge(mean=mean, covariance=covariance)

    def _linearised_at_posterior(
        self, samples: EventSamples, state: Posterior, first: Linearisation, before: Knowledge, type_: Knowledge
    ) -> AtPosterior | None:
        """Return the event linearised at the posterior, with the states without it and with it.

        None if it tells nothing of friction there.

        Passes first assume that the event belongs with all that did until now, and only the last one is judged. If the
        judgement differs, or the event costs more than its omission, they begin again, and each one is judged. An event
        that does not belong is linearised at its own posterior with the prior ``before``, in which the friction of its
        clutch is unknown.
        """
        event, earlier, std = samples.event, state.with_oldest_folded(), type_.std()
        std[std == 0.0] = np.inf
        std[:FRICTION_COUNT] = np.inf

        def linearised(at: FloatArray, last: Linearisation, keeps_jacobian: bool) -> Linearisation | NotLinearised:  # noqa: FBT001
            return linearise(samples, self._laws, state.packs, at, last, keeps_jacobian=keeps_jacobian)

        def posterior_if_it_fits(linearisation: Linearisation) -> Knowledge | None:
            fusion = fuse(earlier.fusion.knowledge, linearisation.evidence)
            return fusion.knowledge if fusion.chi_square < linearisation.evidence.count + OMISSION_COST else None

        def posterior_as_judged(linearisation: Linearisation) -> Knowledge:
            judged = state.with_event(_judged_event(event, linearisation), earlier)
            return (judged.fusion if judged.weights[-1] else fuse(before, linearisation.evidence)).knowledge

        if (linearisation := iterate(first, linearised, posterior_if_it_fits, std)) is not None:
            judged = state.with_event(_judged_event(event, linearisation), earlier)
            if judged.weights[-1] and judged.agrees_with(earlier):
                return AtPosterior(linearisation, earlier, judged, is_agreed=True)
        if (linearisation := iterate(first, linearised, posterior_as_judged, std)) is None:
            return None
        judged = state.with_event(_judged_event(event, linearisation), earlier)
        return AtPosterior(linearisation, earlier, judged, is_agreed=judged.agrees_with(earlier))

    def _described(self, event: Event, linearisation: Linearisation, state: Posterior, alone: Fusion) -> ShiftEstimate:
        """Return the estimate of an event alone, with the prior of all but the friction of its clutch."""
        clutch, balance = linearisation.clutch, linearisation.balance
        window_s = sum(
            [end_s - start_s for start_s, end_s in spans_of(balance.window.slipping, balance.signals.grid_s)]
        )
        ratio = alone.chi_square / linearisation.evidence.count
        gate = chi_square_gate(linearisation.evidence.count)
        fit = min(1.0, max(0.0, (gate - ratio) / (gate - 1.0)))
        with_scale, without_scale = both_frictions(state, clutch, alone.knowledge)
        is_measured = state.torque is TorqueSource.MEASURED
        estimate = without_friction(event, Status.VALID)
        return replace(
            estimate,
            clutch=clutch,
            friction=with_scale if is_measured else None,
            scale_free=without_scale,
            slope=None if is_measured else FrictionSlope.of(without_scale, state.torque),
            fit=EventFit(
                sample_count=balance.sample_count,
                window_s=window_s,
                chi_square_ratio=ratio,
                quality=fit * min(1.0, window_s / FULL_WINDOW_S) / (1.0 + event.bad_frame_count / balance.sample_count),
            ),
            conditions=replace(
                estimate.conditions,
                clutch_temperature_k=balance.final_clutch_k[clutch - 1],
                slip_energy_j=balance.slip_energy_j(clutch, alone.knowledge.mean[FRICTION_ROWS[clutch - 1]]),
            ),
        )


def _of_skewed(state: Posterior, type_: Knowledge, skew_s: float) -> Posterior:
    """Return what is known before the first event, whose columns are apart by nobody knows how much, up to a skew."""
    if state.recent or state.folded_counts != (0, 0):
        return state
    missing = np.maximum(type_.covariance.diagonal() - state.base.covariance.diagonal(), 0.0)
    if not (added := missing * (skew_variance(skew_s) > 0.0)).any():
        return state
    base = state.base.less_sure(added)
    return replace(state, base=base, fusion=fuse(base, Evidence.none()))


def _zero_pa(type_: Knowledge, zeros: Evidence, known: Knowledge, clutch: int) -> float:
    """Return the zero of a clutch's pressure sensor [Pa] as an event shows it; otherwise it is as known."""
    row = State.ZERO1 + clutch - 1
    mean_pa, variance_pa2 = float(type_.mean[row]), float(type_.covariance[row, row])
    information_ratio = variance_pa2 * float(zeros.matrix[row, row])
    if information_ratio <= 1.0:  # by less than what the type tells
        return float(known.mean[row])
    return (mean_pa + variance_pa2 * float(zeros.vector[row])) / (1.0 + information_ratio)


def _is_misfit(before: Knowledge, alone: Fusion, count: int) -> bool:
    """Return whether chi-square, score or friction of an event of ``count`` residuals is beyond its gate."""
    if alone.chi_square / count > chi_square_gate(count):
        return True
    after = alone.knowledge
    variance = before.covariance.diagonal()
    learnt = np.sqrt(np.maximum(variance - after.covariance.diagonal(), LEAST_LEARNT**2 * variance))
    score = np.abs(after.mean - before.mean) / np.where(learnt > 0.0, learnt, np.inf)
    most = (after.mean + SURE_STD * np.sqrt(after.covariance.diagonal()))[:FRICTION_COUNT]
    return bool(score[FRICTION_COUNT:].max() > SCORE_GATE or most.min() < LEAST_FRICTION)


def _unobserved(event: Event, why: NotLinearised, against: tuple[Reason, ...]) -> ShiftEstimate:
    """Return the estimate of an event that cannot be linearised."""
    is_unobserved = why.reason in {Reason.NO_SLIP_WINDOW, Reason.FEW_SAMPLES}
    reasons = against if is_unobserved and against else (why.reason,)
    status = Status.UNOBSERVED if is_unobserved and not against else Status.REJECTED
    return replace(without_friction(event, status, *reasons), fit=EventFit(sample_count=why.row_count))


def _why_left_out(before: Knowledge, alone: Fusion, count: int) -> Reason:
    """Return why an event of ``count`` residuals contradicts the others, of which ``before`` is the posterior."""
    if zero_has_jumped(before, alone.knowledge):
        return Reason.ZERO_JUMPED
    return Reason.MISFIT if _is_misfit(before, alone, count) else Reason.NOT_UPDATED


def _rejected(estimate: ShiftEstimate, *reasons: Reason) -> ShiftEstimate:
    """Return an estimate that is not believed."""
    return replace(estimate, status=Status.REJECTED, reasons=reasons, friction=None, scale_free=None, slope=None)


def _judged_event(event: Event, linearisation: Linearisation) -> JudgedEvent:
    # Laws of film, oil and drag in the cold, and what curves through few rows leave out, are wrong alike in all events.
    least = COLD_LEAST_SCATTER if min(linearisation.balance.final_clutch_k) < WORKING_K else 0.0
    least = 1.0 if linearisation.noise.is_alike else least
    return JudgedEvent(
        clutch=linearisation.clutch, end_ns=event.end_ns, evidence=linearisation.evidence, least_scatter=least
    )


def chi_square_gate(count: int) -> float:
    """Return the chi-square per degree of freedom beyond which the model does not explain a residual."""
    return min(MAX_MISFIT, 1.0 + MAX_EXCESS / count)


def zero_has_jumped(before: Knowledge, after: Knowledge) -> bool:
    """Return whether the zero of a pressure sensor, measured on an empty clutch, contradicts what was known before.

    A zero moves by its update, and the variance of the update is what the variance of the zero loses.
    """
    moved_pa = (after.mean - before.mean)[_ZEROS]
    variance_pa2 = before.covariance.diagonal()[_ZEROS]
    # A zero that was not measured moves a little with the other one; rounding must not make that a contradiction.
    loss_pa2 = np.maximum(variance_pa2 - after.covariance.diagonal()[_ZEROS], LEAST_LOSS * variance_pa2)
    return bool(np.any(moved_pa**2 > ZERO_GATE * loss_pa2))


def without_friction(event: Event, status: Status, *reasons: Reason) -> ShiftEstimate:
    """Return the estimate of a shift that says nothing of friction: when and what it was, and why not."""
    return ShiftEstimate(
        number=event.number,
        from_gear=event.from_gear,
        to_gear=event.to_gear,
        clutch=clutch_of_gear(event.to_gear),
        start_ns=event.start_ns,
        end_ns=event.end_ns,
        status=status,
        reasons=reasons,
        friction=None,
        conditions=EventConditions(
            duration_s=(event.end_ns - event.start_ns) * NS_TO_S,
            sump_temperature_k=_mean(event, Signal.SUMP_TEMPERATURE),
            odometer_m=_mean(event, Signal.ODOMETER),
        ),
        kind=event.kind,
        end_reason=event.end_reason,
    )


def _mean(event: Event, signal: Signal) -> float | None:
    series = event.columns.get(signal)
    return float(series.value.mean()) if series is not None and len(series.value) else None
