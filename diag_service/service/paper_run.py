"""Recorded drives by the paper's method: a line per shift, a table of both clutches, no uncertainty and no verdict."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from canlog.logs.reading import Watch
from clutch_results.records import dump
from clutchdiag_io.console import PeopleConsole, plain_table
from diag_service.console import ReadingLine
from diag_service.diagnosis.friction.paper import (
    PaperCollection,
    PaperEstimate,
    PaperShift,
    PooledClutch,
    nominal_driveline,
)
from diag_service.diagnosis.summary import Gap, frames_line, gaps_line
from diag_service.service.drive import insist, open_drive
from diag_service.service.recorded import Account, replay
from diag_service.service.stages import Stages
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.proposed import as_proposed
from fleet_contract import JsonObject

PAPER_SCHEMA = "clutchdiag/paper/v1"
_HEAD = f"{'shift':>5}  {'gears':<5} {'clutch':>6}  {'mu_C':>8} {'n':>4} {'mu_S':>8} {'n':>4}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperRun:
    """What a drive says by the paper's method."""

    clutches: tuple[PooledClutch, ...]  # 1 and 2
    account: Account


def run_paper(
    config: DiagnosisConfig,
    paths: Sequence[Path],
    stop: Trigger,
    use: Callable[[PaperShift], None],
    begin: Callable[[], None] = lambda: None,  # called when the logs are open
    watch: Watch | None = None,  # of how far the reading is
) -> PaperRun:
    """Call ``use`` with each shift of a drive; return what they say together and what became of the frames."""
    config = as_proposed(config, paths, lambda: stop.is_set)
    decoder = config.interpretation().decoder()
    stages = Stages(decoder, config.calibration)
    collection = PaperCollection(config.calibration, nominal_driveline())
    with open_drive(
        paths, is_strict=config.is_strict, is_stopped=lambda: stop.is_set, watch=watch, columns=config.columns
    ) as logs:
        begin()
        account = replay(logs, stages, stop, lambda event: use(collection.add(event)))
    return PaperRun(clutches=collection.pooled(), account=account)


def show_paper(config: DiagnosisConfig, paths: Sequence[Path], controls: Controls, *, as_json: bool) -> None:
    """Analyse the shifts of a drive, tables for people or JSON lines; nothing is stored, judged or published.

    Raises StoppedError or IncompleteError as ``insist`` does, after all was told.
    """
    output = sys.stdout if as_json else PeopleConsole()

    def begin() -> None:
        if isinstance(output, PeopleConsole):
            output.print(_HEAD, style="bold")

    with ReadingLine() as line:

        def use(shift: PaperShift) -> None:
            line.clear()
            if isinstance(output, PeopleConsole):
                output.print(shift_line(shift))
            else:
                output.write(dump(_shift_record(shift)) + "\n")
                output.flush()

        run = run_paper(config, paths, controls.stop, use, begin, line.watch)
    gaps = run.account.gaps
    if isinstance(output, PeopleConsole):
        if gaps:
            output.print(gaps_line(gaps), style="bold red")
        output.print(_table(run.clutches))
        output.print("n: samples that passed every gate; no uncertainty is stated, so no verdict")
        output.print(frames_line(run.account.frames))
    else:
        output.writelines(dump(_pooled_record(clutch, gaps)) + "\n" for clutch in run.clutches)
    insist(gaps, run.account.contributions, is_strict=config.is_strict)


def shift_line(shift: PaperShift) -> str:
    """Return one shift as a line for people; columns as in the head."""
    start = f"{shift.number:>5}  {f'{shift.from_gear}-{shift.to_gear}':<5} {shift.clutch:>6}  "
    if shift.estimate is None:
        reason = "" if shift.reason is None else shift.reason.value.replace("_", " ")
        return f"{start}{'-':>8} {'-':>4} {'-':>8} {'-':>4}  ({reason})"
    estimate, mu_c, mu_s = shift.estimate, _number(shift.estimate.mu_c), _number(shift.estimate.mu_s)
    return f"{start}{mu_c:>8} {estimate.coulomb_count:>4} {mu_s:>8} {estimate.static_count:>4}"


def _table(pooled: Sequence[PooledClutch]) -> Table:
    table = plain_table(("clutch", "mu_C", "n", "mu_S", "n", "std", "shifts"))
    for clutch in pooled:
        mu_c, mu_s, mu_c_samples, mu_s_samples = _estimate_record(clutch.estimate).values()
        cells = (_number(mu_c), mu_c_samples, _number(mu_s), mu_s_samples, "n/a", clutch.shift_count)
        table.add_row(str(clutch.clutch), *map(str, cells))
    return table


def _shift_record(shift: PaperShift) -> JsonObject:
    return {
        "schema": PAPER_SCHEMA,
        "scope": "shift",
        "number": shift.number,
        "from_gear": shift.from_gear,
        "to_gear": shift.to_gear,
        "clutch": shift.clutch,
        "reason": None if shift.reason is None else shift.reason.value,
        **_estimate_record(shift.estimate),
    }


def _pooled_record(clutch: PooledClutch, gaps: tuple[Gap, ...]) -> JsonObject:
    return {
        "schema": PAPER_SCHEMA,
        "scope": "pooled",
        "clutch": clutch.clutch,
        "shift_count": clutch.shift_count,
        "complete": not gaps,
        "incomplete": [gap.value for gap in gaps],
        **_estimate_record(clutch.estimate),
    }


def _estimate_record(estimate: PaperEstimate | None) -> dict[str, float | None]:
    if estimate is None:
        return {"mu_c": None, "mu_s": None, "mu_c_samples": 0, "mu_s_samples": 0}
    return {
        "mu_c": estimate.mu_c,
        "mu_s": estimate.mu_s,
        "mu_c_samples": estimate.coulomb_count,
        "mu_s_samples": estimate.static_count,
    }


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
