"""A report as one HTML file: written whole or not at all, it loads nothing and runs nothing."""

import os
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from canlog.files import replacing
from clutch_model.units import NS_PER_S, bar_from_pa, rpm_from_rad_s
from clutch_results import records
from clutch_results.event_kinds import DATED_NS, events_text
from clutch_results.measures import CAPACITY, JERK, SHIFT_TIME, SLIP_TIME, Measure, shown_measures
from clutch_results.pictures import UNFORETOLD, Fan, curve_picture, fan_of, fan_picture, shifting_picture
from clutch_results.prognosis import Prognosis
from clutch_results.prognosis.sentence import distance_left
from clutch_results.shift_course import COURSE_HEAD, course_lines, course_row, courses, load_line, loads
from clutch_results.shifting import MOST_NAMED, seen_changes, shifting_of, unknown_friction_words
from clutchdiag_io.pages.content import templates_of
from clutchdiag_io.pages.plot import Axis, Plot, thinned
from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT
from clutchdiag_io.program import legible, legible_record
from diag_service.delivery.console import (
    SHIFTING_LEGEND,
    condition_words,
    gear_words,
    kind_words,
    reason_words,
    shifting_heads,
    shifting_rows,
)
from diag_service.diagnosis.capability import is_relative
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.verdict import likely
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import frames_line, values_line
from diag_service.diagnosis.summary import capability_line, gaps_line, newest_causes, reason_text, summary_record
from diag_service.errors import ConfigError, StoreError
from diag_service.report.findings import Findings, moment_words
from diag_service.report.history import outlook_of, prognoses_of
from fleet_contract import JsonObject
from fleet_contract.orders import SHOWN_AS, cause_words, title_of

REPORT_SCHEMA: Final = "clutchdiag/report/v1"
MOST_ROWS: Final = 100  # of the table of events
MOST_SAMPLES: Final = 400  # of one signal of a shift
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
PRINTING_S: Final = 120.0
CURVE_SIZE: Final = (400, 240)
PANELS: Final = (("_rad_s", "rpm", rpm_from_rad_s(1.0)), ("_pa", "bar", bar_from_pa(1.0)), ("_nm", "Nm", 1.0))
UNSHOWN: Final = {Signal.OUTPUT_SPEED, Signal.BRAKE_PRESSURE}  # they say nothing of a clutch


def record_of(findings: Findings) -> JsonObject:
    """Return what the page says in numbers, as `analyze --json` tells it."""
    return {
        "schema": REPORT_SCHEMA,
        "vehicle": findings.vehicle,
        **records.order_record(findings.order),
        "clutches": [records.clutch_record(records.shift_record(result), findings.order) for result in findings.latest],
        "summary": None if findings.summary is None else summary_record(findings.summary),
    }


def html_of(findings: Findings, made_at: str, *, is_full: bool = False) -> str:
    """Return the sheet of one vehicle, or the full report; ``made_at`` is the present moment (ISO 8601 UTC)."""
    environment, order, prognoses = templates_of("diag_service.report"), findings.order, prognoses_of(findings)
    fan = fan_for(findings, prognoses)
    environment.filters |= {
        "cause": cause_words,
        "likely": likely,
        "course_lines": course_lines,
        "course_row": course_row,
        "load_line": load_line,
        "title": title_of,
        "kind": kind_words,
        "gears": gear_words,
        "reasons": reason_words,
        "condition": condition_words,
        "moment": lambda t_ns: moment_words(t_ns, is_dated=findings.is_dated),
    }
    return environment.get_template("report.html").render(
        findings=findings,
        subtitle=_subtitle(findings),
        order=order,
        style=SHOWN_AS[order.action].replace("_", "-"),
        left=distance_left(prognoses, order.action),
        odometers_m=[
            at.odometer_m
            for at in (result.estimate.conditions for result in findings.results)
            if at.odometer_m is not None
        ],
        fill=findings.fills[-1] if findings.fills else None,
        fan=fan,
        fan_picture="" if fan is None else fan_picture(fan),
        outlook=outlook_of(findings, prognoses),
        clutches=list(_curves(findings)),
        causes=newest_causes(findings.latest, findings.today_ns),
        unseen=_unseen(findings),
        record=legible_record(record_of(findings)),
        version=version("clutchdiag"),
        schema=records.SHIFT_SCHEMA,
        made_at=made_at,
        plus_minus=PLUS_MINUS,
        **(_details(findings) if is_full else {"full": False}),
        **_shifting(findings),
    )


