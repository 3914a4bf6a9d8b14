"""Recorded drives by the paper's method: a line per shift, a table of both clutches, no uncertainty and no verdict."""

from collections.abc import Sequence
from typing import TextIO

from rich import box
from rich.console import Console
from rich.table import Table

from diag_service.diagnosis.friction.paper import PaperCollection, PaperEstimate, PaperShift, PooledClutch
from diag_service.diagnosis.results import dump
from diag_service.diagnosis.summary import Gap, frames_line, gaps_line
from diag_service.errors import StoppedError
from diag_service.service.drive import (
    OpenLog,
    gaps_in,
    insist_on_every_source,
    insist_on_the_whole,
    warn_of_damage,
    warn_of_idle,
)
from diag_service.service.drive_frames import DriveFrames
from diag_service.service.recorded import events, frame_counts
from diag_service.service.stages import Stages
from diag_service.service.stopping import Trigger
from fleet_contract import JsonObject

PAPER_SCHEMA = "clutchdiag/paper/v1"
_HEAD = f"{'shift':>5}  {'gears':<5} {'clutch':>6}  {'mu_C':>8} {'n':>4} {'mu_S':>8} {'n':>4}"


def run_paper(
    logs: Sequence[OpenLog],
    stages: Stages,
    collection: PaperCollection,
    output: Console | TextIO,
    stop: Trigger,
    *,
    is_strict: bool = False,
) -> None:
    """Analyse the shifts of a drive; tables to a console, JSON lines to any other stream.

    Raises
    ------
    StoppedError, IncompleteError
        If it was a part of the drive only, or of a strict run if a log or a channel gave nothing, after that was told.
    """
    if isinstance(output, Console):
        output.print(_HEAD, style="bold", highlight=False, soft_wrap=True)
    was_stopped = False
    drive = DriveFrames(logs, stages.sources)
    try:
        for event in events(drive, stages, stop):
            _tell(collection.add(event), output)
    except StoppedError:
        was_stopped = True
    contributions = drive.contributions(stages.named_channel, is_whole=not was_stopped)
    warn_of_damage(logs)
    warn_of_idle(contributions)
    gaps = gaps_in(logs, was_stopped=was_stopped)
    frames = frames_line(frame_counts(logs, stages, is_whole=not was_stopped))
    _conclude(collection.pooled(), gaps, frames, output)
    insist_on_the_whole(gaps)
    if is_strict:
        insist_on_every_source(contributions)


def _tell(shift: PaperShift, output: Console | TextIO) -> None:
    if isinstance(output, Console):
        output.print(shift_line(shift), highlight=False, soft_wrap=True)
    else:
        _write(output, _shift_record(shift))


def _conclude(pooled: Sequence[PooledClutch], gaps: tuple[Gap, ...], frames: str, output: Console | TextIO) -> None:
    if isinstance(output, Console):
        if gaps:
            output.print(gaps_line(gaps), style="bold red", highlight=False, soft_wrap=True)
        output.print(_table(pooled))
        output.print("n: samples that passed every gate; no uncertainty is stated, so no verdict", soft_wrap=True)
        output.print(frames, highlight=False, soft_wrap=True)
        return
    for clutch in pooled:
        _write(output, _pooled_record(clutch, gaps))


def shift_line(shift: PaperShift) -> str:
    """Return one shift as a line for people; columns as in the head."""
    start = f"{shift.number:>5}  {f'{shift.from_gear}-{shift.to_gear}':<5} {shift.clutch:>6}  "
    if shift.estimate is None:
        reason = "" if shift.reason is None else shift.reason.value.replace("_", " ")
        return f"{start}{'-':>8} {'-':>4} {'-':>8} {'-':>4}  ({reason})"
    found = shift.estimate
    return f"{start}{_number(found.mu_c):>8} {found.coulomb_count:>4} {_number(found.mu_s):>8} {found.static_count:>4}"


def _table(pooled: Sequence[PooledClutch]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("clutch", "mu_C", "n", "mu_S", "n", "std", "shifts"):
        table.add_column(name, justify="right", no_wrap=True)
    for clutch in pooled:
        found = clutch.estimate
        table.add_row(
            str(clutch.clutch),
            "-" if found is None else _number(found.mu_c),
            "0" if found is None else str(found.coulomb_count),
            "-" if found is None else _number(found.mu_s),
            "0" if found is None else str(found.static_count),
            "n/a",
            str(clutch.shift_count),
        )
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


def _estimate_record(found: PaperEstimate | None) -> JsonObject:
    if found is None:
        return {"mu_c": None, "mu_s": None, "mu_c_samples": 0, "mu_s_samples": 0}
    return {
        "mu_c": found.mu_c,
        "mu_s": found.mu_s,
        "mu_c_samples": found.coulomb_count,
        "mu_s_samples": found.static_count,
    }


def _write(stream: TextIO, record: JsonObject) -> None:
    stream.write(dump(record) + "\n")
    stream.flush()


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
