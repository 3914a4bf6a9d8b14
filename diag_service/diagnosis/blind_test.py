"""Blind tests of predictions: shifts that are left out of what they are predicted from, beside simpler models.

No prediction is better than one whose interval does not hold: those that fail are refused, with the reason.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prediction import LEAST_EVENTS, Prediction, fitted, predicted
from diag_service.diagnosis.slip_phase import SlipPhase

OURS: Final = "friction"
MOST_CRPS_RATIO: Final = 0.6  # of the best simpler model's: with more, friction tells too little of these shifts
LEAST_TRIED: Final = 8  # of fewer, one alone inside the intervals of 50 % would speak against nothing
LEAST_CHANCE: Final = 0.05  # that true intervals hold so few shifts: with less, they are not true
QUANTILES: Final = (np.arange(400) + 0.5) / 400.0

Named: TypeAlias = Sequence[tuple[str, SlipPhase]]
"""Slip phases, each with the name of its log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedShift:
    """One shift, left out of what it was predicted from, and what was said of it, by the name of the model."""

    log: str
    phase: SlipPhase
    predictions: dict[str, Prediction]


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindTest:
    """Shifts that were predicted without being known, and those of which nothing is said, with the reason."""

    shown: list[PredictedShift] = field(default_factory=list)
    unknown: list[tuple[str, SlipPhase, str]] = field(default_factory=list)

    @property
    def why_refused(self) -> str:
        """What speaks against these predictions; empty if they pass."""
        if len(self.shown) < LEAST_TRIED:
            return f"{len(self.shown)} are too few to try predictions on, {LEAST_TRIED} are needed"
        from scipy.stats import binom  # noqa: PLC0415 - a large library

        found = scores(self.shown)
        name = min(found.keys() - {OURS}, key=lambda name: found[name]["crps_rad_s"])
        ratio = found[OURS]["crps_rad_s"] / found[name]["crps_rad_s"]
        if ratio > MOST_CRPS_RATIO:
            return f"CRPS is {ratio:.2f} of that of the best simpler model ({name}), more than {MOST_CRPS_RATIO:g}"
        for part in (50, 90):
            inside = found[OURS][f"inside_{part}"]
            if binom.cdf(round(inside * len(self.shown)), len(self.shown), part / 100.0) < LEAST_CHANCE:
                return f"intervals of {part} % hold {100.0 * inside:.0f} % of the shifts"
        return ""


def each_left_out(named: Named) -> Iterator[tuple[Named, Named]]:
    """Yield each shift, and all others."""
    for place in range(len(named)):
        yield named[place : place + 1], [*named[:place], *named[place + 1 :]]


def second_half(named: Named) -> Iterator[tuple[Named, Named]]:
    """Yield the second half of the shifts, and the first."""
    half = (len(named) + 1) // 2
    yield named[half:], named[:half]


def each_log(named: Named) -> Iterator[tuple[Named, Named]]:
    """Yield the shifts of each log, and those of all others."""
    for name in dict.fromkeys(log for log, _ in named):
        yield [shift for shift in named if shift[0] == name], [shift for shift in named if shift[0] != name]


def blind_test(
    named: Named, touch_pa: float | None, split: Callable[[Named], Iterator[tuple[Named, Named]]] = each_left_out
) -> BlindTest:
    """Return what shifts say of others; a split yields shifts that are asked for, and those that are known."""
    test = BlindTest()
    for asked, known in split(named):
        logs, phases = [log for log, _ in known], [phase for _, phase in known]
        model = fitted(phases, touch_pa, logs) if len(known) >= LEAST_EVENTS else None
        for log, phase in asked:
            few, is_other = f"{len(known)} others are too few, {LEAST_EVENTS} are needed", log not in logs
            why = few if model is None else model.why_unknown(phase, is_of_another=is_other)
            if model is None or why:
                test.unknown.append((log, phase, why))
                continue
            said = {OURS: predicted(model, phase, is_of_another=is_other), **predicted_simply(phases, phase)}
            test.shown.append(PredictedShift(log=log, phase=phase, predictions=said))
    return test


