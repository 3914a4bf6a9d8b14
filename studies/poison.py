"""Bad events in a drive: what one or two of them do to the running state, and how fast a true change is followed.

Uncalibrated vehicles, drawn as ``studies.drawn_vehicle`` draws them, drive three cycles or a trace. In a trial one
or two events, anywhere among those that tell of friction, get a sensor error that the others have not: torque or a
clutch pressure that drifts, is offset, or spikes. The end of the drive is compared with that of the same drive without
these events; beside it stands what leaving out the same events moves if they are sound. An event is named if it is left
out as the last one has judged it; a case is found if any is, that is not in the sound drive. In the second table the
friction of a clutch falls or rises by 6 % between two drives of a vehicle.

    python -m studies.poison                                  # oil of 90 degC
    python -m studies.poison --oil-degc 45
    python -m studies.poison --oil-degc 0 --trace udds        # one UDDS instead of three cycles
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_results.records import Condition, Reason, Status
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.friction.posterior import scale_free
from diag_service.service.stages import Diagnosis
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import FluidCondition, Scenario, Truth, WorkshopRoutine
from studies.builders import EPOCH_US, STRETCH_S, TRACES, in_oil, new_stages, planned, to_batch
from studies.drawn_vehicle import draw
from studies.drive_accuracy import WRONG
from studies.run import over_drives, parsed, root_mean_square, study_parser

FIRST_SEED: Final = 93_000
TRIALS_PER_VEHICLE: Final = 5
MOST_MOVED: Final = 0.01  # of mu: what bad events may do unnoticed
STEP_RATIO: Final = 0.06
FOLLOWED_EVENTS: Final = 4  # of the clutch
COLD_FOLLOWED_EVENTS: Final = 8  # likewise where the oil is colder than this:
COLD_DEGC: Final = 60.0
NS_TO_S: Final = 1e-9
KINDS: Final = ("drift", "offset", "spike")
TORQUES_NM: Final = {"drift": 20.0, "offset": 15.0, "spike": 60.0}  # drift: per second
PRESSURES_PA: Final = {"drift": 0.3e5, "offset": 0.15e5, "spike": 0.8e5}
SPIKE_S: Final = 0.05
GAP_NS: Final = 10_000_000_000  # between two drives
START_NS: Final = EPOCH_US * 1000  # of all drives


@dataclass(frozen=True, slots=True, kw_only=True)
class PoisonSetting:
    """What is driven, and in which oil."""

    oil_degc: float | None = None  # at the start; None: of the cycle, 90 degC
    trace: str | None = None  # None: three cycles

    @property
    def followed_events(self) -> int:
        """Events of the clutch within which a change must be followed."""
        is_cold = self.oil_degc is not None and self.oil_degc < COLD_DEGC
        return COLD_FOLLOWED_EVENTS if is_cold else FOLLOWED_EVENTS

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return the scenario in that oil; cycles keep its temperature, a trace warms it up."""
        if self.oil_degc is None:
            return scenario
        return in_oil(scenario, self.oil_degc)

    def drive(self, scenario: Scenario) -> Drive:
        """Return the drive of a scenario, before it begins."""
        if self.trace is None:
            return Drive(scenario)
        return Drive(replace(scenario, drive=DriveName.CITY), planned=iter([planned(self.trace)]))

    def events(self, scenario: Scenario) -> list[Event]:
        """Drive, and return the events."""
        stages, found = new_stages(), list[Event]()
        if self.trace is None:
            return stages.segment(to_batch(frames_of(scenario)[0])) + stages.flush()
        for stretch in self.drive(scenario).stretches(STRETCH_S):
            found += stages.segment(to_batch(merge([stretch.frames])))
        return found + stages.flush()


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What bad events did to one drive."""

    what: str
    bad_count: int
    first_place: int
    moved_ratio: float  # of the scale-free friction at the end, the largest of four
    sound_ratio: float  # the same, had the events been sound: what leaving them out alone moves
    named_count: int  # bad events that are left out in the end
    innocent_count: int  # sound ones likewise, that are not in the sound drive
    has_false_verdict: bool

    @property
    def is_found(self) -> bool:
        """Whether anything was named."""
        return bool(self.named_count or self.innocent_count)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoisonStep:
    """How a change of friction was followed: error of scale-free mu_C after so many events of the clutch since."""

    clutch: int
    step_ratio: float
    errors_ratio: tuple[float, ...]
    stds_ratio: tuple[float, ...]


def bad(event: Event, signal: Signal, kind: str, sign: float) -> Event:
    """Return an event one of whose sensors errs."""
    series = event.columns[signal]
    t_s = (series.t_ns - event.start_ns) * NS_TO_S
    size = sign * (TORQUES_NM if signal is Signal.ENGINE_TORQUE else PRESSURES_PA)[kind]
    middle_s = 0.5 * (event.end_ns - event.start_ns) * NS_TO_S
    error = {
        "drift": size * np.maximum(t_s, 0.0),
        "offset": np.full(len(t_s), size),
        "spike": size * (np.abs(t_s - middle_s) < 0.5 * SPIKE_S),
    }[kind]
    return replace(event, columns={**event.columns, signal: replace(series, value=series.value + error)})


def concluded(events: Sequence[Event]) -> list[Diagnosis]:
    """Return the diagnoses of events by a service that has never met the vehicle."""
    stages = new_stages()
    return [stages.conclude(event) for event in events]


def left_out(diagnoses: Sequence[Diagnosis]) -> set[int]:
    """Return when the events end that are refused or left out, as later ones have judged them."""
    is_out: dict[int, bool] = {}
    for one in diagnoses:
        judged = {revision.end_bus_ns: revision for revision in one.estimate.revisions}
        for end_ns, now in (judged | {one.estimate.end_ns: one.estimate}).items():
            is_out[end_ns] = now.status is Status.REJECTED or Reason.NOT_UPDATED in now.reasons
    return {end_ns for end_ns, is_so in is_out.items() if is_so}


def free(state: Posterior) -> FloatArray:
    """Return the scale-free friction of both clutches, (mu_C, mu_S) each, shape (4,)."""
    both = [scale_free(state, clutch) for clutch in (1, 2)]
    return np.array([value for one in both for value in (one.mu_c, one.mu_s)])


def trials(setting: PoisonSetting, seed: int) -> list[Trial]:
    """Drive one vehicle and spoil events of it that tell of friction, in several trials."""
    vehicle = draw(seed, has_mismatch=False)
    events = setting.events(setting.scenario(vehicle.scenario(0, WorkshopRoutine())))
    return trials_of(events, seed, vehicle.fluid)


def trials_of(events: Sequence[Event], seed: int, fluid: FluidCondition) -> list[Trial]:
    """Spoil events of a drive in several trials."""
    diagnosed = concluded(events)
    sound, out_if_sound = free(diagnosed[-1].belief.posterior), left_out(diagnosed)
    telling = [place for place, one in enumerate(diagnosed) if one.estimate.friction is not None]
    rng = np.random.default_rng([seed, 93])
    found = []
    for number in range(TRIALS_PER_VEHICLE):
        count = 1 + (seed + number) % 2
        # every other trial spoils the first events: a state that knows nothing yet
        chosen = rng.choice(4 if number % 2 else len(telling), count, replace=False)
        places = sorted(telling[one] for one in chosen)
        signal = [Signal.ENGINE_TORQUE, Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE][int(rng.integers(3))]
        kind = KINDS[int(rng.integers(len(KINDS)))]
        sign = float(rng.choice([-1.0, 1.0]))
        spoilt = [bad(one, signal, kind, sign) if place in places else one for place, one in enumerate(events)]
        diagnoses = concluded(spoilt)
        without = concluded([one for place, one in enumerate(events) if place not in places])
        at_end = free(without[-1].belief.posterior)
        moved = np.abs(free(diagnoses[-1].belief.posterior) / at_end - 1.0)
        named, guilty = left_out(diagnoses) - out_if_sound, {events[place].end_ns for place in places}
        quantity = "torque" if signal is Signal.ENGINE_TORQUE else "pressure"
        found.append(
            Trial(
                what=f"{quantity} {kind}",
                bad_count=count,
                first_place=places[0],
                moved_ratio=float(moved.max()),
                sound_ratio=float(np.abs(sound / at_end - 1.0).max()),
                named_count=len(named & guilty),
                innocent_count=len(named - guilty - left_out(without)),
                has_false_verdict=_false_verdict(diagnoses, without, fluid),
            )
        )
    return found


def _false_verdict(diagnoses: Sequence[Diagnosis], without: Sequence[Diagnosis], fluid: FluidCondition) -> bool:
    """Return whether a verdict was false that was not so without the bad events."""

    def wrong(some: Sequence[Diagnosis]) -> set[tuple[int, Condition]]:
        return {(one.verdict.clutch, one.verdict.condition) for one in some if one.verdict.condition in WRONG[fluid]}

    return bool(wrong(diagnoses) - wrong(without))


def steps(setting: PoisonSetting, seed: int) -> list[PoisonStep]:
    """Drive a vehicle twice, the friction of one clutch changed in between."""
    vehicle, clutch = draw(seed, has_mismatch=False), 1 + seed % 2
    ratio = STEP_RATIO if seed % 4 < 2 else -STEP_RATIO
    before, after = (setting.scenario(vehicle.scenario(drive, WorkshopRoutine())) for drive in range(2))
    curve = nominal_calibration().clutches[clutch - 1].friction
    changed = {
        f"clutch{clutch}.friction.mu_c": curve.mu_c * (1.0 + ratio),
        f"clutch{clutch}.friction.mu_s": curve.mu_s * (1.0 + ratio),
    }
    true_mu_c = setting.drive(after).truth.mu_c[clutch - 1]
    after = replace(after, truth=Truth(calibration={**after.truth.calibration, **changed}))
    first = setting.events(before)
    later = [_later(event, first[-1].end_ns + GAP_NS) for event in setting.events(after)]
    area_ratio = 1.0 + vehicle.area_ratios[clutch - 1]
    true = true_mu_c * (1.0 + ratio) * vehicle.torque_gain * area_ratio
    errors, stds = [], []
    for one in concluded([*first, *later])[len(first) :]:
        if one.estimate.clutch == clutch and one.estimate.status is Status.VALID:
            now = scale_free(one.belief.posterior, clutch)
            errors.append(now.mu_c / true - 1.0)
            stds.append(now.std_mu_c / true)
    return [PoisonStep(clutch=clutch, step_ratio=ratio, errors_ratio=tuple(errors), stds_ratio=tuple(stds))]


def _later(event: Event, by_ns: int) -> Event:
    """Return an event of another drive as if it came ``by_ns`` after the first event of its own began."""
    columns = {signal: replace(one, t_ns=one.t_ns + by_ns - START_NS) for signal, one in event.columns.items()}
    return replace(
        event, columns=columns, start_ns=event.start_ns + by_ns - START_NS, end_ns=event.end_ns + by_ns - START_NS
    )


def main() -> int:
    """Run both studies and print their tables; return 1 if a bad event did harm unnoticed or a change was missed."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--steps", type=int, default=24, help="vehicles whose friction changes")
    parser.add_argument("--oil-degc", type=float, help="oil at the start, 90 if nothing is said")
    parser.add_argument("--trace", choices=TRACES, help="instead of three cycles")
    options = parsed(parser, trials=10, steps=4)
    setting = PoisonSetting(oil_degc=options.oil_degc, trace=options.trace)
    count = -(-options.trials // TRIALS_PER_VEHICLE)
    found = over_drives(partial(trials, setting), range(options.seed, options.seed + count), options.workers)
    console = Console(markup=False, width=120)
    console.print(trials_table(found))
    harmed = [one for one in found if one.moved_ratio > MOST_MOVED and one.named_count < one.bad_count]
    by_sound = [one for one in found if one.sound_ratio > MOST_MOVED]
    false = sum(one.has_false_verdict for one in found)
    console.print(f"moved by more than {MOST_MOVED:.0%} and not all named: {len(harmed)} of {len(found)}")
    console.print(f"worst: {max(one.moved_ratio for one in found):.2%}; false verdicts: {false}")
    console.print(
        f"moved by more than {MOST_MOVED:.0%} when the same events are left out though sound: {len(by_sound)}, "
        f"worst {max(one.sound_ratio for one in found):.2%}"
    )
    cases = [one for one in found if one.is_found]
    console.print(
        f"found: {len(cases)} cases; a bad event named in {sum(one.named_count > 0 for one in cases)} of them, "
        f"an innocent one in {sum(one.innocent_count > 0 for one in cases)}"
    )
    followed = over_drives(partial(steps, setting), range(options.seed, options.seed + options.steps), options.workers)
    console.print(steps_table(followed))
    most = setting.followed_events
    slow = sum(not is_followed(one, most) for one in followed)
    never = sum(not any(is_followed(one, count) for count in range(1, len(one.errors_ratio) + 1)) for one in followed)
    console.print(f"not followed within {most} events of the clutch: {slow} of {len(followed)}, never: {never}")
    return 1 if harmed or false or slow else 0


def is_followed(step: PoisonStep, events: int = FOLLOWED_EVENTS) -> bool:
    """Return whether what is stated holds again after so many events, and most of the step has been made."""
    place = events - 1
    if len(step.errors_ratio) <= place:
        return False
    error, std = abs(step.errors_ratio[place]), step.stds_ratio[place]
    return error < max(2.0 * std, 0.25 * STEP_RATIO) and error < 0.5 * STEP_RATIO


def trials_table(found: Sequence[Trial]) -> Table:
    """Return what bad events did, by sensor and kind."""
    table = Table("error", "trials", "events named", "innocents", "moved, median", "worst", "if sound", "worst",
                  "false verdicts", title="One or two bad events in a drive: scale-free friction then")  # fmt: skip
    for what in sorted({one.what for one in found}):
        some = [one for one in found if one.what == what]
        moved, sound = ([getattr(one, name) for one in some] for name in ("moved_ratio", "sound_ratio"))
        counts = ("named_count", "bad_count", "innocent_count")
        named, all_bad, innocent = (sum(getattr(one, name) for one in some) for name in counts)
        table.add_row(
            what, str(len(some)), f"{named} of {all_bad}", str(innocent),
            f"{np.median(moved):.2%}", f"{max(moved):.2%}", f"{np.median(sound):.2%}", f"{max(sound):.2%}",
            str(sum(one.has_false_verdict for one in some)),
        )  # fmt: skip
    return table


def steps_table(found: Sequence[PoisonStep]) -> Table:
    """Return how far behind the running state is after a change, event by event of the clutch."""
    table = Table("events since", "RMS error", "worst", "stated", title=f"Friction changed by {STEP_RATIO:.0%}, mu_C")
    for place in range(8):
        some = [one for one in found if len(one.errors_ratio) > place]
        errors = np.array([one.errors_ratio[place] for one in some])
        stated = float(np.mean([one.stds_ratio[place] for one in some]))
        table.add_row(str(place + 1), f"{root_mean_square(errors):.2%}", f"{np.abs(errors).max():.2%}", f"{stated:.2%}")
    return table


if __name__ == "__main__":
    sys.exit(main())