def _shifting(findings: Findings) -> dict[str, Any]:
    """Return what stands in a report of a vehicle whose signals do not tell friction, in place of friction."""
    untold = findings.untold
    if not untold:
        return {"shifting": None}
    shifting, shown = shifting_of(untold), (SLIP_TIME, CAPACITY, SHIFT_TIME, JERK)
    pictures = ((measure, shifting_picture(untold, measure, CURVE_SIZE)) for measure in shown)
    measures = shown_measures(shifting.tier)
    return {
        "shifting": shifting,
        "shifting_words": f"{unknown_friction_words(shifting, is_relative=is_relative(untold))}.",
        "shifting_pictures": [(measure, *drawn) for measure, drawn in pictures if drawn is not None][:2],
        "shifting_rows": [(name, *map(_unbroken, cells)) for name, *cells in shifting_rows(shifting)],
        "shifting_legend": SHIFTING_LEGEND,
        "changes": seen_changes(shifting)[MOST_NAMED:],  # the others are in the words
        "event_heads": tuple(shifting_heads(measures)),
        "event_cells": lambda estimate: tuple(_cell(measure, estimate) for measure in measures),
    }


def _cell(measure: Measure, estimate: records.ShiftEstimate) -> str:
    value, std = measure.read(estimate)
    return "–" if value is None else _unbroken(measure.number(value, std))


def _unbroken(text: str) -> str:
    """Return a cell that a narrow screen does not break at its blanks."""
    return text if text[:1].isalpha() else text.replace(" ", "\N{NO-BREAK SPACE}")


def write_page(path: Path, page: str) -> int:
    """Write a page, as PDF where the file is called so, and return its size in bytes.

    Raises StoreError if the disk does not take it, ConfigError if nothing here makes a PDF.
    """
    content = page.encode("utf-8", "backslashreplace")
    if path.suffix.casefold() == ".pdf":
        content = pdf_of(content)
    with replacing(path, StoreError) as part:
        part.write_bytes(content)
        part.replace(path)
    return len(content)