_RATE, _PRESSURE, _CLUTCH, _GEAR, _DURATION = range(5)  # of a row for each shift


SIMPLER: Final = ("mean rate of the clutch", "line through mean pressure", "nearest shift")


def _rates_rad_s2(known: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the rate of engine speed that each simpler model expects of a shift, in the order of ``SIMPLER``."""
    rate, pressure, is_alike = known[:, _RATE], known[:, _PRESSURE], known[:, _CLUTCH] == asked[_CLUTCH]
    off = pressure - pressure.mean()
    line = rate.mean() + off @ rate / max(float(off @ off), 1.0) * (asked[_PRESSURE] - pressure.mean())
    nearest = np.lexsort((np.abs(pressure - asked[_PRESSURE]), known[:, _GEAR] != asked[_GEAR]))[0]
    return np.array([(rate[is_alike] if is_alike.any() else rate).mean(), line, rate[nearest]])


def predicted_simply(known: Sequence[SlipPhase], asked: SlipPhase) -> dict[str, Prediction]:
    """Return what simpler models say of a shift; their deviations are what they miss on the known ones, left out."""
    *rows, last = (
        np.array([one.change_rad_s[-1] / one.t_s[-1], one.mean_pa, one.clutch, one.to_gear, one.t_s[-1]])
        for one in (*known, asked)
    )
    table, t_s = np.array(rows), asked.t_s[1:]
    missed = [
        (_rates_rad_s2(np.delete(table, place, 0), row) - row[_RATE]) * row[_DURATION] for place, row in enumerate(rows)
    ]
    stds_rad_s2 = np.sqrt(np.mean(np.square(missed), axis=0)) / asked.t_s[-1]
    return {
        name: Prediction(mean_rad_s=rate * t_s, scale_rad_s=std * t_s, freedom=float(len(known)))
        for name, rate, std in zip(SIMPLER, _rates_rad_s2(table, last), stds_rad_s2, strict=True)
    }


def levels(said: Prediction, true_rad_s: FloatArray) -> FloatArray:
    """Return the probability of the narrowest interval around each sample of a prediction that holds the truth."""
    from scipy.special import stdtr  # noqa: PLC0415 - a large library

    below = stdtr(said.freedom, (true_rad_s - said.mean_rad_s) / said.scale_rad_s)
    return np.asarray(np.abs(2.0 * below - 1.0), np.float64)


def scores(shown: Sequence[PredictedShift]) -> dict[str, dict[str, float]]:
    """Return what each model was worth at the ends of the slip phases, and over all their samples.

    ``crps_rad_s``, the continuous ranked probability score, is an error that a too narrow or too wide interval
    enlarges; ``inside_50`` and ``inside_90`` are how many of 1 lay inside these intervals.
    """
    return {
        name: _score([(shift.predictions[name], shift.phase.change_rad_s) for shift in shown])
        for name in shown[0].predictions
    }


def _score(pairs: Sequence[tuple[Prediction, FloatArray]]) -> dict[str, float]:
    every = [levels(*pair) for pair in pairs]
    held = {"inside": np.array([level[-1] for level in every]), "samples_inside": np.concatenate(every)}
    return {
        "median_error_ratio": float(np.median([abs(said.mean_rad_s[-1] / true[-1] - 1.0) for said, true in pairs])),
        "crps_rad_s": float(np.mean([_crps(said, true[-1]) for said, true in pairs])),
        **{f"{name}_{part}": float(np.mean(held[name] < part / 100.0)) for name in held for part in (50, 90)},
    }


def _crps(said: Prediction, true_rad_s: float) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415 - a large library

    drawn = said.mean_rad_s[-1] + said.scale_rad_s[-1] * stdtrit(said.freedom, QUANTILES)
    return float(np.mean(np.abs(drawn - true_rad_s) - (2.0 * QUANTILES - 1.0) * drawn))
