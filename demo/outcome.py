"""The outcome of a demonstration: estimates beside the truth, frames of both ends, what is wrong; and how it looks."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from rich import box
from rich.table import Table
from rich.text import Text

from clutch_results.records import ClutchVerdict, FrictionEstimate, ShiftResult
from clutchdiag_io.people import PLUS_MINUS, SHORT_PLUS_MINUS, plus_minus
from diag_service.delivery.console import condition_words
from diag_service.diagnosis.summary import reason_text
from ecu_emulator.truth import ShiftTruth, TruthLog
from fleet_contract import CLUTCHES

MAX_ERROR_STD: Final = 4.0  # beyond it an estimate is wrong, not unlucky: 6e-5 by chance
UNUSUAL_STD: Final = 2.0
BUSY_S: Final = 0.1  # of lateness: ten cycles of the fastest messages
CONDITION_STYLE: Final = {"no verdict": "dim", "good": "green", "watch": "yellow", "change fluid": "bold red"}
SLOPE_NOTE: Final = (
    "mu_C and mu_S err together: bands may overlap though it is sure which is larger; P(slope<0) is that of mu_S > mu_C"
)
_COEFFICIENTS: Final = {"mu_C": "mu_c", "mu_S": "mu_s"}
_NO_FRICTION: Final = ("-",) * 3 * len(_COEFFICIENTS)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameAccount:
    """Frames at both ends of the bus."""

    sent: int
    given_up: int  # the emulator's interface did not take them
    lateness_max_s: float  # of sending, against the schedule
    on_bus: int  # seen by the service's interface
    decoded: int
    ignored: int
    rejected: Mapping[str, int]
    dropped: int  # by kernel or service, counted by them
    missing: int  # noticed by alive counters
    late: int  # decoded, but held back on the way

    @property
    def arrived(self) -> int:
        """Frames that the service judged."""
        return self.decoded + self.ignored + sum(self.rejected.values())

    @property
    def unexplained(self) -> int:
        """Frames sent of which the service knows nothing: neither judged nor noticed as lost; negative: of others."""
        lost = self.sent - self.arrived
        return min(lost, 0) or max(lost - max(self.missing, self.dropped), 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Everything that a demonstration ends with."""

    expected: int  # shifts at least
    shifts: tuple[ShiftResult, ...]
    origin: str  # of the shifts, for people
    clutches: Mapping[int, ClutchVerdict]  # as the service leaves them
    order: str
    truth: TruthLog
    frames: FrameAccount

    def true_shift(self, result: ShiftResult) -> ShiftTruth | None:
        """Return the truth about a shift, if the emulator drove it."""
        for shift in self.truth.shifts:
            if shift.number == result.estimate.number:
                is_same = (shift.from_gear, shift.to_gear) == (result.estimate.from_gear, result.estimate.to_gear)
                return shift if is_same else None
        return None

    def true_friction(self, clutch: int) -> tuple[float, float]:
        """Return mu_C and mu_S of a clutch as they were when it engaged last."""
        latest = [shift for shift in self.truth.shifts if shift.clutch == clutch]
        if latest:
            return latest[-1].mu_c, latest[-1].mu_s
        return self.truth.drive.mu_c[clutch - 1], self.truth.drive.mu_s[clutch - 1]


def frame_account(transmitted: Mapping[str, Any], received: Mapping[str, Any]) -> FrameAccount:
    """Return the account from the emulator's transmit report and the ``frames`` of the service's summary."""
    return FrameAccount(
        sent=transmitted["frames_sent"],
        given_up=transmitted["frames_given_up"],
        lateness_max_s=transmitted["lateness_max_s"],
        on_bus=received["on_bus"],
        decoded=received["decoded"],
        ignored=received["ignored"],
        rejected=received["rejected"],
        dropped=received["kernel_dropped"] + received["queue_dropped"],
        missing=received["missing"],
        late=received["late"],
    )