def pdf_of(page: bytes) -> bytes:
    """Return a page as a browser of this machine prints it; raises ConfigError if there is none, or it fails."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise ConfigError(f"a PDF takes one of {', '.join(BROWSERS)}; or write .html and print that")
    with TemporaryDirectory() as folder:
        source, target = Path(folder, "page.html"), Path(folder, "page.pdf")
        source.write_bytes(page)
        options = ["--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={folder}/profile"]
        options += ["--no-sandbox"] if os.geteuid() == 0 else []  # which refuses root; the page has no scripts
        command = [browser, *options, f"--print-to-pdf={target}", source.as_uri()]
        done = subprocess.run(command, capture_output=True, check=False, timeout=PRINTING_S)  # noqa: S603 - ours
        if not target.exists():
            raise ConfigError(f"{browser} printed no PDF: {done.stderr.decode(errors='replace').strip()[-200:]}")
        return target.read_bytes()


def _subtitle(findings: Findings) -> str:
    names = ", ".join(legible(name) for name in findings.sources)
    if not findings.rows:
        return f"no event in {names}"
    # Logs may have been analysed in any order.
    starts_ns = (result.estimate.start_ns for result in findings.results)
    begin_ns = min(t_ns for t_ns in starts_ns if t_ns >= DATED_NS * findings.is_dated)
    end_ns = max(result.estimate.end_ns for result in findings.results)
    days = dict.fromkeys(records.utc_from_bus_ns(t_ns)[:10] for t_ns in (begin_ns, end_ns))  # one twice is one
    when = " to ".join(days) if findings.is_dated else "without a date"
    return f"{events_text(len(findings.rows))}, {when}, from {names}"


def fan_for(findings: Findings, prognoses: Sequence[Prognosis] | None = None) -> Fan | None:
    """Return the fan chart of a vehicle, by its prognoses if they are known; None where no margin is known."""
    if findings.calibration is None:
        return None
    prognoses = prognoses_of(findings) if prognoses is None else prognoses
    new = [clutch.friction for clutch in findings.calibration.clutches]
    is_foretold = findings.order.action not in UNFORETOLD
    return fan_of(findings.results, findings.fills, new, prognoses, is_foretold=is_foretold)


def notebook_of(name: str, said: str, order: str, notices: Sequence[str], fan: Fan | None) -> str:
    """Return what a notebook shows of an analysis: its order and the fan chart of its report."""
    picture = None if fan is None else fan_picture(fan)
    template = templates_of("diag_service.report").get_template("notebook.html")
    return template.render(name=name, said=said, order=order, notices=notices, picture=picture)


def _curves(findings: Findings) -> Iterator[tuple[records.ClutchVerdict, Markup]]:
    """Yield the friction of each clutch over slip, as far as that and its calibration are known."""
    for verdict in (result.verdict for result in findings.latest):
        if findings.calibration is not None and verdict.friction is not None:
            new = findings.calibration.clutches[verdict.clutch - 1].friction
            yield verdict, curve_picture(verdict.clutch, verdict.friction, new, verdict.element, CURVE_SIZE)


def _unseen(findings: Findings) -> Iterator[str]:
    """Yield what was not seen and why, and what became of the frames."""
    summary = findings.summary
    engaged = {result.estimate.clutch for result in findings.results} | (
        {1} if summary and (summary.lockup or summary.lockup_slip) else set()
    )
    if not findings.untold:
        yield from (
            f"{findings.title(clutch)}: no event engaged it." for clutch in findings.clutches if clutch not in engaged
        )
    if findings.left_out_count:
        yield f"{findings.left_out_count} results of other algorithms or calibrations are left out."
    if findings.calibration is None and not findings.untold:
        yield (
            f"Curves: the results were made with calibration {findings.versions.calibration}, which is not the one at "
            "hand; name it by --calibration."
        )
    refused = Counter(result.estimate.status for result in findings.results)[records.Status.REJECTED]
    if refused:
        yield f"{refused} of {events_text(len(findings.results))} were rejected: their data could not be believed."
    if summary is None:
        yield "A store keeps only results. The report of a log tells what happened to its frames."
        return
    yield from (f"{text}." for text in map(legible, summary.capability.absent))
    lines = (gaps_line(summary.gaps), capability_line(summary), values_line(summary.frames))
    yield from (line for line in (*lines, *map(legible, summary.contributions.idle)) if line)
    if summary.capability.unseen and not lines[1]:
        yield f"Mapped, but never seen: {', '.join(summary.capability.unseen)}."
    yield f"On the bus: {frames_line(summary.frames)}."


def _details(findings: Findings) -> dict[str, Any]:
    """Return what a full report has beyond its sheet."""
    estimates = [result.estimate for result in findings.results]
    quality = [estimate.data_quality for estimate in estimates if estimate.data_quality is not None]
    scores = {"all": [data.score for data in quality]}
    scores |= {part.value: [data.parts[part] for data in quality if part in data.parts] for part in records.QualityPart}
    reasons = Counter(reason_text(reason) for estimate in estimates for reason in estimate.reasons)
    by_status = Counter(estimate.status.value for estimate in estimates)
    if findings.untold:  # that friction is not told is said of the vehicle
        del by_status[records.Status.UNOBSERVED], reasons[reason_text(records.Reason.SIGNAL_MISSING)]
    return {
        "full": True,
        "course_head": COURSE_HEAD,
        "courses": courses(estimates),
        "loads": [load for load in loads(estimates) if any(load.counts) or not findings.untold],
        "panels": _panels,
        "shares": [("Events by the quality of their data", by_status), ("Why events were not used", reasons)],
        "quality": {name: values for name, values in scores.items() if values},
        "most_rows": MOST_ROWS,
        "slope_unit": SLOPE_UNIT,
        "per_1000_rpm": PER_1000_RPM,
    }


def _panels(event: Event) -> Iterator[tuple[Markup, list[tuple[str, str]]]]:
    """Yield pictures of the signals of each unit over the time of a shift, and what their lines stand for."""
    for suffix, unit, factor in PANELS:
        known = event.columns.keys() - UNSHOWN
        signals = [signal for signal in Signal if signal in known and signal.endswith(suffix)]
        shown = {signal: event.columns[signal] for signal in signals if len(event.columns[signal].t_ns)}
        if not shown:
            continue
        times_s = [(series.t_ns - event.start_ns) / NS_PER_S for series in shown.values()]
        values = [series.value * factor for series in shown.values()]
        lines = [(_style(signal), signal.removesuffix(suffix).replace("_", " ")) for signal in shown]
        x = Axis.around("time since the shift began [s]; shaded: the shift", *times_s, margin_ratio=0.0)
        what = f"During the shift [{unit}]: {', '.join(name for _, name in lines)}"
        plot = Plot(what, x, Axis.around(unit, *values), width=CURVE_SIZE[0], height=CURVE_SIZE[1])
        bounds_s = np.clip([0.0, (event.end_ns - event.start_ns) / NS_PER_S], x.low, x.high)
        plot.band(bounds_s, np.full(2, plot.y.low), np.full(2, plot.y.high), "shade")
        for t_s, value, (style, _) in zip(times_s, values, lines, strict=True):
            drawn = thinned(value, MOST_SAMPLES)
            plot.line(t_s[drawn], value[drawn], f"line {style}")
        yield plot.markup(), lines


def _style(signal: Signal) -> str:
    """Return how the line of a signal looks: in the colour of its clutch, dashed where it is only commanded."""
    colour = next(
        (style for part, style in (("1", "clutch1"), ("2", "clutch2"), ("engine", "ink")) if part in signal), "new"
    )
    return f"{colour} dashed" if "command" in signal else colour
