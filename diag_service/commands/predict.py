"""``diag-service predict``: friction found in some shifts of logs, held against the others."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Final

import numpy as np

from canlog.logs import read_log
from canlog.logs.reading import Watch
from clutch_model.units import bar_from_pa, pa_from_bar, rpm_from_rad_s
from clutch_results.records import dump
from clutchdiag_io.people import PLUS_MINUS, digits, plus_minus
from diag_service.console import PeopleConsole, ReadingLine
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.prediction import (
    LEAST_EVENTS,
    PRESSURES,
    NoPhase,
    Prediction,
    SlipPhase,
    Standing,
    fitted,
    predicted,
    slip_phase,
)
from diag_service.diagnosis.shifts.gear_tracking import tracker_for
from diag_service.diagnosis.shifts.shifts import PRE_NS
from diag_service.diagnosis.shifts.tracking import NS_PER_S, EventFinder
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.mapping.tiers import missing_for_next
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.proposed import asked_meaning

if TYPE_CHECKING:
    from diag_service.diagnosis.events import Event

SCHEMA: Final = "clutchdiag/predict/v1"
OURS: Final = "friction"
AFTER_NS: Final = NS_PER_S // 2  # behind a gear change: its slip is nearly closed there
QUANTILES: Final = (np.arange(400) + 0.5) / 400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One shift, left out of what it was predicted from, and what was said of it, by the name of the model."""

    log: str
    phase: SlipPhase
    predictions: dict[str, Prediction]


def slip_phases(
    log: Path, meaning: Interpretation, standing: Standing, stop: Trigger, watch: Watch | None = None, columns: str = ""
) -> tuple[list[SlipPhase], list[NoPhase]]:
    """Return the slip phases of the gear changes of a log, and the gear changes without one; raises StoppedError."""
    decoder = meaning.decoder()
    finder = EventFinder(tracker_for(decoder.signals, decoder.gears), PRE_NS, AFTER_NS)
    events: list[Event] = []
    with read_log(log, is_stopped=lambda: stop.is_set, watch=watch, columns=columns) as reader:
        for batch in reader:
            if stop.is_set:
                raise StoppedError("stopped early: nothing is predicted from a part of a log")
            for one in decoder.stream(batch):
                standing.add(one)
                events += decoder.marked(finder.feed(one))
    for one in decoder.drain():
        events += decoder.marked(finder.feed(one))
    found = [slip_phase(event, decoder.gears) for event in [*events, *decoder.marked(finder.flush())]]
    return [one for one in found if isinstance(one, SlipPhase)], [one for one in found if isinstance(one, NoPhase)]


def left_out_one_by_one(named: Sequence[tuple[str, SlipPhase]], touch_pa: float | None) -> Iterator[Shown]:
    """Yield every slip phase with what the others say of it; raises ValueError if they are too few."""
    for log, phase in named:
        yield _shown(log, phase, [other for _, other in named if other is not phase], touch_pa)


def second_half_from_first(named: Sequence[tuple[str, SlipPhase]], touch_pa: float | None) -> Iterator[Shown]:
    """Yield the slip phases of the second half with what those of the first say; raises ValueError if too few."""
    half = (len(named) + 1) // 2
    for log, phase in named[half:]:
        yield _shown(log, phase, [other for _, other in named[:half]], touch_pa)


def _shown(log: str, phase: SlipPhase, known: Sequence[SlipPhase], touch_pa: float | None) -> Shown:
    return Shown(log=log, phase=phase, predictions={OURS: predicted(fitted(known, touch_pa), phase)})


def scores(shown: Sequence[Shown]) -> dict[str, dict[str, float]]:
    """Return what the model was worth at the ends of the slip phases, and over all their samples.

    ``crps_rad_s``, the continuous ranked probability score, is an error that a too narrow or too wide interval
    enlarges; ``inside_50`` and ``inside_90`` are how many of 1 lay inside these intervals.
    """
    return {name: _score([(one.phase, one.predictions[name]) for one in shown]) for name in shown[0].predictions}


