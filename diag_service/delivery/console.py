"""A line per shift and a closing table, for people."""

import sys
from collections.abc import Iterable, Iterator

from rich.console import Console
from rich.table import Table
from rich.text import Text

from clutch_model.units import degc_from_k
from clutch_results.event_kinds import EndReason
from clutch_results.measures import (
    CAPACITY,
    HEAT,
    JERK,
    JUDDER,
    PEAK_SLIP,
    RATIO,
    SCORE,
    SHIFT_TIME,
    SLIP_TIME,
    Measure,
    shown_measures,
)
from clutch_results.records import LEAST_SLIP_ROWS, Condition, Reason, ShiftEstimate, ShiftResult, Status, Tier
from clutch_results.shift_course import load_line
from clutch_results.shifting import CHANGE_LEGEND, ShiftingSummary, change_cell
from clutchdiag_io.console import PeopleConsole, plain_table
from clutchdiag_io.people import PLUS_MINUS, SHORT_PLUS_MINUS, half_width, plus_minus
from clutchdiag_io.program import discard
from diag_service.delivery.reporters import ControllerNews, JsonLinesReporter, News, PipeReporter, Reporter
from diag_service.diagnosis.frame_counts import frames_line, values_line
from diag_service.diagnosis.lockup.slip import slip_lines
from diag_service.diagnosis.lockup.slope import slope_lines
from diag_service.diagnosis.summary import (
    Summary,
    capability_line,
    cause_lines,
    gaps_line,
    newest_causes,
    ratio_line,
    reason_text,
    scale_free_lines,
    shifting_lines,
    shifts_line,
    slope_line,
)
from diag_service.stopping import Trigger
from fleet_contract.orders import SHOWN_AS, Order, name_of


def condition_words(condition: Condition) -> str:
    return condition.name.lower().replace("_", " ")


def kind_words(estimate: ShiftEstimate) -> str:
    return estimate.kind.value.replace("_", " ")


def gear_words(estimate: ShiftEstimate) -> str:
    """Return from which gear to which, or the gear of an event without a change."""
    is_change = estimate.from_gear != estimate.to_gear
    return f"{estimate.from_gear}-{estimate.to_gear}" if is_change else str(estimate.to_gear)


def reason_words(estimate: ShiftEstimate) -> str:
    """Return why an event was not used; empty if there is no reason."""
    few = f"not enough samples in the slip ({estimate.fit.sample_count} of at least {LEAST_SLIP_ROWS})"
    return ", ".join(few if reason is Reason.FEW_SAMPLES else reason_text(reason) for reason in estimate.reasons)


_CONDITION_STYLE = {
    Condition.NO_VERDICT: "dim",
    Condition.GOOD: "green",
    Condition.WATCH: "yellow",
    Condition.CHANGE_FLUID: "bold red",
}
_STATUS_STYLE = {Status.VALID: "green", Status.REJECTED: "red", Status.UNOBSERVED: "yellow"}
_HEAD = f"{'shift':>5}  {'gears':<5} {'event':<18} {'clutch':>6}  {'status':<10} {'mu_C':>8} {SHORT_PLUS_MINUS:>7} "
_DETAIL_HEAD = f"{'mu_S':>8} {SHORT_PLUS_MINUS:>7} {'P(slope<0)':>10} {'trust':>5} {'oil':>6} "
_HEAD_END = " clutch is"
_EVENT_HEAD = f"{'shift':>5}  {'gears':<5} {'event':<18} {'clutch':>6} "
_COLUMNS = {
    SLIP_TIME: 10,
    SHIFT_TIME: 10,
    PEAK_SLIP: 10,
    HEAT: 9,
    CAPACITY: 8,
    SCORE: 6,
    JERK: 10,
    RATIO: 12,
    JUDDER: 9,
}
_LITTLE_KNOWN = {HEAT, CAPACITY, JERK}  # what means nothing without its deviation
_WITH_STDS = 8  # characters more, for two deviations
NOT_MEASURED = f"-: not measured; {PLUS_MINUS}"