def compared(friction: FrictionEstimate, mu_c: float, mu_s: float) -> Iterator[tuple[str, float, float, float, float]]:
    """Yield for both coefficients name, estimate, its deviation, truth, and the error in units of the deviation."""
    for (name, attribute), truth in zip(_COEFFICIENTS.items(), (mu_c, mu_s), strict=True):
        estimate, std = getattr(friction, attribute), getattr(friction, f"std_{attribute}")
        yield name, estimate, std, truth, (estimate - truth) / std


def complaints(outcome: Outcome) -> list[str]:
    """Return everything that is not as it must be; nothing if the demonstration succeeded."""
    return [*_shift_complaints(outcome), *_clutch_complaints(outcome), *_frame_complaints(outcome.frames)]


def lateness_text(outcome: Outcome) -> str | None:
    """Return that the machine was too busy if the drive was sent late and something is not as it must be, else None."""
    late_s = outcome.frames.lateness_max_s
    if late_s <= BUSY_S or not (found := complaints(outcome)):
        return None
    return f"this machine was too busy to send in time (at most {late_s:.1f} s late; {found[0]})"


def _shift_complaints(outcome: Outcome) -> Iterator[str]:
    driven = len(outcome.truth.shifts)
    if driven < outcome.expected:
        yield f"the emulator drove {driven} shifts, not {outcome.expected}"
    if len(outcome.shifts) != driven:
        yield f"{len(outcome.shifts)} of {driven} shifts arrived"
    for result in outcome.shifts:
        estimate = result.estimate
        name = f"shift {estimate.number} ({estimate.from_gear}-{estimate.to_gear})"
        true = outcome.true_shift(result)
        if true is None:
            yield f"{name} was not driven"
        elif estimate.friction is None:
            yield f"{name} gave no estimate: {estimate.status.value}, {_reasons(result)}"
        else:
            yield from _errors(name, estimate.friction, true.mu_c, true.mu_s)


def _clutch_complaints(outcome: Outcome) -> Iterator[str]:
    for clutch in CLUTCHES:
        verdict = outcome.clutches.get(clutch)
        if verdict is None:
            yield f"the service says nothing of clutch {clutch}"
        elif verdict.friction is None:
            yield f"clutch {clutch} has no running estimate"
        else:
            name = f"the running estimate of clutch {clutch}"
            yield from _errors(name, verdict.friction, *outcome.true_friction(clutch))


def _frame_complaints(frames: FrameAccount) -> Iterator[str]:
    if frames.given_up:
        yield f"the bus did not take {frames.given_up} frames"
    if frames.on_bus != frames.arrived + frames.dropped:
        yield f"{frames.on_bus} frames were on the bus, the service accounts for {frames.arrived + frames.dropped}"
    if frames.unexplained > 0:
        yield f"{frames.unexplained} of {frames.sent} frames were lost without a trace"
    if frames.unexplained < 0:
        yield f"{-frames.unexplained} frames on the bus were not the emulator's"


def _errors(where: str, friction: FrictionEstimate, mu_c: float, mu_s: float) -> Iterator[str]:
    for name, *_, error_std in compared(friction, mu_c, mu_s):
        if not abs(error_std) <= MAX_ERROR_STD:
            yield f"{where}: {name} is off by {error_std:+.1f} std"


def _reasons(result: ShiftResult) -> str:
    return ", ".join(reason_text(reason) for reason in result.estimate.reasons)


def live_line(result: ShiftResult) -> Text:
    """Return a shift as one line, at the moment at which it arrives."""
    estimate, friction = result.estimate, result.estimate.friction
    condition = condition_words(result.verdict.condition)
    found = "no estimate"
    if friction is not None:
        spread_c, spread_s = plus_minus(friction.mu_c, friction.std_mu_c), plus_minus(friction.mu_s, friction.std_mu_s)
        found = f"mu_C {spread_c}  mu_S {spread_s}"
    line = Text(f"{estimate.number:>5}  {estimate.from_gear}-{estimate.to_gear}  clutch {estimate.clutch}  {found:<44}")
    line.append(f"  {condition:<12}", CONDITION_STYLE[condition])
    if estimate.reasons:
        line.append(f"  [{_reasons(result)}]")
    line.append(f"  {time.time() - estimate.end_ns / 1e9:.1f} s after its end", "dim")
    return line