def _score(pairs: Sequence[tuple[SlipPhase, Prediction]]) -> dict[str, float]:
    ends = [(one.mean_rad_s[-1], one.scale_rad_s[-1], one.freedom, phase.change_rad_s[-1]) for phase, one in pairs]
    every = [
        (mean, scale, one.freedom, true)
        for phase, one in pairs
        for mean, scale, true in zip(one.mean_rad_s, one.scale_rad_s, phase.change_rad_s, strict=True)
    ]
    errors = [abs(mean / true - 1.0) for mean, _, _, true in ends]
    return {
        "median_error_ratio": float(np.median(errors)),
        "crps_rad_s": float(np.mean([_crps(*one) for one in ends])),
        **{f"inside_{part}": _inside(ends, part) for part in (50, 90)},
        **{f"samples_inside_{part}": _inside(every, part) for part in (50, 90)},
    }


def _crps(mean: float, scale: float, freedom: float, true: float) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415 - a large library

    drawn = mean + scale * stdtrit(freedom, QUANTILES)
    return float(np.mean(np.abs(drawn - true)) - 0.5 * np.mean(np.abs(drawn[:, None] - drawn)))


def _inside(found: Sequence[tuple[float, float, float, float]], part: int) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415 - a large library

    return float(np.mean([abs(true - mean) < scale * stdtrit(f, 0.5 + part / 200.0) for mean, scale, f, true in found]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """The gear changes of some logs: each predicted from others, by kind, and those that cannot be."""

    groups: dict[str, list[Shown]]  # only those of which there are enough
    too_few: dict[str, int]
    not_used: list[tuple[str, NoPhase]]  # log, and why
    touch_pa: float | None

    def records(self) -> list[dict[str, object]]:
        """Return what ``--json`` prints, a record for each kind of gear change."""
        return [_record(title, shown, self.touch_pa) for title, shown in self.groups.items()]


def predict_shifts(
    logs: Sequence[Path],
    meaning: Interpretation,
    *,
    touch_pa: float | None = None,
    is_by_halves: bool = False,
    stop: Trigger,
    watch: Watch | None = None,
) -> Predicted:
    """Return the gear changes of logs of one type of vehicle, each predicted from the others or by the first half.

    Raises ConfigError if the profile lacks what this needs, SourceError if a log cannot be read, StoppedError.
    """
    signals = meaning.decoder().signals
    wanted = {Signal.ENGINE_SPEED, *PRESSURES.values()}
    if not wanted <= signals:
        lacking = ", ".join(sorted(one.value for one in wanted - signals))
        raise ConfigError(f"profile {meaning.profile.name} has no {lacking}. {missing_for_next(signals)}".rstrip())
    standing, named, without = Standing(), list[tuple[str, SlipPhase]](), list[tuple[str, NoPhase]]()
    for log in logs:
        phases, others = slip_phases(log, meaning, standing, stop, watch)
        named += [(log.name, one) for one in phases]
        without += [(log.name, one) for one in others]
    touch_pa = standing.touch_pa if touch_pa is None else touch_pa
    groups = {
        "power upshifts": [one for one in named if one[1].sign > 0.0 and one[1].is_powered],
        "other upshifts": [one for one in named if one[1].sign > 0.0 and not one[1].is_powered],
        "downshifts": [one for one in named if one[1].sign < 0.0],
    }
    split = second_half_from_first if is_by_halves else left_out_one_by_one
    shown, too_few = dict[str, list[Shown]](), dict[str, int]()
    for title, group in groups.items():
        if ((len(group) + 1) // 2 if is_by_halves else len(group) - 1) < LEAST_EVENTS:
            too_few[title] = len(group)
        else:
            shown[title] = list(split(group, touch_pa))
    return Predicted(groups=shown, too_few=too_few, not_used=without, touch_pa=touch_pa)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Predict the shifts of logs from each other and show how well it went."""
    meaning = asked_meaning(options, lambda: controls.stop.is_set)
    touch_pa = None if options.touch is None else pa_from_bar(options.touch)
    with ReadingLine() as line:
        found = predict_shifts(
            options.logs, meaning, touch_pa=touch_pa, is_by_halves=options.halves, stop=controls.stop, watch=line.watch
        )
    console = PeopleConsole(stderr=options.json)
    for record in found.records() if options.json else ():
        sys.stdout.write(dump(record) + "\n")
    for title, shown in found.groups.items() if not options.json else ():
        console.print_all(_lines(title, shown))
    for title, count in found.too_few.items():
        console.print(f"{title}: {count}, too few to predict one from others ({LEAST_EVENTS} others are needed)")
    for log, one in found.not_used:
        console.print(f"{log}: {one.event.from_gear}-{one.event.to_gear} not used: {one.reason}")
    if found.touch_pa is not None:
        origin = ", as found at standstill" if touch_pa is None else ""
        console.print(f"touch point: {digits(bar_from_pa(found.touch_pa))} bar{origin}")


def _record(title: str, shown: Sequence[Shown], touch_pa: float | None) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "group": title,
        "touch_pa": touch_pa,
        "shifts": [
            {
                "log": one.log, "number": one.phase.number, "from_gear": one.phase.from_gear,
                "to_gear": one.phase.to_gear, "clutch": one.phase.clutch, "t_s": one.phase.t_s[1:].tolist(),
                "change_rad_s": one.phase.change_rad_s.tolist(),
                "predictions": {
                    name: {"mean_rad_s": said.mean_rad_s.tolist(), "scale_rad_s": said.scale_rad_s.tolist(),
                           "freedom": said.freedom} for name, said in one.predictions.items()
                },
            }
            for one in shown
        ],
        "scores": scores(shown),
    }  # fmt: skip


def _lines(title: str, shown: Sequence[Shown]) -> Iterator[str]:
    """Yield the table of one group: engine speed from the old gear to the last sample before the clutch locks."""
    yield f"{title}: change of engine speed in the slip [rpm], each predicted from others; {PLUS_MINUS}"
    yield f"{'log':<16} {'gears':>5} {'samples':>7} {'measured':>8} {'predicted':>15} {'error':>6}  in 50 % in 90 %"
    for one in shown:
        said, true = one.predictions[OURS], float(one.phase.change_rad_s[-1])
        mean, scale = float(said.mean_rad_s[-1]), float(said.scale_rad_s[-1])
        inside = ["yes" if _inside([(mean, scale, said.freedom, true)], part) else "no" for part in (50, 90)]
        std = scale * (said.freedom / (said.freedom - 2.0)) ** 0.5  # of Student's distribution
        gears, spread = (
            f"{one.phase.from_gear}-{one.phase.to_gear}",
            plus_minus(rpm_from_rad_s(mean), rpm_from_rad_s(std), "{:.0f}"),
        )
        yield (
            f"{one.log[:16]:<16} {gears:>5} {len(one.phase.t_s):>7} {rpm_from_rad_s(true):>8.0f} {spread:>15} "
            f"{100 * (mean / true - 1):>5.0f}%  {inside[0]:>7} {inside[1]:>7}"
        )
    yield f"{'all':<28} {'median error':>12} {'CRPS rpm':>10} {'in 50 %':>8} {'in 90 %':>8}   of all samples"
    for name, score in scores(shown).items():
        yield (
            f"{name:<28} {100 * score['median_error_ratio']:>10.0f} % {rpm_from_rad_s(score['crps_rad_s']):>10.0f} "
            f"{100 * score['inside_50']:>6.0f} % {100 * score['inside_90']:>6.0f} %   "
            f"{100 * score['samples_inside_50']:.0f} % and {100 * score['samples_inside_90']:.0f} %"
        )
