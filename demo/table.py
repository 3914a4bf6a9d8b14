"""What the demonstration shows: a line per shift, the closing tables, the verdicts."""

import time
from collections.abc import Iterable, Iterator

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from demo.listener import ClutchState
from demo.outcome import MAX_ERROR_STD, Comparison, FrameAccount, Outcome, compare
from diag_service.diagnosis.records import FrictionEstimate, ShiftResult

_NS_PER_S = 1e9
_MS_PER_S = 1e3
_CONDITION_STYLE = {"no verdict": "dim", "good": "green", "watch": "yellow", "change fluid": "bold red"}
_UNUSUAL_STD = 2.0
_NO_FRICTION = ("-",) * 6


def live_line(result: ShiftResult) -> Text:
    """Return a shift as one line, at the moment at which it arrives."""
    estimate = result.estimate
    condition = result.verdict.condition.name.lower().replace("_", " ")
    delay_s = time.time() - estimate.end_ns / _NS_PER_S
    line = Text(f"{estimate.number:>5}  {estimate.from_gear}-{estimate.to_gear}  clutch {estimate.clutch}  ")
    line.append(_live_friction(estimate.friction))
    line.append(f"  {condition:<12}", _CONDITION_STYLE[condition])
    if estimate.reasons:
        line.append(f"  [{', '.join(reason.value.replace('_', ' ') for reason in estimate.reasons)}]")
    line.append(f"  {delay_s:.1f} s after its end", "dim")
    return line


def print_outcome(console: Console, outcome: Outcome) -> None:
    """Print everything that is known at the end but the complaints."""
    console.print(shift_table(outcome))
    console.print(clutch_table(outcome))
    for line in frame_lines(outcome.frames):
        console.print(line, soft_wrap=True)


def shift_table(outcome: Outcome) -> Table:
    """Return the shifts beside their truth."""
    table = _table("Single shifts, as an MQTT subscriber received them, beside the truth")
    for name in ("shift", "gears", "clutch"):
        table.add_column(name, justify="right", no_wrap=True)
    _add_comparison_columns(table)
    for result in outcome.shifts:
        estimate, true = result.estimate, outcome.true_shift(result)
        cells: tuple[str | Text, ...] = _NO_FRICTION
        if estimate.friction is not None and true is not None:
            cells = _cells(compare(estimate.friction, true.mu_c, true.mu_s))
        table.add_row(str(estimate.number), f"{estimate.from_gear}-{estimate.to_gear}", str(estimate.clutch), *cells)
    return table


def clutch_table(outcome: Outcome) -> Table:
    """Return the running estimates, which combine all shifts of a clutch, beside the truth."""
    table = _table("Running estimates, as the broker keeps them")
    for name in ("clutch", "shifts"):
        table.add_column(name, justify="right", no_wrap=True)
    _add_comparison_columns(table)
    table.add_column("P(slope<0)", justify="right", no_wrap=True)
    for clutch, state in sorted(outcome.clutches.items()):
        cells: tuple[str | Text, ...] = _NO_FRICTION
        probability = "-"
        if state.friction is not None:
            cells = _cells(compare(state.friction, *outcome.true_friction(clutch)))
            probability = f"{state.friction.probability_negative_slope:.3f}"
        table.add_row(str(clutch), str(state.shift_count), *cells, probability)
    return table


def frame_lines(frames: FrameAccount) -> Iterator[str]:
    """Yield the frame accounts of both programs."""
    rejected = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in frames.rejected.items() if count)
    yield (
        f"emulator: {frames.sent} frames sent, {frames.given_up} not taken by the bus; "
        f"at most {_MS_PER_S * frames.lateness_max_s:.0f} ms late"
    )
    yield (
        f"service:  {frames.decoded} decoded, {frames.ignored} ignored, "
        f"{sum(frames.rejected.values())} rejected{f' ({rejected})' if rejected else ''}, {frames.dropped} dropped, "
        f"{frames.missing} missing by alive counters; unexplained: {frames.unexplained}"
    )


def verdict_line(state: ClutchState) -> Text:
    """Return the verdict on one clutch as a line that a script can find."""
    line = Text(f"verdict: clutch {state.clutch} ")
    line.append(state.condition, _CONDITION_STYLE.get(state.condition, ""))
    return line


def verdict_lines(state: ClutchState) -> Iterator[Text]:
    """Yield the verdict on one clutch for a script, and below it the sentence for people."""
    yield verdict_line(state)
    if state.advice is not None:
        yield Text(f"         {state.advice}")


def order_lines(states: Iterable[ClutchState]) -> Iterator[Text]:
    """Yield the one order for the vehicle, which the states of both clutches tell."""
    for order in dict.fromkeys(state.order for state in states if state.order is not None):
        yield Text(f"order:   {order}")


def _table(title: str) -> Table:
    return Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )


def _add_comparison_columns(table: Table) -> None:
    for symbol in ("mu_C", "mu_S"):
        for name in (f"{symbol} ± std", "truth", "error/std"):
            table.add_column(name, justify="right", no_wrap=True)


def _cells(pairs: tuple[Comparison, Comparison]) -> tuple[str | Text, ...]:
    return tuple(cell for pair in pairs for cell in _pair_cells(pair))


def _pair_cells(pair: Comparison) -> tuple[str | Text, ...]:
    size = abs(pair.error_std)
    style = "" if size <= _UNUSUAL_STD else "yellow" if size <= MAX_ERROR_STD else "bold red"
    return f"{pair.estimate:.4f} ± {pair.std:.4f}", f"{pair.truth:.4f}", Text(f"{pair.error_std:+.1f}", style)


def _live_friction(friction: FrictionEstimate | None) -> str:
    if friction is None:
        return f"{'no estimate':<44}"
    return f"mu_C {friction.mu_c:.4f} ± {friction.std_mu_c:.4f}  mu_S {friction.mu_s:.4f} ± {friction.std_mu_s:.4f}"