class ConsoleReporter:
    """Prints results as they come, to specialists more of them; rich decides about colours."""

    def __init__(self, console: Console, *, is_detailed: bool = False) -> None:
        self._console = console
        self._is_detailed = is_detailed
        self._tier: Tier | None = None  # by which the last head was

    def report(self, news: News) -> None:
        """Print one of the news; the last one, the numbers of the run, with a table of clutches."""
        if isinstance(news, str):
            self._line(Text(f"listening on {news}"))
        elif isinstance(news, ControllerNews):
            self._line(Text(str(news)))
        elif isinstance(news, Summary):
            self._conclude(news)
        else:
            if news.estimate.tier is not self._tier:
                self._tier = news.estimate.tier
                self._line(shift_head(is_detailed=self._is_detailed, tier=self._tier))
            self._line(shift_line(news, is_detailed=self._is_detailed))

    def _conclude(self, summary: Summary) -> None:
        if summary.gaps:
            self._line(Text(gaps_line(summary.gaps), style="bold red"))
        for sentence in order_lines(summary.order):
            self._line(sentence)
        if (shifting := summary.shifting) is not None:
            self._console.print(shifting_table(shifting))
        elif summary.latest:
            self._console.print(_clutch_table(summary, is_detailed=self._is_detailed))
        for line in _findings_of(summary):
            self._line(Text(line))
        if self._is_detailed:
            self._show_for_specialists(summary)
        lines = (frames_line(summary.frames), values_line(summary.frames), capability_line(summary))
        for line in filter(None, (shifts_line(summary), *lines)):
            self._line(Text(line))

    def _show_for_specialists(self, summary: Summary) -> None:
        for result in summary.latest:
            self._line(Text(f"{name_of(result.verdict.clutch, result.verdict.element)}: {result.verdict.reason}"))
            for line in scale_free_lines(result.verdict):
                self._line(Text(f"  {line}"))
        if line := ratio_line(summary):
            self._line(Text(line))

    def _line(self, text: Text) -> None:
        self._console.print(text, soft_wrap=True)
        self._console.file.flush()


def _findings_of(summary: Summary) -> Iterator[str]:
    """Yield for people what a run tells besides the order and its table."""
    for result in summary.latest:
        if line := slope_line(result.verdict):
            yield f"{name_of(result.verdict.clutch, result.verdict.element)}: {line}"
    yield from cause_lines(newest_causes(summary.latest, summary.today_ns))
    # Where no pressure tells heat, the table has what torque and speeds say of it, and counts launches.
    loads = (load for _, load in sorted(summary.loads.items()))
    yield from (load_line(load) for load in loads if any(load.counts) or not summary.untold)
    yield from (*map(str, summary.relative), *slope_lines(summary.lockup), *slip_lines(summary.lockup_slip))
    yield from filter(None, (summary.held_run,))
    yield from shifting_lines(summary)


def standard_output_reporter(stop: Trigger, *, as_json: bool, is_detailed: bool) -> Reporter:
    """Return who writes a run to standard output, as lines for people or JSON; a reader who hangs up stops the run."""

    def hang_up() -> None:
        discard()
        stop.set()

    if as_json:
        return PipeReporter(JsonLinesReporter(sys.stdout, Console(stderr=True)), hang_up)
    return PipeReporter(ConsoleReporter(PeopleConsole(), is_detailed=is_detailed), hang_up)


def order_lines(order: Order) -> list[Text]:
    """Return the order for a vehicle, and what each clutch says."""
    style = _CONDITION_STYLE[Condition[SHOWN_AS[order.action].upper()]]
    notes = (Text(note, style="yellow") for note in order.notes)
    return [Text(order.sentence, style=style), *map(Text, order.reasons), *notes]


def shift_head(*, is_detailed: bool = True, tier: Tier = Tier.FRICTION) -> Text:
    """Return the heads of the columns that signals of a tier can fill."""
    if tier is not Tier.FRICTION:
        columns = _columns(tier, is_detailed=is_detailed)
        return Text(_EVENT_HEAD + " ".join(f"{name:>{width}}" for _, name, width in columns), style="bold")
    return Text(f"{_HEAD}{_DETAIL_HEAD if is_detailed else ''}{_HEAD_END}", style="bold")


def shift_line(result: ShiftResult, *, is_detailed: bool = True) -> Text:
    """Return one shift as a line; columns as in the head."""
    estimate, verdict = result.estimate, result.verdict
    if estimate.tier is not Tier.FRICTION:
        return _untold_line(estimate, is_detailed=is_detailed)
    line = Text(f"{estimate.number:>5}  {gear_words(estimate):<5} {kind_words(estimate):<18} {estimate.clutch:>6}  ")
    line.append(f"{estimate.status.value:<10} ", _STATUS_STYLE[estimate.status])
    friction = estimate.friction
    line.append(
        f"{'-':>8} {'-':>7}" if friction is None else f"{friction.mu_c:>8.4f} {half_width(friction.std_mu_c):>7}"
    )
    line.append(f" {_details(estimate)}  " if is_detailed else "  ")
    line.append(condition_words(verdict.condition), _CONDITION_STYLE[verdict.condition])
    if estimate.reasons:
        line.append(f" [{reason_words(estimate)}]")
    if estimate.revisions:
        line.append(f" [{revision_words(estimate)}]")
    return line


def _columns(tier: Tier, *, is_detailed: bool) -> Iterator[tuple[Measure, str, int]]:
    """Yield measures of a tier, heads and widths; the deviation is shown of what is known least, or to specialists."""
    shown = shown_measures(tier)
    for measure in (*shown, JUDDER) if is_detailed else shown:
        has_stds = (is_detailed or measure in _LITTLE_KNOWN) and measure is not SCORE
        name = f"{measure.name.removeprefix('torque ')}{f' {SHORT_PLUS_MINUS}' if has_stds else ''}"
        yield measure, name, _COLUMNS[measure] + _WITH_STDS * has_stds