def tables(outcome: Outcome) -> tuple[Table, Table]:
    """Return the single shifts, and the running estimates, which combine all shifts of a clutch, beside the truth."""
    shifts = _table(
        f"Single shifts, {outcome.origin}, beside the truth",
        ("shift", "gears", "clutch"),
        ("P(slope<0)",),
    )
    for result in outcome.shifts:
        estimate, true = result.estimate, outcome.true_shift(result)
        gears = f"{estimate.from_gear}-{estimate.to_gear}"
        truth = None if true is None else (true.mu_c, true.mu_s)
        cells = _cells(estimate.friction, truth)
        shifts.add_row(str(estimate.number), gears, str(estimate.clutch), *cells, _probability(estimate.friction))
    clutches = _table("Running estimates, as the service leaves them", ("clutch", "shifts"), ("P(slope<0)",))
    for clutch, verdict in sorted(outcome.clutches.items()):
        friction = verdict.friction
        cells = _cells(friction, outcome.true_friction(clutch))
        clutches.add_row(str(clutch), str(verdict.shift_count), *cells, _probability(friction))
    clutches.caption = f"{PLUS_MINUS}; {SLOPE_NOTE}"
    return shifts, clutches


def _probability(friction: FrictionEstimate | None) -> str:
    return "-" if friction is None else f"{friction.probability_negative_slope:.3f}"


def _table(title: str, first: tuple[str, ...], last: tuple[str, ...] = ()) -> Table:
    beside = [f"{symbol} {SHORT_PLUS_MINUS},truth,error/std".split(",") for symbol in _COEFFICIENTS]
    return plain_table(title, (*first, *(name for names in beside for name in names), *last))


def plain_table(title: str, columns: Sequence[str]) -> Table:
    """Return a table without rows; below it stands what its ± are."""
    table = Table(
        title=title, title_justify="left", title_style="bold", caption=PLUS_MINUS, caption_justify="left",
        box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _cells(friction: FrictionEstimate | None, truth: tuple[float, float] | None) -> tuple[str | Text, ...]:
    if friction is None or truth is None:
        return _NO_FRICTION
    cells: list[str | Text] = []
    for _, estimate, std, true, error_std in compared(friction, *truth):
        size = abs(error_std)
        style = "" if size <= UNUSUAL_STD else "yellow" if size <= MAX_ERROR_STD else "bold red"
        cells += [plus_minus(estimate, std), f"{true:.4f}", Text(f"{error_std:+.1f}", style)]
    return tuple(cells)


def frame_lines(frames: FrameAccount) -> Iterator[str]:
    """Yield the frame accounts of both programs."""
    rejected = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in frames.rejected.items() if count)
    yield (
        f"emulator: {frames.sent} frames sent, {frames.given_up} not taken by the bus; "
        f"at most {1e3 * frames.lateness_max_s:.0f} ms late"
    )
    yield (
        f"service:  {frames.decoded} decoded, {frames.ignored} ignored, "
        f"{sum(frames.rejected.values())} rejected{f' ({rejected})' if rejected else ''}, {frames.dropped} dropped, "
        f"{frames.missing} missing by alive counters, {frames.late} late in bursts; unexplained: {frames.unexplained}"
    )


def seconds_line(took_s: Mapping[str, float]) -> str:
    """Return what each part took."""
    return "took:     " + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in took_s.items())


def verdict_lines(outcome: Outcome) -> Iterator[Text]:
    """Yield the verdict on each clutch as a line that a script can find, and below it the sentence for people."""
    for clutch, verdict in sorted(outcome.clutches.items()):
        condition = condition_words(verdict.condition)
        line = Text(f"verdict: clutch {clutch} ")
        yield line.append(condition, CONDITION_STYLE[condition])
        if verdict.advice is not None:
            yield Text(f"         {verdict.advice}")