def _untold_line(estimate: ShiftEstimate, *, is_detailed: bool) -> Text:
    """Return an event of a vehicle without friction as a line: what is measured, and what was wrong with it."""
    line = Text(f"{estimate.number:>5}  {gear_words(estimate):<5} {kind_words(estimate):<18} {estimate.clutch:>6} ")
    cells = []
    for measure, name, width in _columns(estimate.tier, is_detailed=is_detailed):
        value, std = measure.read(estimate)
        shown = "-" if value is None else measure.words(value, std if SHORT_PLUS_MINUS in name else None)
        cells.append(f"{shown:>{width}}")
    line.append(" ".join(cells))
    # That friction is not told is said of the vehicle, not of each event.
    if estimate.status is Status.REJECTED:
        line.append(f" [rejected: {reason_words(estimate)}]", _STATUS_STYLE[estimate.status])
    elif estimate.end_reason not in {None, EndReason.COMPLETE}:
        line.append(f" [{estimate.end_reason.value.replace('_', ' ')}]")
    return line


def shifting_heads(shown: Iterable[Measure]) -> Iterator[str]:
    """Yield the heads of columns of measures: name and unit."""
    return (one.name.removeprefix("torque ") + (f" [{one.unit}]" if one.unit else "") for one in shown)


def shifting_rows(summary: ShiftingSummary) -> Iterator[tuple[str, ...]]:
    """Yield how a vehicle shifts as cells, the heads first: a row for each kind of event and gears.

    The change is that of the first measure.
    """
    shown, when = shown_measures(summary.tier), "since the first" if summary.drive_count > 1 else "over the"
    yield "event", "count", *shifting_heads(shown), f"{shown[0].name} {when} drive"
    for row in summary.rows:
        values = [(measure, row.value(measure)) for measure in shown]
        cells = ["-" if at is None else measure.number(at.mean, at.std) for measure, at in values]
        yield row.name, str(row.event_count), *cells, change_cell(summary, values[0][1])


SHIFTING_LEGEND = f"How it shifts, by kind and gears; {NOT_MEASURED}; {CHANGE_LEGEND}"


def shifting_table(summary: ShiftingSummary) -> Table:
    """Return how a vehicle shifts as a table."""
    head, *rows = shifting_rows(summary)
    table = plain_table(head, {"event"}, SHIFTING_LEGEND)
    for cells in rows:
        table.add_row(*cells)
    return table


def revision_words(estimate: ShiftEstimate) -> str:
    """Return what an event made of earlier ones; empty if nothing."""
    left_out = sum(bool(revision.reasons) for revision in estimate.revisions)
    taken_in = len(estimate.revisions) - left_out
    counts = ((left_out, "no longer believed"), (taken_in, "believed after all"))
    return ", ".join(f"{count} earlier {text}" for count, text in counts if count)


def _details(estimate: ShiftEstimate) -> str:
    """Return what specialists read: static friction, slope, how far the data can be believed, the oil."""
    friction, quality, oil_k = estimate.friction, estimate.data_quality, estimate.conditions.sump_temperature_k
    static = f"{'-':>8} {'-':>7} {'-':>10}"
    if friction is not None:
        static = (
            f"{friction.mu_s:>8.4f} {half_width(friction.std_mu_s):>7} {friction.probability_negative_slope:>10.3f}"
        )
    trust = "-" if quality is None else f"{quality.score:.2f}"
    oil = "-" if oil_k is None else f"{degc_from_k(oil_k):.0f} °C"
    return f"{static} {trust:>5} {oil:>6}"


def _clutch_table(summary: Summary, *, is_detailed: bool) -> Table:
    head = ("clutch", "condition", "mu_C", "level", "shifts", *(("mu_S", "P(slope<0)") if is_detailed else ()))
    table = plain_table(head, {"condition"}, PLUS_MINUS)
    for result in summary.latest:
        verdict, friction = result.verdict, result.verdict.friction
        cells: list[str | Text] = [
            verdict.element or str(verdict.clutch),
            Text(condition_words(verdict.condition), _CONDITION_STYLE[verdict.condition]),
            "-" if friction is None else plus_minus(friction.mu_c, friction.std_mu_c),
            "-" if verdict.level_ratio is None else f"{100.0 * verdict.level_ratio:.1f} %",
            str(verdict.shift_count),
        ]
        if is_detailed:
            cells.append("-" if friction is None else plus_minus(friction.mu_s, friction.std_mu_s))
            cells.append("-" if friction is None else f"{friction.probability_negative_slope:.3f}")
        table.add_row(*cells)
    return table
